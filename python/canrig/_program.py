"""Finds the program, starts it, and ends it in order."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from ._errors import ProgramMissing, ProgramTooOld

#: Names another program, such as a bench with a plant of your own.
VARIABLE = "CANRIG_PROGRAM"
#: The oldest program that does what this package asks for.
OLDEST = (0, 2)
#: An interrupted bench may cool a wire and write its files.
PATIENCE_SECONDS = 60.0

Event = Dict[str, Any]

_versions: Dict[Tuple[str, int], Tuple[int, ...]] = {}


def program() -> Path:
    """The program that is started: ``CANRIG_PROGRAM``, else the one of this installation, else that on the ``PATH``.

    Raises :class:`ProgramMissing` or :class:`ProgramTooOld`.
    """
    path = _find()
    found = _version_of(path)
    if found < OLDEST:
        words = ".".join(map(str, found))
        oldest = ".".join(map(str, OLDEST))
        raise ProgramTooOld(
            f"{path} is canrig {words}, and this package needs {oldest} or newer: "
            f"install the wheel again, or let {VARIABLE} name a newer program"
        )
    return path


def version() -> str:
    """The version of the program."""
    return ".".join(map(str, _version_of(program())))


def _find() -> Path:
    named = os.environ.get(VARIABLE)
    if named:
        found = shutil.which(named)
        if found is None:
            raise ProgramMissing(f"{VARIABLE} is {named!r}, and there is no such program")
        return Path(found)
    for folder in _folders():
        candidate = folder / "canrig"
        if candidate.is_file() and os.access(candidate, os.X_OK):
            return candidate
    on_path = shutil.which("canrig")
    if on_path is None:
        raise ProgramMissing(
            "the program canrig is neither in this installation nor on the PATH: install the wheel again, "
            f"or let {VARIABLE} name the program"
        )
    return Path(on_path)


def _folders() -> List[Path]:
    """Where installers put programs: of this environment, of the user, of ``pip install --target``."""
    folders = [Path(sysconfig.get_path("scripts"))]
    scheme = f"{os.name}_user"
    if scheme in sysconfig.get_scheme_names():
        folders.append(Path(sysconfig.get_path("scripts", scheme)))
    folders.append(Path(__file__).resolve().parent.parent / "bin")
    return folders


def _version_of(path: Path) -> Tuple[int, ...]:
    try:
        key = (str(path), path.stat().st_mtime_ns)
        if key not in _versions:
            answer = subprocess.run(
                [str(path), "--version"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                check=False,
            ).stdout.decode("utf-8", "replace")
            found = re.search(r"(\d+)\.(\d+)\.(\d+)", answer)
            if found is None:
                raise ProgramMissing(f"{path} is not canrig: it does not say its version")
            _versions[key] = tuple(int(part) for part in found.groups())
        return _versions[key]
    except OSError as error:
        raise ProgramMissing(f"{path} cannot be started: {error}") from error


class Ended:
    """Exit code and output of the program."""

    def __init__(self, code: int, output: bytes, message: str) -> None:
        self.code = code
        self.output = output
        self.message = message


def call(arguments: Sequence[str], on_event: Optional[Callable[[Event], None]] = None) -> Ended:
    """Starts the program and waits for its end. With ``on_event`` it gets each line of the output, which is JSON.

    If the wait is interrupted, for example by Ctrl-C, the program is asked to stop, and waited for.
    """
    command = [str(program()), *arguments]
    # A terminal sends Ctrl-C to the whole group. On the main thread Python gets it too and hands it on, so the program has a
    # group of its own and gets it once. No other thread gets it, so there the program stays in the terminal's group.
    is_main = threading.current_thread() is threading.main_thread()
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "NO_COLOR": "1"},
        start_new_session=is_main,
    )
    said: List[bytes] = []
    output: List[bytes] = []
    reader = threading.Thread(target=_read_all, args=(process.stderr, said), daemon=True)
    reader.start()
    try:
        assert process.stdout is not None
        if on_event is None:
            output.append(process.stdout.read())
        else:
            for line in process.stdout:
                on_event(json.loads(line))
        code = process.wait()
    except BaseException:
        _stop(process)
        raise
    finally:
        reader.join(PATIENCE_SECONDS)
        if process.stdout is not None:
            process.stdout.close()
    text = b"".join(said).decode("utf-8", "replace")
    return Ended(code, b"".join(output), _without_prefix(text))


def _read_all(pipe: Any, into: List[bytes]) -> None:
    with pipe:
        for line in pipe:
            into.append(line)


def _stop(process: "subprocess.Popen[bytes]") -> None:
    """Lets the program end in order. Its output is still read, so that it never waits for a reader."""
    drain = threading.Thread(target=_read_all, args=(process.stdout, []), daemon=True)
    drain.start()
    process.send_signal(signal.SIGINT)
    while True:
        try:
            process.wait(PATIENCE_SECONDS)
            break
        except subprocess.TimeoutExpired:
            # Its nodes take the current away by themselves when it is gone.
            process.kill()
        except KeyboardInterrupt:
            print("canrig: the bench is ending", file=sys.stderr)
    drain.join(PATIENCE_SECONDS)


def _without_prefix(text: str) -> str:
    lines = text.strip("\n").splitlines()
    return "\n".join(line[len("canrig: ") :] if line.startswith("canrig: ") else line for line in lines)
