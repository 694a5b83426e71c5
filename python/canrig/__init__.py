"""Plays and judges scenarios from Python, and gives their recordings as data frames.

The package starts the program ``canrig`` that came with it and reads the files that it leaves. It needs no other package;
data frames come from polars or pandas where one is installed.

>>> import canrig
>>> run = canrig.simulate("step", {"reference.step[0].position_millimetres": 20})
>>> run.outcome
'pass'
>>> frame = run.signals()
"""

from ._commands import check, copy_examples, examples, replay, run, simulate, sweep
from ._errors import (
    BenchFailed,
    CannotStart,
    CanrigError,
    ExitCode,
    InternalError,
    Interrupted,
    ProgramMissing,
    ProgramTooOld,
    UsageError,
)
from ._program import program, version
from ._run import Event, Metric, Run, Verdict
from ._sweep import Sweep
from ._tables import LibraryMissing

__all__ = [
    "BenchFailed",
    "CannotStart",
    "CanrigError",
    "Event",
    "ExitCode",
    "InternalError",
    "Interrupted",
    "LibraryMissing",
    "Metric",
    "ProgramMissing",
    "ProgramTooOld",
    "Run",
    "Sweep",
    "UsageError",
    "Verdict",
    "check",
    "copy_examples",
    "examples",
    "program",
    "replay",
    "run",
    "simulate",
    "sweep",
    "version",
]
