"""Feeds canrig files that are gigantic, endless, deep, or lies: each case ends within PATIENCE_SECONDS and MEMORY_BYTES, with the
documented exit code and a message that says what is wrong."""

import os
import pathlib
import re
import resource
import subprocess
import unicodedata

import pytest

PATIENCE_SECONDS = 30
MEMORY_BYTES = 2 << 30
LONG = 100_000_000
SCENARIO = """schema = 1
rig = "sma_actuator"
name = "hold"
duration_seconds = 0.5

[controller.sliding_mode]
"""
HOLD = """
[[reference.hold]]
at_seconds = 0.0
position_millimetres = 10.0
"""
TABLE = """
[[reference.table]]
from_seconds = 0.0
file = "{}"
"""
USAGE, INVALID, FAILED = 2, 3, 4


class Bench:
    def __init__(self, canrig, folder):
        self.canrig, self.folder = canrig, folder

    def file(self, name, content):
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    def link(self, name, target):
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(target)
        return path

    def case(self, name, code, text, *command):
        def limit():
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))

        try:
            ended = subprocess.run(
                [self.canrig, *map(str, command)],
                capture_output=True,
                timeout=PATIENCE_SECONDS,
                preexec_fn=limit,
                cwd=self.folder,
                env={**os.environ, "XDG_RUNTIME_DIR": str(self.folder)},
            )
            status = ended.returncode
            told = (ended.stdout + ended.stderr).decode(errors="replace")
        except subprocess.TimeoutExpired:
            status, told = "still running", ""
        told = told.replace(str(self.folder), "")
        steers = any(unicodedata.category(character) in ("Cc", "Cf") for character in told if character not in "\n\t")
        assert status == code, f"{name}: {status} instead of {code}:\n{told[-1500:]}"
        assert text in " ".join(told.split()), f"{name} does not say {text!r}:\n{told[-1500:]}"
        assert not steers and len(told) < 20_000, f"{name}: {len(told)} characters:\n{told[-1500:]!r}"
        assert "panicked" not in told and "internal error" not in told, f"{name}:\n{told[-1500:]}"


@pytest.fixture
def bench(canrig, tmp_path):
    return Bench(canrig, tmp_path)


@pytest.fixture
def run(bench):
    """A run folder to spoil."""
    bench.case("a run to spoil", 0, "pass", "simulate", bench.file("hold.toml", SCENARIO + HOLD), "--output", "runs")
    (run,) = (bench.folder / "runs").iterdir()
    return run


def test_scenarios(bench):
    def check(name, text, content):
        bench.case(f"scenario, {name}", INVALID, text, "check", bench.file("scenario.toml", content))

    check("a line of 100 MB", "longer than", SCENARIO + 'notes = "' + "x" * LONG + '"\n' + HOLD)
    check("100 000 brackets", "recursion", SCENARIO + "notes = " + "[" * 100_000)
    check("100 000 tables in each other", "recursion", SCENARIO + "[" + ".".join("a" * 100_000) + "]\n")
    check("NaN", "finite", SCENARIO.replace("0.5", "nan") + HOLD)
    check("infinity", "finite", SCENARIO.replace("0.5", "inf") + HOLD)
    check("1e400", "finite", SCENARIO.replace("0.5", "1e400") + HOLD)
    check("a day of microseconds", "out of range", SCENARIO.replace("0.5", "86400") + "[bus]\nsync_period_milliseconds = 1e-6\n" + HOLD)
    check("no text", "UTF-8", bytes(range(256)) * 10)
    check("a name that is escape codes", "control", SCENARIO.replace('"hold"', r'"\u001b[2J"') + HOLD)
    bench.case("scenario, a device", INVALID, "it is a device, not a file", "check", "/dev/zero")
    os.mkfifo(bench.folder / "pipe.toml")
    bench.case("scenario, a pipe", INVALID, "it is a pipe, not a file", "check", "pipe.toml")
    bench.case("scenario, a line of escape codes", INVALID, r"\u001b]0;title\u0007", "check", bench.file("escapes.toml", "\x1b]0;title\x07\n"))
    bench.case("scenario, a name of escape codes", INVALID, r"\u001b[2J", "check", "\x1b[2J.toml")
    bench.case("an option of escape codes", USAGE, r"\u001b[2J", "\x1b[2J")
    bench.case("scenario, none", INVALID, "no such file", "check", "none.toml")


def test_tables(bench):
    def check(name, text, reference):
        bench.case(f"table, {name}", INVALID, text, "check", bench.file("rig/table.toml", SCENARIO + TABLE.format(reference)))

    bench.file("outside.csv", "time_seconds,position_millimetres\n0,1\n")
    check("out of the folder", "scenario's folder", "../outside.csv")
    check("an absolute path", "absolute path", "/etc/passwd")
    bench.link("rig/link.csv", "../outside.csv")
    check("out of the folder by a link", "outside", "link.csv")
    bench.file("rig/long.csv", "time_seconds,position_millimetres\n" + "1" * LONG)
    check("a line of 100 MB", "longer than", "long.csv")
    bench.file("rig/nan.csv", "time_seconds,position_millimetres\n0,nan\n")
    check("NaN", "finite", "nan.csv")


def test_recordings(bench, run):
    names = ("bus.log", "verdict.json", "scenario.toml", "frames.dbc")
    log, verdict, toml, dbc = paths = [run / name for name in names]
    kept = {path: path.read_bytes() for path in paths}

    def replay(name, code, text, path, content):
        path.unlink()
        if isinstance(content, pathlib.Path):
            path.symlink_to(content)
        else:
            path.write_bytes(content)
        bench.case(f"recording, {name}", code, text, "replay", run)
        path.unlink()
        path.write_bytes(kept[path])

    replay("a log line of 100 MB", FAILED, "line", log, kept[log][:20_000] + b"(1.0) can0 " + b"1" * LONG)
    replay("a log without end", INVALID, "it is a link that leads out of its folder", log, pathlib.Path("/dev/zero"))
    replay("a log of random bytes", INVALID, "more than 1000 lines are no frames", log, os.urandom(1_000_000))
    replay("a log whose time runs backwards", FAILED, "incomplete", log, b"\n".join(reversed(kept[log].splitlines())))
    replay("a verdict of 100 MB", INVALID, "longer than", verdict, b"[" * LONG)
    replay("half a verdict", INVALID, "verdict.json` is damaged", verdict, kept[verdict][:300])
    replay("a verdict without end", INVALID, "it is a link that leads out of its folder", verdict, pathlib.Path("/dev/zero"))
    replay("its scenario without end", INVALID, "it is a link that leads out of its folder", toml, pathlib.Path("/dev/zero"))
    replay("frames without end", INVALID, "it is a link that leads out of its folder", dbc, pathlib.Path("/dev/zero"))
    replay("frames of random bytes", INVALID, "frames.dbc cannot be used", dbc, os.urandom(100_000))
    replay("frames in a line of 1 MB", INVALID, "frames.dbc cannot be used", dbc, b"x" * 1_000_000)


def test_databases(bench, run):
    def dbc(name, text, content):
        path = content if isinstance(content, pathlib.Path) else bench.file("hostile.dbc", content)
        bench.case(f"DBC, {name}", USAGE, text, "identify", run, "--dbc", path)

    shipped = pathlib.Path(__file__).parents[2] / "dbc"
    good = (shipped / "sma_actuator.dbc").read_text()
    signal = next(line for line in good.splitlines() if line.startswith(" SG_ position_millimetres"))
    dbc("a line of 100 MB", "longer than", 'VERSION "' + "x" * LONG + '"\n')
    dbc("without end", "it is a device, not a file", pathlib.Path("/dev/zero"))
    dbc("random bytes", "hostile.dbc", os.urandom(100_000))
    dbc("a scale of NaN", "hostile.dbc", good.replace(signal, signal.replace("(", "(nan*", 1)))
    dbc("a signal of 4 billion bits", "hostile.dbc", good.replace(signal, re.sub(r"\|\d+@", "|4294967295@", signal)))

    def eds(name, text, content, code=USAGE):
        path = content if isinstance(content, pathlib.Path) else bench.file("hostile.eds", content)
        command = ("sdo", "read", "16", "0x1000", "--bus", "embedded", "--eds", path)
        bench.case(f"EDS, {name}", code, text, *command)

    good = (shipped / "drive.eds").read_text()
    eds("a line of 100 MB", "longer than", "[FileInfo]\nFileName=" + "x" * LONG)
    eds("without end", "it is a device, not a file", pathlib.Path("/dev/zero"))
    eds("random bytes", "hostile.eds", os.urandom(100_000))
    # The number is not relied on; what follows is that there is no bus.
    many = re.sub(r"SubNumber=.*", "SubNumber=0xFFFFFFFF", good)
    eds("4 billion sub-objects", "no embedded bus", many, FAILED)
    # Slips are read over, and the notes on them do not grow with their number.
    eds("100 000 lines of garbage", "no embedded bus", good + "garbage\n" * 100_000, FAILED)
    eds("a name of 500 kB", "no embedded bus", good.replace("=Device type", "=" + "x" * 500_000), FAILED)
    eds("100 000 sections", "no embedded bus", good + "[1000]\n" * 100_000, FAILED)
    eds("nothing but garbage", "describes no object", "garbage\n" * 100_000)
    eds("a default that fits no type", "hostile.eds", good.replace("DefaultValue=", "DefaultValue=0xFFFFFFFFFFFFFFFFFF\n;", 1))
