"""The folder of a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List, Optional

from . import _tables
from ._errors import CannotStart, ExitCode
from ._run import StrPath


class Sweep:
    """A completed sweep, played now or earlier: one row for each run."""

    def __init__(self, folder: StrPath) -> None:
        #: The folder of the sweep.
        self.folder = Path(folder)
        if not (self.folder / "runs.csv").is_file():
            raise CannotStart(f"`{self.folder}` is not the folder of a sweep that has ended (no runs.csv in it)")
        #: How the program ended, by the worst run; ``None`` for an earlier sweep.
        self.exit_code: Optional[ExitCode] = None

    @property
    def passed(self) -> bool:
        """Whether every run passed."""
        return all(verdict == "pass" for verdict in self.table("lists")["verdict"])

    @property
    def report(self) -> Path:
        """The page of the sweep, for a browser."""
        return self.folder / "report.html"

    @property
    def failing(self) -> List[Path]:
        """The scenarios of the first runs that do not pass, each for :func:`canrig.simulate`."""
        return sorted((self.folder / "failing").glob("case-*.toml"))

    def table(self, library: Optional[str] = None) -> Any:
        """One row for each run: its values, its verdict, its metrics. ``library`` as in :meth:`canrig.Run.signals`."""
        return _tables.to_table((self.folder / "runs.csv").read_bytes(), library)

    def __repr__(self) -> str:
        return f"<canrig.Sweep {str(self.folder)!r}>"
