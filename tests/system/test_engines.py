"""Campaigns on Slurm and HyperQueue for real, with nodes, workers and tasks that are lost on the way; the manifest for Kubernetes is
validated. What is merged is what one machine plays, to the byte. As root the campaigns are played by nobody."""

import subprocess
import sys

import pytest
from conftest import ROOT

pytestmark = pytest.mark.engines


def play(canrig, part):
    # Not in this process, since it becomes an ordinary user.
    subprocess.run([sys.executable, ROOT / "tests/system/campaigns.py", canrig, part], check=True)


def test_one_machine_and_the_manifest_for_kubernetes(canrig):
    play(canrig, "alone")


def test_hyperqueue(canrig):
    play(canrig, "hyperqueue")


@pytest.mark.slow
def test_slurm(require, canrig):
    require("slurmctld slurmd slurm-client", "slurmctld", "slurmd", "sbatch")
    play(canrig, "slurm")
