"""Tables as data frames of the library that is there."""

import importlib.util
import math
import os
import sys

import canrig
import pytest
from canrig._tables import to_table

HERE = [name for name in ("polars", "pandas") if importlib.util.find_spec(name)]
TEXT = b'case,id,x,empty,reason\n1,0012,1.5,,"a, b"\n2,12e4,,,\n'


@pytest.fixture(params=["polars", "pandas", "lists"])
def library(request):
    if request.param != "lists" and request.param not in HERE:
        pytest.skip(f"{request.param} is not installed")
    return request.param


def test_the_environment_is_the_one_that_the_pipeline_means():
    meant = os.environ.get("CANRIG_TEST_LIBRARY")
    if meant is None:
        pytest.skip("no pipeline")
    assert HERE == ([] if meant == "lists" else [meant])


def test_without_a_wish_the_first_library_that_is_there_is_taken():
    table = to_table(TEXT)
    assert type(table).__module__.split(".")[0] == (HERE[0] if HERE else "builtins")


def test_cells_keep_their_kinds(library):
    table = to_table(TEXT, library)
    column = {name: list(table[name]) for name in ("case", "id", "x", "empty", "reason")}
    assert column["case"] == [1, 2]
    assert column["id"] == ["0012", "12e4"]
    assert column["reason"] == ["a, b", ""]
    assert column["x"][0] == 1.5
    missing = [column["x"][1], *column["empty"]]
    assert all(value is None or math.isnan(value) for value in missing)


def test_signals_and_frames_are_the_same_in_every_library(library, hold, tmp_path):
    run = canrig.simulate(hold, output=tmp_path / "runs")
    for plain, table in [
        (run.signals("lists"), run.signals(library)),
        (run.frames(library="lists"), run.frames(library=library)),
    ]:
        assert list(plain) == list(table if library == "lists" else table.columns)
        for name, cells in plain.items():
            same = [a == b or (a is None and (b is None or math.isnan(b))) for a, b in zip(cells, list(table[name]))]
            assert all(same) and len(same) == len(cells), name


def test_a_table_without_rows_keeps_its_columns(library):
    table = to_table(b"time_seconds,text\n", library)
    assert list(table if library == "lists" else table.columns) == ["time_seconds", "text"]
    assert len(table["text"]) == 0


def test_a_library_that_is_missing_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(canrig.LibraryMissing, match="pip install polars"):
        to_table(TEXT, "polars")
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert isinstance(to_table(TEXT), dict)
    with pytest.raises(ValueError, match="'polars', 'pandas', 'lists'"):
        to_table(TEXT, "arrow")
