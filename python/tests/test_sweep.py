"""Sweeps and their tables."""

import canrig
import pytest

SWEEP = """
[sweep]
draws = 2
[[sweep.list]]
key = "reference.hold[0].position_millimetres"
values = [5, 15]
[[sweep.uniform]]
key = "plant.wire.mechanics.load_kilograms"
from = 0.036
to = 0.044
"""


@pytest.fixture
def swept(hold):
    hold.write_text(hold.read_text() + SWEEP)
    return hold


def test_a_sweep_has_one_row_for_each_run(swept, output):
    parts = []
    sweep = canrig.sweep(swept, output=output, threads=2, progress=lambda part, text: parts.append((part, text)))
    table = sweep.table("lists")
    assert table["case"] == [1, 2, 3, 4]
    assert table["reference.hold[0].position_millimetres"] == [5, 5, 15, 15]
    assert all(0.036 <= value <= 0.044 for value in table["plant.wire.mechanics.load_kilograms"])
    assert table["verdict"] == ["pass"] * 4 and sweep.passed
    assert all(isinstance(value, float) for value in table["current_amperes_rms"])
    assert sweep.exit_code is canrig.ExitCode.PASS
    assert parts[-1] == (1.0, "4 of 4 runs") and sweep.report.is_file()
    assert len(sweep.table()["case"]) == 4


def test_runs_that_do_not_pass_can_be_played_alone(swept, output):
    sweep = canrig.sweep(swept, {"expect.current_amperes_rms": {"max": 0.001}}, output=output)
    assert not sweep.passed and sweep.exit_code is canrig.ExitCode.VERDICT_FAILED
    assert len(sweep.failing) == 4
    alone = canrig.simulate(sweep.failing[0], output=output)
    assert alone.outcome == "fail"
    assert alone.verdict["current_amperes_rms"].value == sweep.table("lists")["current_amperes_rms"][0]


def test_the_same_call_finds_what_was_played(swept, output):
    first = canrig.sweep(swept, output=output)
    parts = []
    again = canrig.sweep(swept, output=output, progress=lambda part, text: parts.append(part))
    assert again.folder == first.folder and set(parts) == {1.0}
    assert canrig.Sweep(first.folder).table("lists") == first.table("lists")
    with pytest.raises(canrig.CannotStart, match="runs.csv"):
        canrig.Sweep(output)
