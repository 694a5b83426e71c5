"""Fixtures of several tests. The tests are of an installed wheel: they find neither package nor program in the checkout."""

from pathlib import Path

import canrig
import pytest

pytest_plugins = ["pytester"]

HOLD = """\
schema = 1
rig = "sma_actuator"
name = "{name}"
duration_seconds = {seconds}
requirements = ["HOLD-1"]

[bus]
sync_period_milliseconds = {period}

[controller.pid]

[[reference.hold]]
at_seconds = 0.0
position_millimetres = 10.0

[expect]
current_amperes_rms = {{ max = {limit} }}

[expect.requirements]
current_amperes_rms = ["HOLD-2"]
"""


def write_hold(path: Path, name="hold", seconds=0.3, period=1.0, limit=5.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(HOLD.format(name=name, seconds=seconds, period=period, limit=limit))
    return path


@pytest.fixture
def hold(tmp_path):
    """A short scenario that passes."""
    return write_hold(tmp_path / "hold.toml")


@pytest.fixture
def strict(tmp_path):
    """A short scenario that fails."""
    return write_hold(tmp_path / "strict.toml", name="strict hold", limit=0.001)


@pytest.fixture
def output(tmp_path):
    return tmp_path / "runs"


FAKE = '''\
#!{python}
"""Writes down how it is called, and leaves the verdict that it is asked for."""
import json, os, pathlib, sys, time
if sys.argv[1] == "check":
    os.execv({real!r}, [{real!r}, *sys.argv[1:]])
place = pathlib.Path(__file__).parent
if sys.argv[1:] == ["--version"]:
    print("canrig " + os.environ.get("FAKE_VERSION", "9.9.9"))
    raise SystemExit
begun = time.monotonic()
time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
folder = place / f"run-{{os.getpid()}}"
folder.mkdir()
outcome, code = os.environ.get("FAKE_OUTCOME", "pass:0").split(":")
verdict = dict(scenario="fake", version="9.9.9", outcome=outcome, reason="so it is", metrics=[])
(folder / "verdict.json").write_text(json.dumps(verdict))
print(json.dumps(dict(event="judged", folder=str(folder), exit=int(code))))
with open(place / "calls", "a") as calls:
    calls.write(json.dumps([begun, time.monotonic(), sys.argv[1:]]) + "\\n")
raise SystemExit(int(code))
'''


class FakeProgram:
    """A program in place of canrig."""

    def __init__(self, folder, monkeypatch):
        import sys

        # What is collected does not depend on what plays.
        real = str(canrig.program())
        self.path = folder / "fake canrig"
        self.path.write_text(FAKE.format(python=sys.executable, real=real))
        self.path.chmod(0o755)
        monkeypatch.setenv("CANRIG_PROGRAM", str(self.path))

    @property
    def calls(self):
        """Begin, end and arguments of each call that plays."""
        import json

        calls = self.path.parent / "calls"
        return [json.loads(line) for line in calls.read_text().splitlines()] if calls.exists() else []


@pytest.fixture
def fake(tmp_path_factory, monkeypatch):
    return FakeProgram(tmp_path_factory.mktemp("fake"), monkeypatch)
