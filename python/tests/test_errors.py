"""Errors, in the program's words."""

import os

import canrig
import pytest


def test_an_invalid_scenario_is_underlined(hold, output):
    hold.write_text(hold.read_text().replace("duration_seconds", "duration_second"))
    for play in (canrig.simulate, canrig.run):
        with pytest.raises(canrig.CannotStart, match="duration_seconds") as raised:
            play(hold, output=output)
        assert raised.value.exit_code is canrig.ExitCode.CANNOT_START == 3
        assert raised.value.run is None
        assert "hold.toml" in raised.value.message
    with pytest.raises(canrig.CannotStart, match="duration_seconds"):
        canrig.check(hold)
    with pytest.raises(canrig.CannotStart, match="duration_seconds"):
        canrig.sweep(hold, output=output)


def test_what_is_no_scenario_is_refused(tmp_path, output):
    with pytest.raises(canrig.CannotStart, match="did you mean `step`"):
        canrig.simulate("stepp", output=output)
    with pytest.raises(canrig.CannotStart, match="there is no such file"):
        canrig.simulate(tmp_path / "none.toml", output=output)
    with pytest.raises(canrig.CannotStart, match="one by one"):
        canrig.simulate(tmp_path, output=output)
    with pytest.raises(canrig.CannotStart):
        canrig.simulate("rigs/rig", output=output)
    with pytest.raises(canrig.CannotStart, match=r"no \[sweep\] table"):
        canrig.sweep("step", output=output)
    assert not output.exists()


def test_values_that_do_not_fit_are_refused(output):
    with pytest.raises(canrig.CannotStart, match="there is no step 7"):
        canrig.simulate("step", {"reference.step[7].position_millimetres": 1}, output=output)
    with pytest.raises(canrig.CannotStart, match="mechanics"):
        canrig.simulate("step", {"plant.wire.mechanic.load_kilograms": 0.04}, output=output)
    with pytest.raises(canrig.CannotStart, match="out of range"):
        canrig.simulate("step", {"plant.wire.mechanics.load_kilograms": -1}, output=output)


def test_a_folder_that_takes_no_files_is_named(hold):
    # Root may write everywhere but here.
    for play in (canrig.simulate, canrig.sweep):
        scenario = hold if play is canrig.simulate else "sweeps/plants"
        with pytest.raises(canrig.BenchFailed, match="/proc/runs.* cannot be written") as raised:
            play(scenario, output="/proc/runs")
        assert raised.value.exit_code is canrig.ExitCode.BENCH_FAILED


def test_an_interface_that_is_not_there_is_named(hold, output):
    with pytest.raises(canrig.BenchFailed, match="nocan7|no CAN"):
        canrig.run(hold, output=output, clock="lockstep", bus="nocan7")
    with pytest.raises(canrig.UsageError, match="sundial"):
        canrig.run(hold, output=output, clock="sundial")


def test_a_rig_is_a_file_or_one_that_ships(hold, output):
    with pytest.raises(canrig.CannotStart, match="the rig file rigs/another does not exist"):
        canrig.run(hold, output=output, rig="rigs/another")
    # It is found; its drive is a real one, which keeps its own time.
    with pytest.raises(canrig.CannotStart, match="keeps its own time"):
        canrig.run(hold, output=output, rig="rigs/rig", clock="lockstep")


def test_a_missing_program_says_what_to_do(monkeypatch, hold, tmp_path):
    monkeypatch.setenv("CANRIG_PROGRAM", str(tmp_path / "none"))
    with pytest.raises(canrig.ProgramMissing, match="no such program"):
        canrig.simulate(hold)
    monkeypatch.delenv("CANRIG_PROGRAM")
    monkeypatch.setattr("canrig._program._folders", lambda: [])
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(canrig.ProgramMissing, match="install the wheel again"):
        canrig.program()


def test_an_older_program_is_refused(monkeypatch, fake, hold):
    monkeypatch.setenv("FAKE_VERSION", "0.1.9")
    with pytest.raises(canrig.ProgramTooOld, match=r"is canrig 0\.1\.9, and this package needs 0\.2"):
        canrig.simulate(hold)
    assert fake.calls == []


def test_another_program_is_refused(monkeypatch, hold):
    monkeypatch.setenv("CANRIG_PROGRAM", "/bin/true")
    with pytest.raises(canrig.ProgramMissing, match="is not canrig"):
        canrig.simulate(hold)


def test_a_program_that_was_killed_is_an_error(monkeypatch, tmp_path, hold):
    program = tmp_path / "killed"
    program.write_text('#!/bin/sh\n[ "$1" = --version ] && echo canrig 9.9.9 && exit\nkill -9 $$\n')
    program.chmod(0o755)
    monkeypatch.setenv("CANRIG_PROGRAM", str(program))
    with pytest.raises(canrig.BenchFailed, match="signal 9") as raised:
        canrig.simulate(hold)
    assert raised.value.exit_code is None


def test_what_was_recorded_of_a_run_that_broke_off_is_there(monkeypatch, fake, hold):
    monkeypatch.setenv("FAKE_OUTCOME", "incomplete:4")
    with pytest.raises(canrig.BenchFailed, match="so it is") as raised:
        canrig.run(hold)
    assert raised.value.run.outcome == "incomplete"


@pytest.mark.parametrize("name", ["a b", "$(touch x)", "; ls", "'", '"', "-q", "--help", "ä"])
def test_no_name_is_taken_for_anything_else(name, tmp_path, monkeypatch, hold):
    monkeypatch.chdir(tmp_path)
    os.mkdir(name)
    scenario = os.path.join(name, name + ".toml")
    os.rename(hold, scenario)
    run = canrig.simulate(scenario, output=name)
    assert run.passed and str(run.folder.parent) == name
    assert run.frames(library="lists")["data"]
    canrig.check(scenario)
    assert sorted(os.listdir(tmp_path)) == [name]


def test_a_name_with_a_line_end_is_refused(tmp_path, monkeypatch, hold):
    monkeypatch.chdir(tmp_path)
    os.rename(hold, "a\n.toml")
    with pytest.raises(canrig.UsageError, match="line end"):
        canrig.simulate("a\n.toml")
    with pytest.raises(canrig.UsageError, match="line end"):
        canrig.check("a\n.toml")
    with pytest.raises(canrig.UsageError, match="line end"):
        canrig.replay("a\n.toml")
