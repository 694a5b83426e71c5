"""The runner's side of a driver for Zephyr's native_sim, on a stand-in of the native simulator."""

import subprocess

from conftest import ROOT


def test_a_controller_plays_as_without_a_simulator(canrig):
    subprocess.run([ROOT / "tests/native_sim/play", canrig], check=True)
