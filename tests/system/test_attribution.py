"""Foreign controllers, drives and masters that misbehave, and stalls of the machine, in real time on canrig's embedded bus: the verdict
names the node that is the cause. No root and no kernel CAN are needed.

Each case of tests/data/attribution/cases.txt is played up to three times, until its outcome and its cause are those."""

import itertools
import json
import sys

import pytest
from conftest import ROOT
from stalls import while_time_flows

sys.path.insert(0, str(ROOT / "tests/misbehaving"))

import archive  # noqa: E402
import play  # noqa: E402

TRIES = 3
EXPECTED = archive.read_cases()
# Played for each change.
SOME = ["controller/killed_at_1s", "master/nmt_stops_the_drive"]


def attributed(canrig, case, tmp_path):
    found, distrust = [], []
    for attempt in range(TRIES):
        folder = tmp_path / str(attempt)
        folder.mkdir(parents=True)
        run = play.play(canrig, case, folder)
        found.append(play.found(canrig, run))
        if play.matches(EXPECTED[case], found[-1]):
            return
        distrust += json.loads((run / "verdict.json").read_text()).get("timing", {}).get("distrust", [])
    raise AssertionError(f"{case}: {found}, expected {EXPECTED[case]}; {distrust}")


def while_the_machine_is_quiet(canrig, case, tmp_path):
    numbers = itertools.count()
    while_time_flows(lambda: attributed(canrig, case, tmp_path / str(next(numbers))))


@pytest.mark.parametrize("case", SOME)
def test_the_cause_is_named(canrig, case, tmp_path):
    while_the_machine_is_quiet(canrig, case, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("case", sorted(set(play.names()) - set(SOME)))
def test_the_cause_of_each_case_is_named(canrig, case, tmp_path):
    while_the_machine_is_quiet(canrig, case, tmp_path)
