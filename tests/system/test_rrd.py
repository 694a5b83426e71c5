"""run.rrd of a run is sound by the viewer's own tools, and holds what signals.csv holds, read by the viewer's own SDK."""

import bisect
import collections
import csv
import subprocess
import sys

import numpy
import pyarrow
import pytest
import rerun
from rerun.experimental import RrdReader

# rerun.components.AggregationPolicy: without it the viewer draws the extremes of the rows that fall on one pixel.
AGGREGATION_OFF = 1


def tool(*arguments):
    """Output of `rerun rrd …`; the wheel has the viewer with its tools in it."""
    ran = subprocess.run([sys.executable, "-m", "rerun_cli", "rrd", *arguments], capture_output=True, text=True)
    assert ran.returncode == 0, (arguments, ran.stdout, ran.stderr)
    return ran.stdout


def recorded(path):
    """Rows (cycle, run time in ns, value) of every signal, those of which the viewer draws each row, and the texts of the events."""
    signals, drawn_whole, events = collections.defaultdict(list), set(), []
    for chunk in RrdReader(path).stream():
        if chunk.is_static:
            batch = chunk.to_record_batch()
            policy = "SeriesLines:aggregation_policy"
            if policy in batch.schema.names and batch.column(policy).flatten().to_pylist() == [AGGREGATION_OFF]:
                drawn_whole.add(str(chunk.entity_path).removeprefix("/"))
            continue
        if "cycle" not in chunk.timeline_names:
            continue
        batch = chunk.to_record_batch()
        times = [batch.column(name).cast(pyarrow.int64()).to_numpy() for name in ("cycle", "run_time")]
        if "Scalars:scalars" in batch.schema.names:
            values = batch.column("Scalars:scalars").flatten().to_numpy()
            name = str(chunk.entity_path).removeprefix("/")
            signals[name] += zip(*times, values, strict=True)
        if "TextLog:text" in batch.schema.names:
            events += batch.column("TextLog:text").flatten().to_pylist()
    return {name: sorted(rows, key=lambda row: row[:2]) for name, rows in signals.items()}, drawn_whole, events


def compare(name, path, rows, is_drawn_whole, table):
    """A signal has a row in every cycle that has a value, or holds until its next row; the viewer must draw each of those."""
    wanted = {int(row["cycle"]): float(row[name]) for row in table if row[name]}
    times = {int(row["cycle"]): round(float(row["time_seconds"]) * 1e9) for row in table}
    cycles = [cycle for cycle, _, _ in rows]
    assert all(times[cycle] == time for cycle, time, _ in rows), path
    if not is_drawn_whole:
        assert cycles == list(wanted), (path, len(cycles), len(wanted))
    for cycle, value in wanted.items():
        held = rows[bisect.bisect_right(cycles, cycle) - 1][2]
        # signals.csv has seven decimals.
        assert abs(held - value) <= 1e-7 * max(1, abs(value)), (path, cycle, held, value)
    return len(wanted)


@pytest.fixture(autouse=True)
def home(monkeypatch, tmp_path):
    """The viewer's tools write into the home folder."""
    monkeypatch.setenv("HOME", str(tmp_path))


def test_the_viewer_reads_what_the_table_holds(run_folder):
    path = run_folder / "run.rrd"
    tool("verify", str(path))
    statistics = tool("stats", str(path))
    print(next(line for line in statistics.splitlines() if "num_chunks" in line or "chunks" in line.lower()).strip())
    with open(run_folder / "signals.csv", newline="") as text:
        table = list(csv.DictReader(text))
    signals, drawn_whole, events = recorded(path)
    names = [name for name in table[0] if name not in ("cycle", "time_seconds")]
    compared = values = 0
    for name in names:
        if not any(row[name] for row in table):
            continue
        [place] = [place for place in signals if place.rsplit("/", 1)[-1] == name]
        values += compare(name, place, signals[place], place in drawn_whole, table)
        compared += 1
    assert compared > 10 and values > 10 * len(table) / 2, (compared, values)
    for place in ("timing/sync_lateness_microseconds", "timing/sync_to_command_microseconds", "bus/load_percent"):
        assert len(signals[place]) > 10, place
    loads = numpy.array([value for _, _, value in signals["bus/load_percent"]])
    assert ((loads > 5) & (loads < 100)).all(), loads
    assert any("operation enabled" in event for event in events) and events[-1].startswith("verdict: "), events
    print(f"run.rrd: sound; {compared} signals with {values} values as in signals.csv, {len(events)} events, by rerun-sdk {rerun.__version__}")
