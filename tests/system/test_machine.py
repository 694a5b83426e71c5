"""Faults of a machine during a run, and a drive behind CAN controllers with a real driver; both are scripts that are run by the
kernel to which it is done."""

import pytest
from conftest import ROOT
from stalls import while_time_flows

pytestmark = pytest.mark.vcan


def test_full_disks_wrong_clocks_and_a_bus_that_goes_away(require, plays_on_can, canrig):
    require("user-mode-linux", "linux.uml")
    script = ROOT / "tests/system/machine_faults"
    while_time_flows(lambda: plays_on_can(script, canrig, timeout=400, options=["--own-kernel"]))


def test_a_drive_across_two_can_controllers(require, plays_on_can, release):
    require("qemu-system-x86 busybox-static", "qemu-system-x86_64", "busybox")
    plays_on_can(ROOT / "tests/system/can_controllers", release, options=["--sja1000"])
