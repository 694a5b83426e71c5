"""The step on plants that the law does not know, a tenth of what benches/compare/unknown_plants measures."""

import subprocess
import sys

import pytest
from conftest import ROOT


@pytest.mark.slow
def test_the_law_settles_what_knowledge_settles(release, tmp_path):
    command = [sys.executable, ROOT / "benches/compare/unknown_plants", release, "--draws", "200", "--seeds", "1", "--output", tmp_path]
    subprocess.run(command, check=True)
