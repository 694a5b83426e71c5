"""Scenarios as items of pytest. Imported only where they are asked for."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, Optional, Sequence, Set

import pytest

from ._commands import Values, checked_files, run, simulate
from ._errors import CanrigError
from ._run import Run, StrPath


class Collector:
    """Finds the scenarios below the paths that pytest was given."""

    def __init__(self) -> None:
        #: The scenarios of each folder that was looked at.
        self._scenarios: Dict[Path, Set[Path]] = {}

    def pytest_collect_file(self, file_path: Path, parent: Any) -> Optional["ScenarioFile"]:
        if file_path.suffix != ".toml":
            return None
        # A user who names a file wants to know its mistakes.
        if parent.session.isinitpath(file_path) or file_path in self._scenarios_in(file_path.parent):
            return ScenarioFile.from_parent(parent, path=file_path)
        return None

    def _scenarios_in(self, folder: Path) -> Set[Path]:
        if folder not in self._scenarios:
            try:
                self._scenarios[folder] = scenarios(sorted(folder.glob("*.toml")))
            except CanrigError as error:
                raise pytest.UsageError(str(error)) from error
        return self._scenarios[folder]


def scenarios(paths: Sequence[Path]) -> Set[Path]:
    """The files that are meant as scenarios to play, as `canrig check` sees it.

    An invalid one is, so that it becomes a test that fails, not one that is missing. A sweep is not, and what runs have left.
    """
    checked = checked_files(paths)
    return {Path(file["path"]) for file in checked if file["kind"] == "scenario" and not file["is_left_by_a_play"]}


class ScenarioFile(pytest.File):
    """A file with one scenario."""

    def collect(self) -> Iterator["ScenarioItem"]:
        yield ScenarioItem.from_parent(self, name=self.path.stem)


class ScenarioFailed(Exception):
    """A run that did not pass."""


class ScenarioItem(pytest.Item):
    """A scenario that is played and must pass."""

    def runtest(self) -> None:
        played = _player(self, self.path.parent)(self.path)
        if not _is_accepted(self.config, played):
            raise ScenarioFailed(played.explain())

    def repr_failure(self, excinfo: Any, style: Any = None) -> Any:
        if isinstance(excinfo.value, (ScenarioFailed, CanrigError)):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> Any:
        return self.path, None, self.name


def _is_accepted(config: Any, played: Run) -> bool:
    if played.outcome == "inconclusive":
        choice = config.getini("canrig_inconclusive")
        if choice not in ("fail", "pass"):
            raise pytest.UsageError(f"canrig_inconclusive is {choice!r}; it must be fail or pass")
        return str(choice) == "pass"
    return played.passed


def player_of(request: Any) -> Callable[..., Run]:
    """The function of the fixture ``canrig_run``."""
    return _player(request.node, request.node.path.parent)


def _player(item: Any, beside: Path) -> Callable[..., Run]:
    def play(scenario: StrPath, values: Optional[Values] = None, **options: Any) -> Run:
        near = beside / scenario
        path = near if near.exists() else scenario
        options.setdefault("output", _output(item.config))
        try:
            played = _play(_world(item), path, values, options)
        except CanrigError as error:
            if error.run is not None:
                _record(item, error.run)
            raise
        _record(item, played)
        return played

    return play


def _play(world: str, path: StrPath, values: Optional[Values], options: Any) -> Run:
    if world == "simulate":
        return simulate(path, values, progress=False, **options)
    if world == "lockstep":
        return run(path, values, clock="lockstep", progress=False, **options)
    with _alone():
        return run(path, values, progress=False, **options)


def _world(item: Any) -> str:
    marker = item.get_closest_marker("canrig")
    of_marker = marker and (marker.kwargs.get("world") or next(iter(marker.args), None))
    world = of_marker or item.config.getoption("canrig_world") or item.config.getini("canrig_world")
    if world not in ("simulate", "lockstep", "run"):
        raise pytest.UsageError(f"the world of canrig is {world!r}; it must be simulate, lockstep or run")
    return str(world)


def _output(config: Any) -> Path:
    return Path(config.rootpath, config.getoption("canrig_output") or config.getini("canrig_output"))


def _record(item: Any, played: Run) -> None:
    """Adds requirements and run folder to the test's entry in the JUnit file."""
    item.user_properties.append(("canrig_folder", str(played.folder)))
    for requirement in played.requirements:
        item.user_properties.append(("requirement", requirement))


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Admits one run in real time at a time, among all processes: two would disturb each other's timing."""
    path = Path(tempfile.gettempdir(), f"canrig-real-time-{os.getuid()}.lock")
    lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)
