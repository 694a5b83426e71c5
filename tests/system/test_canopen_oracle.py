"""python-canopen as judge of canrig's CANopen, on a CAN bus of a kernel."""

import sys

import pytest
from stalls import while_time_flows

pytestmark = pytest.mark.vcan


@pytest.fixture
def judge(plays_on_can):
    """A function that lets a program of tests/oracle judge a program of ours."""

    def judge(name, program, *more):
        command = [sys.executable, f"tests/oracle/{name}.py", program, "vcan0", *more]
        return while_time_flows(lambda: plays_on_can(*command))

    return judge


def test_it_is_the_manager_of_drive_and_disturbance_module(judge, canrig):
    assert "python-canopen as manager: all passed" in judge("manager", canrig)


@pytest.mark.slow
def test_it_is_the_manager_of_four_drives(judge, canrig):
    assert "python-canopen as manager of four drives: all passed" in judge("four_drives", canrig)


def test_it_is_a_drive_under_our_controller(judge, canrig):
    judge("foreign_drive", canrig)


def test_long_values_in_segments_and_blocks(judge, release):
    assert "python-canopen with long values: all passed" in judge("store", release / "examples/eds_device")


@pytest.mark.slow
def test_round_trips_are_not_slower(judge, canrig, release):
    assert "ratio" in judge("round_trips", canrig, release / "examples/sdo_round_trips")
