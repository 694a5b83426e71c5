"""A run folder: its verdict, its events, its signals and frames."""

from __future__ import annotations

import html
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Tuple, Union

from . import _tables
from ._errors import CannotStart, error_of
from ._program import call

StrPath = Union[str, "os.PathLike[str]"]


@dataclass(frozen=True)
class Metric:
    """A row of the verdict: a value with its limit."""

    #: A metric, such as ``settling_time_seconds``, or what a check demands.
    name: str
    #: ``None`` where there is none; the remark says why.
    value: Optional[float]
    #: The least that passes.
    min: Optional[float] = None
    #: The most that passes.
    max: Optional[float] = None
    #: ``None`` without a limit, and where it was not judged.
    passed: Optional[bool] = None
    #: When the value was taken, where that says something.
    at_seconds: Optional[float] = None
    #: Why there is no value.
    remark: Optional[str] = None
    #: The requirements that the row tests.
    requirements: Tuple[str, ...] = ()

    @property
    def has_limit(self) -> bool:
        return self.min is not None or self.max is not None

    def __str__(self) -> str:
        if self.value is None:
            value = f"no value ({self.remark})" if self.remark else "no value"
        else:
            value = f"{self.value:g}"
        at = "" if self.at_seconds is None else f" at {self.at_seconds:g} s"
        limits = [
            f"{sign} {limit:g}" for sign, limit in (("≥", self.min), ("≤", self.max)) if limit is not None
        ]
        limit = f", limit {' and '.join(limits)}" if limits else ""
        return f"{self.name}: {value}{at}{limit}"

    @staticmethod
    def _of(row: Mapping[str, Any]) -> "Metric":
        limit = row.get("limit") or {}
        return Metric(
            name=row["name"],
            value=row.get("value"),
            min=limit.get("min"),
            max=limit.get("max"),
            passed=row.get("passed"),
            at_seconds=row.get("at_seconds"),
            remark=row.get("remark"),
            requirements=tuple(row.get("requirements", ())),
        )


@dataclass(frozen=True)
class Verdict:
    """Verdict of a run. ``verdict["overshoot_percent"]`` is one of its rows."""

    #: ``pass``, ``fail``, ``inconclusive`` or ``incomplete``.
    outcome: str
    #: Why, where the metrics do not show it.
    reason: Optional[str]
    #: The scenario's name.
    scenario: str
    #: The version of the program that judged.
    version: str
    metrics: Tuple[Metric, ...]
    #: The requirements that the scenario tests as a whole.
    requirements_of_scenario: Tuple[str, ...] = ()
    #: All of ``verdict.json``.
    json: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def passed(self) -> bool:
        return self.outcome == "pass"

    @property
    def failures(self) -> List[Metric]:
        """The rows whose limit was not met."""
        return [metric for metric in self.metrics if metric.passed is False]

    @property
    def requirements(self) -> Dict[str, Optional[bool]]:
        """Whether each requirement is met; ``None`` if it is unknown."""
        of_run = {"pass": True, "fail": False}.get(self.outcome)
        met: Dict[str, Optional[bool]] = {name: of_run for name in self.requirements_of_scenario}
        for metric in self.metrics:
            for name in metric.requirements:
                met[name] = _all_of(met.get(name, True), metric.passed)
        if self.outcome in ("inconclusive", "incomplete"):
            return {name: False if state is False else None for name, state in met.items()}
        return met

    def explain(self) -> str:
        """The outcome with its reason and the limits that were not met, as a text."""
        lines = [f"{self.scenario}: {self.outcome}"]
        if self.reason:
            lines.append(self.reason)
        lines.extend(f"  {metric}" for metric in self.failures)
        unjudged = [metric for metric in self.metrics if metric.has_limit and metric.passed is None]
        lines.extend(f"  {metric} (not judged)" for metric in unjudged)
        return "\n".join(lines)

    def __getitem__(self, name: str) -> Metric:
        for metric in self.metrics:
            if metric.name == name:
                return metric
        names = ", ".join(metric.name for metric in self.metrics)
        raise KeyError(f"the verdict has no row {name!r}; it has {names}")

    def __contains__(self, name: object) -> bool:
        return any(metric.name == name for metric in self.metrics)

    def __iter__(self) -> Iterator[Metric]:
        return iter(self.metrics)

    @staticmethod
    def _of(text: Union[str, bytes]) -> "Verdict":
        content = json.loads(text)
        return Verdict(
            outcome=content["outcome"],
            reason=content.get("reason"),
            scenario=content["scenario"],
            version=content["version"],
            metrics=tuple(Metric._of(row) for row in content["metrics"]),
            requirements_of_scenario=tuple(content.get("requirements", ())),
            json=content,
        )


def _all_of(one: Optional[bool], other: Optional[bool]) -> Optional[bool]:
    if one is False or other is False:
        return False
    return True if one and other else None


@dataclass(frozen=True)
class Event:
    """An event on the bus or of the scenario."""

    #: Scenario time; negative before its time 0.
    time_seconds: float
    #: ``info``, ``warning`` (a fault that the scenario injects) or ``error``.
    level: str
    text: str


class Run:
    """A run folder, of a run that was just played or of an earlier one: ``canrig.Run("runs/step-58e62dc6")``."""

    def __init__(self, folder: StrPath) -> None:
        #: The run folder.
        self.folder = Path(folder)
        path = self.folder / "verdict.json"
        try:
            #: What the run came to.
            self.verdict = Verdict._of(path.read_bytes())
        except FileNotFoundError:
            raise CannotStart(f"{self.folder} is not a run folder (no verdict.json in it)") from None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CannotStart(f"{path} cannot be read: {error!r}") from error

    @property
    def outcome(self) -> str:
        """``pass``, ``fail``, ``inconclusive`` or ``incomplete``."""
        return self.verdict.outcome

    @property
    def passed(self) -> bool:
        return self.verdict.passed

    @property
    def requirements(self) -> Dict[str, Optional[bool]]:
        """Whether each requirement that the scenario names is met; ``None`` if it is unknown."""
        return self.verdict.requirements

    @property
    def report(self) -> Path:
        """The page of the run, for a browser."""
        return self.folder / "report.html"

    def explain(self) -> str:
        """The outcome with the limits that were not met, and where the folder is."""
        return f"{self.verdict.explain()}\nrun folder {self.folder}\nreport     {self.report.resolve().as_uri()}"

    def assert_passed(self) -> None:
        """Raises ``AssertionError`` with the limits that were not met, unless the run passed."""
        if not self.passed:
            raise AssertionError(self.explain())

    @property
    def events(self) -> List[Event]:
        """Events other than the cyclic traffic: states, emergencies, disturbances, faults."""
        table = _tables.to_table(self._export("events"), "lists")
        return [Event(*row) for row in zip(table["time_seconds"], table["level"], table["text"])]

    def signals(self, library: Optional[str] = None) -> Any:
        """One row for each cycle, one column for each signal, as in ``signals.csv``.

        A ``polars.DataFrame`` if polars is installed, else a ``pandas.DataFrame``, else a dictionary of lists; ``library``
        chooses: "polars", "pandas" or "lists".
        """
        path = self.folder / "signals.csv"
        content = path.read_bytes() if path.exists() else self._export("csv")
        return _tables.to_table(content, library)

    def frames(self, message: Optional[str] = None, library: Optional[str] = None) -> Any:
        """One row for each frame on the bus: time, identifier, message, sender, bytes as hexadecimal digits.

        With the name of a message, only its frames, with a column for each of its signals. ``library`` as in
        :meth:`signals`.
        """
        chosen = [] if message is None else [f"--message={message}"]
        return _tables.to_table(self._export("frames", *chosen), library)

    def export(self, format: str, path: StrPath) -> Path:
        """Writes the recording for another program: "asc", "blf", "mf4", "mcap", "parquet", "csv", "frames" or "events"."""
        self._export(format, f"--output={os.fspath(path)}")
        return Path(path)

    def _export(self, format: str, *options: str) -> bytes:
        ended = call(["export", f"--format={format}", *options, "--", str(self.folder)])
        if ended.code != 0:
            raise error_of(ended.code, ended.message)
        return ended.output

    def __repr__(self) -> str:
        return f"<canrig.Run {self.verdict.scenario!r}: {self.outcome}, {str(self.folder)!r}>"

    def _repr_html_(self) -> str:
        """The verdict as a table, for notebooks."""

        def row(metric: Metric) -> str:
            value = "" if metric.value is None else f"{metric.value:g}"
            least = "" if metric.min is None else f"{metric.min:g}"
            most = "" if metric.max is None else f"{metric.max:g}"
            passed = {None: "", True: "pass", False: "<b>FAIL</b>"}[metric.passed]
            cells = (html.escape(metric.name), value, least, most, passed)
            return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"

        head = "<tr><th>metric</th><th>measured</th><th>min</th><th>max</th><th>result</th></tr>"
        rows = "".join(row(metric) for metric in self.verdict)
        title = f"{html.escape(self.verdict.scenario)}: <b>{self.outcome}</b> {html.escape(self.verdict.reason or '')}"
        return f"<p>{title}</p><table>{head}{rows}</table>"
