"""Runs, their verdicts and what is in their folders."""

import re

import canrig
import pytest


def test_a_scenario_that_ships_is_played_by_its_name(output):
    run = canrig.simulate("step", output=output)
    assert run.passed and run.outcome == "pass"
    assert run.folder.parent == output
    settling = run.verdict["settling_time_seconds"]
    assert 0.15 <= settling.value <= 0.2
    assert (settling.min, settling.max, settling.passed) == (0.15, 0.2, True)
    assert run.requirements["CTRL-1"] is True
    assert run.report.is_file()
    run.assert_passed()


def test_values_take_the_place_of_those_in_the_file(output):
    lower = canrig.simulate("step", {"reference.step[0].position_millimetres": 20}, output=output)
    assert max(lower.signals("lists")["set_point_millimetres"]) == 20
    assert "20" in (lower.folder / "scenario.toml").read_text()
    named = canrig.simulate("step", {"name": 'a "name" = [1]'}, output=output)
    assert named.verdict.scenario == 'a "name" = [1]'


def test_values_of_all_kinds_are_written_as_toml(hold):
    class OfNumPy:
        def tolist(self):
            return 0.25

    canrig.check(hold, {"seed": 3, "node.drive.sensor.noise_rms": OfNumPy(), "requirements": ["A", "B"]})
    canrig.check(hold, {"reference.hold[0]": {"at_seconds": 0, "position_millimetres": 5}})
    canrig.check(hold, {"name": "ä 'quoted' \"twice\""})
    for value in (None, object()):
        with pytest.raises(TypeError, match="seed is"):
            canrig.check(hold, {"seed": value})


def test_a_run_that_fails_is_no_error_and_explains_itself(strict, output):
    run = canrig.simulate(strict, output=output)
    assert run.outcome == "fail" and not run.passed
    assert [metric.name for metric in run.verdict.failures] == ["current_amperes_rms"]
    assert run.requirements == {"HOLD-1": False, "HOLD-2": False}
    text = run.explain()
    assert re.search(r"current_amperes_rms: 0\.\d+, limit ≤ 0\.001", text), text
    assert str(run.folder) in text and run.report.resolve().as_uri() in text
    with pytest.raises(AssertionError, match="current_amperes_rms"):
        run.assert_passed()
    with pytest.raises(KeyError, match="bus_load_percent"):
        run.verdict["settling"]
    assert "FAIL" in run._repr_html_() and "strict hold" in run._repr_html_()


def test_a_folder_is_a_run_too_and_is_judged_again(hold, strict, output):
    run = canrig.simulate(hold, output=output)
    again = canrig.Run(run.folder)
    assert again.verdict == run.verdict
    assert canrig.replay(again) == run.verdict
    assert canrig.replay(run.folder, scenario=strict).outcome == "fail"
    with pytest.raises(canrig.CannotStart, match="not a run folder"):
        canrig.Run(output)
    with pytest.raises(canrig.CannotStart, match="not a run folder"):
        canrig.replay(output)


def test_frames_are_those_of_the_log(hold, output):
    run = canrig.simulate(hold, output=output)
    table = run.frames(library="lists")
    logged = [line.split() for line in (run.folder / "bus.log").read_text().splitlines()]
    read = [f"{identifier:03X}#{data}" for identifier, data in zip(table["identifier"], table["data"])]
    assert read == [frame for _, _, frame in logged]
    times = [float(time.strip("()")) for time, _, _ in logged]
    apart = [time - of_scenario for time, of_scenario in zip(times, table["time_seconds"])]
    assert max(apart) - min(apart) < 2e-6
    assert {"sync", "drive_tpdo1", "controller_heartbeat"} <= set(table["message"])


def test_a_message_has_its_signals_as_columns(hold, output):
    run = canrig.simulate(hold, output=output)
    status = run.frames("drive_tpdo1", library="lists")
    positions = [value for value in run.signals("lists")["position_millimetres"] if value is not None]
    assert set(positions) <= set(status["position_millimetres"])
    with pytest.raises(canrig.CannotStart, match="did you mean `drive_tpdo"):
        run.frames("drive_tpdo")


def test_events_have_times_levels_and_texts(output):
    run = canrig.simulate("faults/sensor_stuck", output=output)
    levels = {event.level for event in run.events}
    assert "warning" in levels and "info" in levels
    assert any("operation enabled" in event.text for event in run.events)
    times = [event.time_seconds for event in run.events]
    assert times == sorted(times) and times[0] < 0


def test_recordings_are_exported_to_where_the_caller_says(hold, output, tmp_path):
    run = canrig.simulate(hold, output=output)
    place = run.export("blf", tmp_path / "a b.blf")
    assert place.read_bytes()[:4] == b"LOGG"


def test_processes_in_lockstep_leave_the_same_as_one_process(hold, output):
    one = canrig.simulate(hold, output=output)
    three = canrig.run(hold, output=output, clock="lockstep", bus="embedded")
    assert (one.folder / "bus.log").read_bytes() == (three.folder / "bus.log").read_bytes()
    assert one.verdict == three.verdict


def test_progress_goes_to_who_asks(hold, output, capsys):
    parts = []
    canrig.simulate(hold, output=output, progress=lambda part, text: parts.append(part))
    assert parts == sorted(parts) and parts[-1] == 1.0
    canrig.simulate(hold, output=output, progress=True)
    assert "\r" in capsys.readouterr().err
    canrig.simulate(hold, output=output)
    assert capsys.readouterr() == ("", "")


def test_what_ships_is_listed_and_copied(tmp_path):
    listed = canrig.examples()
    assert listed["step"] == "25 mm step from a warm hold"
    assert {"faults/sensor_stuck", "sweeps/plants", "rigs/rig"} <= set(listed)
    canrig.check("step")
    canrig.check("rigs/rig")
    folder = canrig.copy_examples(tmp_path / "a folder", "step", "rigs/rig")
    copied = {str(path.relative_to(folder)) for path in folder.rglob("*.*")}
    assert copied == {"step.toml", "rigs/rig.toml", "schema.json", "rig_schema.json"}
    canrig.check(folder)
    with pytest.raises(canrig.BenchFailed, match="nothing is overwritten"):
        canrig.copy_examples(folder, "step")
    with pytest.raises(canrig.UsageError, match="did you mean `step`"):
        canrig.copy_examples(folder, "stepp")
