"""The commands of the program, as functions."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Union

from ._errors import CannotStart, ExitCode, error_of
from ._program import Ended, Event, call
from ._progress import Progress, printer
from ._run import Run, StrPath, Verdict
from ._sweep import Sweep

#: Values by key, such as ``{"reference.step[0].position_millimetres": 20}``.
Values = Mapping[str, Any]

_VERDICTS = (ExitCode.PASS, ExitCode.VERDICT_FAILED, ExitCode.INCONCLUSIVE)


def simulate(
    scenario: StrPath,
    values: Optional[Values] = None,
    *,
    output: StrPath = "runs",
    progress: Progress = None,
) -> Run:
    """Plays a scenario in one process and in virtual time, and judges it.

    ``scenario`` is a file, or the name of one that ships. ``values`` replace those of the file, by their dotted keys.
    ``output`` is the folder in which the run folder is made. ``progress`` is a function that is called with the completed
    share and a text; ``True`` shows a line, ``False`` none.

    A run that fails is returned; a scenario that cannot be played raises a :class:`canrig.CanrigError`.
    """
    return _play("simulate", scenario, values, output, progress, [])


def run(
    scenario: StrPath,
    values: Optional[Values] = None,
    *,
    output: StrPath = "runs",
    clock: str = "real-time",
    bus: str = "auto",
    external: Union[str, Sequence[str]] = (),
    rig: Optional[StrPath] = None,
    require_vcan: bool = False,
    progress: Progress = None,
) -> Run:
    """Plays a scenario with controller and plant as processes on a CAN bus, and judges it.

    ``clock`` is "real-time" or "lockstep" (virtual time); ``bus`` is "auto", "private", "embedded" or an interface.
    ``external`` names the node, or the nodes, of the rig that somebody else starts: "drive", "controller", "disturbance". ``rig`` is the rig file, or
    the name of one that ships, that takes the place of the scenario's.
    The other arguments are those of :func:`simulate`.
    """
    options = [f"--clock={clock}", f"--bus={bus}"]
    nodes = [external] if isinstance(external, str) else external
    options.extend(f"--external={node}" for node in nodes)
    if rig is not None:
        options.append(f"--rig={os.fspath(rig)}")
    if require_vcan:
        options.append("--require-vcan")
    return _play("run", scenario, values, output, progress, options)


def sweep(
    scenario: StrPath,
    values: Optional[Values] = None,
    *,
    output: StrPath = "runs",
    threads: Optional[int] = None,
    progress: Progress = None,
) -> Sweep:
    """Plays a scenario with each combination of values in its ``[sweep]`` table, on all cores.

    A sweep that was interrupted is continued by the same call. ``threads`` is the number of runs at a time.
    """
    options = _options(values, output)
    if threads is not None:
        options.append(f"--threads={threads}")
    last: Event = {}
    show = printer(progress)

    def on_event(event: Event) -> None:
        last.update(event)
        if show is not None and event["of"]:
            show(event["done"] / event["of"], f"{event['done']} of {event['of']} runs")

    ended = call(["sweep", "--events", *options, _argument(scenario)], on_event)
    # A row may be invalid, or its run broken off, so the exit code does not say whether there is a table.
    if last.get("event") != "ended":
        raise error_of(ended.code, ended.message)
    played = Sweep(last["folder"])
    played.exit_code = ExitCode(ended.code)
    return played


def replay(recording: Any, *, scenario: Optional[StrPath] = None) -> Verdict:
    """Judges a recording again: a :class:`canrig.Run`, a run folder, or a log of ``candump -L``.

    ``scenario`` is the one whose limits decide; for a log the one that was played.
    """
    path = recording.folder if isinstance(recording, Run) else recording
    options = [] if scenario is None else [f"--scenario={os.fspath(scenario)}"]
    ended = call(["replay", "--json", *options, "--", os.fspath(path)])
    if not ended.output:
        raise error_of(ended.code, ended.message)
    return Verdict._of(ended.output)


def check(scenario: StrPath, values: Optional[Values] = None) -> None:
    """Checks a scenario or a rig file, or a folder of them, without playing it.

    Raises :class:`canrig.CannotStart`, whose text underlines each mistake.
    """
    _succeed(call(["check", *_overrides(values), _argument(scenario)]))


def checked_files(paths: Sequence[StrPath]) -> List[Dict[str, Any]]:
    """What `canrig check --json` says of these files: of each its path, its kind, and whether a run has left it."""
    ended = call(["check", "--json", *map(_argument, paths)])
    try:
        return list(json.loads(ended.output))
    except ValueError:
        raise error_of(ended.code, ended.message) from None


def examples() -> Dict[str, str]:
    """Returns the scenarios and rig files that ship: their descriptions by their names."""
    text = _succeed(call(["examples"])).output.decode("utf-8")
    pairs = (line.split(None, 1) for line in text.splitlines())
    return {name: title for name, title in pairs}


def copy_examples(folder: StrPath, *names: str) -> Path:
    """Copies the scenarios and rig files that ship to a folder: all, or those that are named. No file is overwritten."""
    _succeed(call(["examples", f"--to={os.fspath(folder)}", "--", *names]))
    return Path(folder)


def _play(
    command: str,
    scenario: StrPath,
    values: Optional[Values],
    output: StrPath,
    progress: Progress,
    options: List[str],
) -> Run:
    if Path(scenario).is_dir():
        raise CannotStart(f"{os.fspath(scenario)} is a folder: play its scenarios one by one")
    judged: List[Event] = []
    reasons: List[str] = []
    show = printer(progress)
    seen = _Seen(show) if show is not None else None

    def on_event(event: Event) -> None:
        if event["event"] == "judged":
            judged.append(event)
        elif event["event"] == "failed":
            reasons.append(event["reason"])
        if seen is not None:
            seen(event)

    arguments = [command, "--events", *_options(values, output), *options, _argument(scenario)]
    ended = call(arguments, on_event)
    played = Run(judged[0]["folder"]) if judged else None
    if played is not None and ended.code in _VERDICTS:
        return played
    if played is not None and played.verdict.reason:
        reasons.append(played.verdict.reason)
    raise error_of(ended.code, "\n".join([*reasons, ended.message]).strip("\n"), played)


class _Seen:
    """Turns the events of one run into progress."""

    def __init__(self, show: Callable[[float, str], None]) -> None:
        self._show = show
        self._duration_seconds = math.inf

    def __call__(self, event: Event) -> None:
        if event["event"] == "began":
            self._duration_seconds = event["duration_seconds"]
        elif event["event"] == "reached":
            time = event["time_seconds"]
            self._show(min(time / self._duration_seconds, 0.99), f"{time:.1f} s")
        elif event["event"] == "ended":
            self._show(1.0, "")


def _succeed(ended: Ended) -> Ended:
    if ended.code != 0:
        raise error_of(ended.code, ended.message)
    return ended


def _argument(scenario: StrPath) -> str:
    """A file as an argument of the command line: after ``--`` it would be a program."""
    path = os.fspath(scenario)
    return f"./{path}" if path.startswith("-") else path


def _options(values: Optional[Values], output: StrPath) -> List[str]:
    return [f"--output={os.fspath(output)}", *_overrides(values)]


def _overrides(values: Optional[Values]) -> List[str]:
    return [f"--set={key}={_toml(key, value)}" for key, value in (values or {}).items()]


def _toml(key: str, value: Any) -> str:
    """A value as TOML. A number of another type, such as NumPy's, is written as the Python number that equals it."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        pairs = (f"{json.dumps(str(name))} = {_toml(key, below)}" for name, below in value.items())
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(key, below) for below in value) + "]"
    raise TypeError(f"{key} is {value!r}; a value is a number, a text, a truth value, a list or a dictionary")
