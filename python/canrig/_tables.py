"""Tables of the program as data frames: of polars, of pandas, or plain lists."""

from __future__ import annotations

import csv
import importlib
import io
from typing import Any, Dict, FrozenSet, List, Optional

from ._errors import CanrigError

#: Columns that hold text; all others hold numbers.
TEXT: FrozenSet[str] = frozenset(
    ["data", "id", "level", "message", "missed_limits", "reason", "sender", "text", "verdict", "what", "who"]
)
#: Columns that hold whole numbers, in every row.
WHOLE: FrozenSet[str] = frozenset(["case", "cycle", "identifier", "seed"])
LIBRARIES = ("polars", "pandas", "lists")


class LibraryMissing(CanrigError, ImportError):
    """The data frame library that was asked for is not installed."""


def to_table(text: bytes, library: Optional[str] = None) -> Any:
    """A table of the program: a ``polars.DataFrame``, a ``pandas.DataFrame``, or a dictionary of lists.

    ``library`` is "polars", "pandas" or "lists"; without it the first that is installed.
    """
    if library is None:
        for candidate in LIBRARIES[:2]:
            try:
                importlib.import_module(candidate)
            except ImportError:
                continue
            return to_table(text, candidate)
        return _lists(text)
    if library == "lists":
        return _lists(text)
    if library not in LIBRARIES:
        raise ValueError(f"library is {library!r}; it must be one of {', '.join(map(repr, LIBRARIES))}")
    try:
        module = importlib.import_module(library)
    except ImportError as error:
        raise LibraryMissing(
            f"{library} is not installed: `pip install {library}`, or ask for library=\"lists\""
        ) from error
    return _polars(module, text) if library == "polars" else _pandas(module, text)


def _header(text: bytes) -> List[str]:
    first = text.split(b"\n", 1)[0].decode("utf-8")
    return next(csv.reader([first]), [])


def _polars(polars: Any, text: bytes) -> Any:
    def kind(name: str) -> Any:
        if name in TEXT:
            return polars.String
        return polars.Int64 if name in WHOLE else polars.Float64

    schema = {name: kind(name) for name in _header(text)}
    table = polars.read_csv(io.BytesIO(text), schema=schema)
    return table.with_columns(polars.col(polars.String).fill_null(""))


def _pandas(pandas: Any, text: bytes) -> Any:
    def kind(name: str) -> str:
        if name in TEXT:
            return "object"
        return "int64" if name in WHOLE else "float64"

    kinds = {name: kind(name) for name in _header(text)}
    empty = {name: [""] for name in kinds if name not in TEXT}
    return pandas.read_csv(io.BytesIO(text), dtype=kinds, keep_default_na=False, na_values=empty)


def _lists(text: bytes) -> Dict[str, List[Any]]:
    rows = csv.reader(io.StringIO(text.decode("utf-8"), newline=""))
    names = next(rows, [])
    columns: List[List[Any]] = [list(column) for column in zip(*rows)] or [[] for _ in names]

    def typed(name: str, cells: List[str]) -> List[Any]:
        if name in TEXT:
            return cells
        if name in WHOLE:
            return [int(cell) for cell in cells]
        return [float(cell) if cell else None for cell in cells]

    return {name: typed(name, cells) for name, cells in zip(names, columns)}
