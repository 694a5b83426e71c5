"""The step on plants that the law does not know, a tenth of what benches/compare/unknown_plants measures."""

import subprocess
import sys

import pytest
from conftest import ROOT


@pytest.mark.slow
def test_the_law_settles_what_knowledge_settles(release, tmp_path):
    command = [sys.executable, ROOT / "benches/compare/unknown_plants", release, "--draws", "200", "--seeds", "1", "--output", tmp_path]
    subprocess.run(command, check=True)


def test_wires_that_remember_their_turns_come_to_rest(release, tmp_path):
    """30 plants of each kinetics that the law does not know, without and with noise: each settles, and none hunts.

    The seed is that of a fixed commit, so that a test that passes goes on to pass."""
    commit = "39333ac2837dfb028daf317c728458dccdff9022"
    kinetics = ["--ranges", "1 ×", "--draws", "30", "--seeds", "1", "--commit", commit, "--kinetics", "nested", "preisach"]
    command = [sys.executable, ROOT / "benches/compare/unknown_plants", release, *kinetics, "--output", tmp_path]
    table = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = [[cell.strip() for cell in line.split("|")] for line in table.splitlines() if line.startswith("| 1 ×")]
    assert [(row[2], row[4], row[5], row[6]) for row in rows] == [
        (kinetics, noise, "30", "0") for kinetics in ("nested", "preisach") for noise in ("0", "0.03")
    ], table
    # The median is that of the paper's wire; the slowest takes up to three times as long, which this is not to hide.
    for row in rows:
        median, most, *slowest = [float(value) for value in row[9].split(", ")]
        assert median <= 0.21 and most <= 0.3 and max(slowest) <= 0.8, table
