"""FMUs of plants, by the library in the wheel."""

import subprocess
import zipfile

import canrig
import pytest


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_plant_becomes_an_fmu(tmp_path, fmi):
    path = tmp_path / "motor.fmu"
    command = [canrig.program(), "fmu", "--export", "dc_motor", "--output", path, "--fmi", fmi]
    subprocess.run(list(map(str, command)), check=True)
    with zipfile.ZipFile(path) as fmu:
        libraries = [name for name in fmu.namelist() if name.startswith("binaries/")]
        assert len(libraries) == 1
        assert fmu.read(libraries[0])[:4] == b"\x7fELF"
