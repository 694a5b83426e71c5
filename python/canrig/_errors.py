"""Errors of the program, by its exit codes."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Optional

if TYPE_CHECKING:
    from ._run import Run


class ExitCode(IntEnum):
    """How the program ended."""

    PASS = 0
    #: A limit was not met, or a node under test ended the run.
    VERDICT_FAILED = 1
    #: The command line is wrong.
    USAGE = 2
    #: What was asked for cannot begin: a file is invalid, a program or a plant cannot be started.
    CANNOT_START = 3
    #: A part of canrig failed, or the bus, or a file cannot be written.
    BENCH_FAILED = 4
    #: The timing is not trustworthy, or a limit is on a value that no node sends.
    INCONCLUSIVE = 5
    #: The program itself is at fault.
    INTERNAL = 70
    #: Stopped by the user.
    INTERRUPTED = 130


class CanrigError(Exception):
    """The program could not do its work; the text is the program's message.

    A verdict other than "pass" is not an error: :attr:`canrig.Run.outcome` has it.
    """

    #: How the program ended; ``None`` where it was never started, and where a signal killed it.
    exit_code: Optional[ExitCode] = None

    def __init__(self, message: str, run: Optional[Run] = None) -> None:
        super().__init__(message)
        #: What the program says.
        self.message = message
        #: What there is of the run; ``None`` where nothing was recorded.
        self.run = run


class UsageError(CanrigError):
    """Options that do not go together, or a folder without scenarios."""

    exit_code = ExitCode.USAGE


class CannotStart(CanrigError):
    """A scenario, a rig file or a recording is invalid or missing, or a program or a plant cannot be started."""

    exit_code = ExitCode.CANNOT_START


class BenchFailed(CanrigError):
    """A part of canrig failed or was killed, the bus failed, or a file cannot be written."""

    exit_code: Optional[ExitCode] = ExitCode.BENCH_FAILED


class InternalError(CanrigError):
    """A fault of the program; please report it."""

    exit_code = ExitCode.INTERNAL


class Interrupted(CanrigError):
    """Another process stopped the program. Ctrl-C in Python raises ``KeyboardInterrupt``."""

    exit_code = ExitCode.INTERRUPTED


class ProgramMissing(CanrigError):
    """The program canrig was not found."""


class ProgramTooOld(CanrigError):
    """The program that was found is older than this package."""


_OF_EXIT = {
    error.exit_code: error
    for error in (UsageError, CannotStart, BenchFailed, InternalError, Interrupted)
}


def error_of(code: int, message: str, run: Optional[Run] = None) -> CanrigError:
    """The exception for an exit code that does not stand for a verdict."""
    try:
        kind = _OF_EXIT[ExitCode(code)]
    except (KeyError, ValueError):
        how = f"signal {-code} killed it" if code < 0 else f"it ended with exit code {code}"
        said = f"\n{message}" if message else ""
        error = BenchFailed(f"the program did not end by itself: {how}{said}", run)
        error.exit_code = None
        return error
    return kind(message or f"the program ended with exit code {code} and did not say why", run)
