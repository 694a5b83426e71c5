"""The pytest plugin: in a pytest of its own."""

import importlib.util
import re
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import canrig
import pytest
from conftest import write_hold

LED = 'schema = 1\nrig = "dc_motor"\nname = "led"\nduration_seconds = 1.0\n'
RIG = 'schema = 1\nname = "a rig"\n[plant.wire.sma]\n[node.controller]\nkind = "controller"\nnode_id = 1\n'
ON = ("--canrig", "-p", "no:cacheprovider")


@pytest.fixture
def scenarios(pytester):
    """A folder with scenarios, and with other files of TOML."""
    folder = pytester.path / "scenarios"
    write_hold(folder / "hold.toml")
    write_hold(folder / "below" / "strict.toml", name="strict hold", limit=0.001)
    (folder / "rig.toml").write_text(RIG)
    swept = (folder / "hold.toml").read_text() + '[[sweep.list]]\nkey = "seed"\nvalues = [1]\n'
    (folder / "swept.toml").write_text(swept)
    (folder / "table.toml").write_text('[tool]\nname = "hold"\n')
    return folder


def properties(case):
    return [(one.get("name"), one.get("value")) for one in case.iter("property")]


def test_off_means_off(pytester, scenarios):
    pytester.makepyfile(
        """
        import sys

        def test_it():
            assert [name for name in sys.modules if "canrig" in name] == ["pytest_canrig"]
        """
    )
    pytester.runpytest_subprocess().assert_outcomes(passed=1)
    # It can fail.
    result = pytester.runpytest_subprocess("--canrig")
    result.assert_outcomes(passed=1, failed=2)


def test_scenarios_are_items_and_nothing_else_is(pytester, scenarios, fake):
    result = pytester.runpytest_subprocess(*ON, "--collect-only", "-q")
    found = [line for line in result.outlines if ".toml" in line]
    assert sorted(found) == ["scenarios/below/strict.toml::strict", "scenarios/hold.toml::hold"]
    assert fake.calls == []


@pytest.mark.parametrize("of_scenario", [True, False])
def test_a_scenario_whose_controller_is_a_program_is_an_item(pytester, of_scenario):
    program = '[node.controller]\nprogram = ["true"]\n'
    led = LED
    if not of_scenario:
        text = canrig_text("rigs/dc_motor")
        (pytester.path / "rig.toml").write_text(text.replace("[node.controller]", program.strip(), 1))
        led, program = LED.replace("dc_motor", "rig.toml"), ""
    (pytester.path / "led.toml").write_text(led + program)
    (pytester.path / "broken.toml").write_text(led.replace("1.0", "=") + program)
    result = pytester.runpytest_subprocess(*ON, "--collect-only", "-q")
    found = [line for line in result.outlines if ".toml" in line]
    assert sorted(found) == ["broken.toml::broken", "led.toml::led"]


def canrig_text(name):
    """The text of a file that ships."""
    return subprocess.run([canrig.program(), "examples", name], capture_output=True, text=True, check=True).stdout


def test_every_scenario_that_ships_is_an_item(pytester):
    canrig.copy_examples(pytester.path / "examples")
    files = pytester.path.glob("examples/**/*.toml")
    expected = {path.relative_to(pytester.path) for path in files if path.parent.name not in ("rigs", "sweeps")}
    result = pytester.runpytest_subprocess(*ON, "--collect-only", "-q")
    found = {Path(line.split("::")[0]) for line in result.outlines if ".toml" in line}
    assert found == expected and len(found) > 70


def test_a_failure_shows_its_limits_and_its_folder(pytester, scenarios):
    result = pytester.runpytest_subprocess(*ON)
    result.assert_outcomes(passed=1, failed=1)
    text = result.stdout.str()
    assert re.search(r"current_amperes_rms: 0\.\d+, limit ≤ 0\.001", text), text
    folder = re.search(r"report +file://(\S+)/report\.html", text).group(1)
    assert folder.startswith(str(pytester.path / "runs" / "strict-hold-"))
    assert "Traceback" not in text and "_pytest.py" not in text
    # Files that runs leave are not collected in their turn.
    pytester.runpytest_subprocess(*ON).assert_outcomes(passed=1, failed=1)


def test_junit_has_requirements_folders_and_durations(pytester, scenarios):
    pytester.runpytest_subprocess(*ON, "--junitxml=junit.xml")
    root = ElementTree.parse(pytester.path / "junit.xml").getroot()
    cases = {case.get("name"): case for case in root.iter("testcase")}
    assert set(cases) == {"hold", "strict"}
    for name, case in cases.items():
        assert ("requirement", "HOLD-1") in properties(case) and ("requirement", "HOLD-2") in properties(case)
        assert any(key == "canrig_folder" and "/runs/" in value for key, value in properties(case))
        assert float(case.get("time")) > 0
        assert (case.find("failure") is not None) == (name == "strict")


def test_an_invalid_scenario_fails_in_the_words_of_the_program(pytester, scenarios):
    broken = scenarios / "hold.toml"
    broken.write_text(broken.read_text().replace("duration_seconds = 0.3", "duration_seconds = ="))
    result = pytester.runpytest_subprocess(*ON, "scenarios/hold.toml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*TOML syntax error*"])
    named = pytester.runpytest_subprocess(*ON, "scenarios/table.toml")
    named.assert_outcomes(failed=1)
    named.stdout.fnmatch_lines(["*table.toml*"])


def worlds(fake):
    """The commands that were called, with their clocks."""
    found = []
    for _, _, arguments in fake.calls:
        clock = [word.split("=")[1] for word in arguments if word.startswith("--clock=")]
        found.append((arguments[0], *clock))
    return sorted(found)


def test_the_world_comes_from_marker_option_and_ini(pytester, fake):
    write_hold(pytester.path / "hold.toml")
    pytester.makepyfile(
        """
        import pytest

        def test_plain(canrig_run):
            canrig_run("hold.toml")

        @pytest.mark.canrig("lockstep")
        def test_marked(canrig_run):
            canrig_run("hold.toml")

        @pytest.mark.canrig(world="run")
        def test_marked_by_name(canrig_run):
            canrig_run("hold.toml")
        """
    )
    lockstep, real_time = ("run", "lockstep"), ("run", "real-time")
    pytester.runpytest_subprocess(*ON).assert_outcomes(passed=4)
    assert worlds(fake) == [lockstep, real_time, ("simulate",), ("simulate",)]
    pytester.makeini("[pytest]\ncanrig = true\ncanrig_world = lockstep\n")
    pytester.runpytest_subprocess("hold.toml").assert_outcomes(passed=1)
    assert worlds(fake).count(lockstep) == 2
    pytester.runpytest_subprocess("hold.toml", "--canrig-world=run").assert_outcomes(passed=1)
    assert worlds(fake).count(real_time) == 2


def test_an_unknown_world_is_refused(pytester, fake):
    write_hold(pytester.path / "hold.toml")
    pytester.makeini("[pytest]\ncanrig = true\ncanrig_world = mars\n")
    result = pytester.runpytest_subprocess("hold.toml")
    assert "it must be simulate, lockstep or run" in result.stdout.str() + result.stderr.str()
    assert result.ret != 0 and fake.calls == []


def test_inconclusive_fails_unless_the_ini_lets_it_pass(pytester, fake, monkeypatch):
    monkeypatch.setenv("FAKE_OUTCOME", "inconclusive:5")
    write_hold(pytester.path / "hold.toml")
    result = pytester.runpytest_subprocess(*ON, "hold.toml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*inconclusive*", "*so it is*"])
    pytester.makeini("[pytest]\ncanrig_inconclusive = pass\n")
    pytester.runpytest_subprocess(*ON, "hold.toml").assert_outcomes(passed=1)


def test_a_bench_that_fails_fails_the_test(pytester, fake, monkeypatch):
    monkeypatch.setenv("FAKE_OUTCOME", "incomplete:4")
    write_hold(pytester.path / "hold.toml")
    pytester.makeini("[pytest]\ncanrig_inconclusive = pass\n")
    result = pytester.runpytest_subprocess(*ON, "hold.toml", "--junitxml=junit.xml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*so it is*"])
    assert "canrig_folder" in (pytester.path / "junit.xml").read_text()


@pytest.mark.skipif(importlib.util.find_spec("xdist") is None, reason="pytest-xdist is not installed")
@pytest.mark.parametrize("world, together", [("run", False), ("simulate", True)])
def test_real_time_runs_one_at_a_time(pytester, fake, monkeypatch, world, together):
    monkeypatch.setenv("FAKE_SECONDS", "0.5")
    for number in range(4):
        write_hold(pytester.path / f"hold{number}.toml")
    result = pytester.runpytest_subprocess("--canrig", f"--canrig-world={world}", "-n", "4")
    result.assert_outcomes(passed=4)
    spans = sorted((begin, end) for begin, end, _ in fake.calls)
    overlaps = [later[0] < earlier[1] for earlier, later in zip(spans, spans[1:])]
    assert len(spans) == 4 and any(overlaps) == together, spans


def test_a_test_written_by_hand_plays_and_judges(pytester):
    write_hold(pytester.path / "tests" / "hold.toml")
    (pytester.path / "tests" / "test_hand.py").write_text(
        """
import pytest

@pytest.mark.parametrize("position", [5, 15])
def test_holds(canrig_run, position):
    run = canrig_run("hold.toml", {"reference.hold[0].position_millimetres": position})
    assert run.passed, run.explain()
    assert set(run.signals("lists")["set_point_millimetres"]) == {position}

def test_ships(canrig_run, tmp_path):
    assert canrig_run("step", output=tmp_path).folder.parent == tmp_path
"""
    )
    result = pytester.runpytest_subprocess("tests", "--junitxml=junit.xml")
    result.assert_outcomes(passed=3)
    root = ElementTree.parse(pytester.path / "junit.xml").getroot()
    assert all(("requirement", "HOLD-1") in properties(case) for case in list(root.iter("testcase"))[:2])
