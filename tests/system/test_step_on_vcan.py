"""The step in lock-step on a CAN bus of a kernel: its run folder is whole, another program on the bus heard the same frames, and
another implementation decodes them with the DBC."""

import csv
import json
import re
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as xml

import pytest
from conftest import ROOT, only

pytestmark = pytest.mark.vcan

# The listener has a large buffer, since it must not lose a frame.
COMMAND = """
    candump -L -r 16777216 vcan0 >"$2" &
    until grep -q " vcan0 .* raw" /proc/net/can/rcvlist_all; do sleep 0.05; done
    "$1" run scenarios/step.toml --bus vcan0 --require-vcan --clock lockstep --output "$3"
    # The listener may be behind; it is done when its log no longer grows.
    size=-1
    until [[ $(stat -c %s "$2") -eq $size ]]; do size=$(stat -c %s "$2"); sleep 1; done
    kill $!
    wait || true
"""
MESSAGES = ("sync", "drive_tpdo1", "drive_tpdo2", "drive_rpdo1", "controller_tpdo1")


def test_the_folder_is_whole_and_another_program_heard_the_same(plays_on_can, require, canrig, tmp_path):
    require("can-utils", "candump")
    heard, runs = tmp_path / "heard.log", tmp_path / "runs"
    plays_on_can("bash", "-euc", COMMAND, "-", canrig, heard, runs)
    folder = only(runs)
    is_whole(folder)
    frames = [[line.split()[2] for line in path.read_text().splitlines()] for path in (folder / "bus.log", heard)]
    assert frames[0] == frames[1], f"candump heard {len(frames[1])} frames, bus.log has {len(frames[0])}, or they differ"
    is_decoded(cycle_of_all(heard.read_text().splitlines()))


def is_whole(folder):
    scenario = tomllib.loads((folder / "scenario.toml").read_text())
    verdict = json.loads((folder / "verdict.json").read_text())
    limited = [metric for metric in verdict["metrics"] if "limit" in metric]
    assert verdict["outcome"] == "pass", verdict["outcome"]
    assert {metric["name"] for metric in limited} == set(scenario["expect"]) - {"requirements"}, "limits and metrics differ"
    assert all(metric["passed"] for metric in limited)

    suite = xml.parse(folder / "junit.xml").getroot()
    assert suite.get("failures") == "0" and suite.get("errors") == "0", suite.attrib
    assert int(suite.get("tests")) >= 1

    period_seconds = scenario.get("bus", {}).get("sync_period_milliseconds", 1.0) / 1e3
    with open(folder / "signals.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == round(scenario["duration_seconds"] / period_seconds), len(rows)
    assert all(row["position_millimetres"] and row["current_amperes"] for row in rows)
    assert (folder / "run.rrd").read_bytes()[:3] == b"RRF"


def cycle_of_all(lines):
    """Lines of a cycle in the middle of the step, from SYNC to SYNC, in which the controller sends its slow PDOs too."""
    syncs = [place for place, line in enumerate(lines) if line.split()[2].startswith("080#")]
    for begin, end in zip(syncs[10_100:], syncs[10_101:]):
        if any(" 181#" in line for line in lines[begin:end]):
            return lines[begin:end]
    raise AssertionError("in no cycle does the controller send its slow PDOs")


def is_decoded(lines):
    command = [sys.executable, "-m", "cantools", "decode", "--single-line", ROOT / "dbc/sma_actuator.dbc"]
    decoded = subprocess.run(command, input="\n".join(lines) + "\n", capture_output=True, text=True, check=True).stdout
    for message in MESSAGES:
        assert re.search(rf":: {message}\(", decoded), f"no {message} in the cycle:\n{decoded}"
