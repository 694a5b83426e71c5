"""Identification of plants that are drawn, a twentieth of what benches/compare/identified_plants plays."""

import subprocess
import sys

from conftest import ROOT


def test_right_answers_are_confirmed(release):
    # The whole hash names the same plants also where that commit is not cloned.
    commit = ["--commit", "fdfb730486c2908188b885f5a191180b31259a6a"]
    counts = ["--six", "3", "--nine", "1"]
    command = [sys.executable, ROOT / "benches/compare/identified_plants", release, *commit, *counts]
    done = subprocess.run(command, text=True, stdout=subprocess.PIPE, check=False)
    assert done.returncode == 0 and "| six | 3 | 3 | 0: 3 |" in done.stdout, done.stdout
