"""`canrig new`: a law, plants and controllers in C and Python are generated, built, tested and played."""

import subprocess

from conftest import ROOT


def test_generated_crates_and_controllers(release):
    subprocess.run([ROOT / "tests/system/new_crates", release], check=True)
