"""A run's log and exports and the tables of a sweep hold what they should, read by python-can, cantools, asammdf and pyarrow."""

import csv
import math
import os
import pathlib
import subprocess
import time

import can
import cantools
import pyarrow
import pyarrow.parquet
import pytest
from asammdf import MDF

SYNC = 0x080
OPERATION_ENABLED = "operation enabled"

# Headers of ASC files are read in the time zone of the machine; ours are in UTC.
os.environ["TZ"] = "UTC"
time.tzset()


def exported(canrig, run, kind, folder):
    path = pathlib.Path(folder, f"run.{kind}")
    subprocess.run([canrig, "export", run, "--format", kind, "--output", path], check=True)
    return path


def frames(path, **options):
    def key(message):
        return (round(message.timestamp * 1e6), message.arbitration_id, message.is_extended_id, message.is_remote_frame,
                message.is_error_frame, message.dlc, bytes(message.data))
    return [key(message) for message in can.LogReader(path, **options)]


def same_frames(name, original, found):
    # Some stamps are read as floating-point seconds since 1970, which are exact to half a microsecond.
    differing = [(a, b) for a, b in zip(original, found) if a[1:] != b[1:] or abs(a[0] - b[0]) > 1]
    assert len(original) == len(found) and not differing, (name, len(original), len(found), differing[:3])
    print(f"{name}: {len(found)} frames as in bus.log, by python-can {can.__version__}")


def same_signals(run, table, path):
    with MDF(path) as measurement, open(table, newline="") as text:
        rows = list(csv.DictReader(text))
        names = [name for name in rows[0] if name not in ("cycle", "time_seconds")]
        for name in names:
            signal = measurement.get(name)
            assert len(signal.samples) == len(rows), name
            for row, time_seconds, value in zip(rows, signal.timestamps, signal.samples):
                wanted = float(row[name]) if row[name] else math.nan
                assert abs(float(row["time_seconds"]) - time_seconds) < 1e-6, name
                assert (math.isnan(wanted) and math.isnan(value)) or abs(wanted - value) < 1e-6 * max(1, abs(wanted)), (name, wanted, value)
        attached, place, _ = measurement.extract_attachment(0)
        assert str(place) == "frames.dbc" and attached == (run / "frames.dbc").read_bytes()
    print(f"mf4: {len(names)} signals in {len(rows)} rows as in signals.csv, and frames.dbc attached, by asammdf")


def same_table(table, path):
    read = pyarrow.parquet.read_table(path)
    with open(table, newline="") as text:
        rows = list(csv.DictReader(text))
    assert read.column_names == list(rows[0]) and read.num_rows == len(rows), read.schema
    assert read.column("cycle").to_pylist() == [int(row["cycle"]) for row in rows]
    nulls = 0
    for name in read.column_names[1:]:
        for row, value in zip(rows, read.column(name).to_pylist()):
            wanted = float(row[name]) if row[name] else None
            nulls += value is None
            # signals.csv has seven decimals.
            assert (wanted is None) == (value is None) and (value is None or abs(wanted - value) <= 1e-7), (name, wanted, value)
    print(f"parquet: {read.num_columns} columns of {read.num_rows} rows, {nulls} nulls, as in signals.csv, by pyarrow {pyarrow.__version__}")


def same_rows(table, path):
    read = pyarrow.parquet.read_table(path)
    with open(table, newline="") as text:
        rows = list(csv.DictReader(text))
    assert read.column_names == list(rows[0]) and read.num_rows == len(rows) > 1, read.schema
    of_type = {"int64": int, "double": float, "string": str}
    for name in read.column_names:
        convert = of_type[str(read.schema.field(name).type)]
        wanted = [convert(row[name]) if row[name] else None for row in rows]
        assert read.column(name).to_pylist() == wanted, name
    print(f"parquet: {read.num_columns} columns of {read.num_rows} runs of a sweep, as in runs.csv")


def cycles(database, log):
    """The values at the end of each cycle by the signals' names: those of the last frame, of the drive's measurements only those of the cycle itself."""
    latest, rows, is_enabled = {}, [], False
    for frame in can.LogReader(log):
        if frame.arbitration_id == SYNC:
            if is_enabled:
                latest = {name: value for name, value in latest.items() if name[0] != "drive_tpdo1"}
                rows.append(latest)
            continue
        try:
            message = database.get_message_by_frame_id(frame.arbitration_id)
        except KeyError:
            continue
        if "pdo" not in message.name:
            continue
        values = message.decode(frame.data, decode_choices=False)
        latest |= {(message.name, name): value for name, value in values.items()}
        labels = message.decode(frame.data)
        is_enabled |= str(labels.get("statusword_state")) == OPERATION_ENABLED
    return [{name: value for (_, name), value in row.items()} for row in rows]


def same_decoded(run):
    database = cantools.database.load_file(run / "frames.dbc", encoding="utf-8")
    with open(run / "signals.csv", newline="") as text:
        rows = list(csv.DictReader(text))
    carried = {signal.name for message in database.messages if "pdo" in message.name for signal in message.signals}
    names = [name for name in rows[0] if name in carried]
    values = 0
    decoded = cycles(database, run / "bus.log")
    assert len(decoded) >= len(rows) > 1 and len(names) > 5, (len(decoded), len(rows), names)
    # How the nodes stop after the scenario's end is no part of its last cycle.
    for row, found in list(zip(rows, decoded))[:-1]:
        for name in names:
            wanted = float(row[name]) if row[name] else None
            value = found.get(name)
            assert (wanted is None) == (value is None), (row["cycle"], name, wanted, value)
            # signals.csv has seven decimals.
            assert wanted is None or abs(wanted - value) <= 1e-7 + 1e-12 * abs(wanted), (row["cycle"], name, wanted, value)
            values += wanted is not None
    print(f"frames.dbc: {values} values of {len(names)} signals in bus.log as in signals.csv, by cantools {cantools.__version__}: {', '.join(names)}")


def test_logs_of_frames(canrig, run_folder, tmp_path):
    original = frames(run_folder / "bus.log")
    same_frames("blf", original, frames(exported(canrig, run_folder, "blf", tmp_path)))
    same_frames("asc", original, frames(exported(canrig, run_folder, "asc", tmp_path), relative_timestamp=False))


def test_tables_of_signals(canrig, run_folder, tmp_path):
    table = exported(canrig, run_folder, "csv", tmp_path)
    assert table.read_bytes() == (run_folder / "signals.csv").read_bytes()
    same_signals(run_folder, table, exported(canrig, run_folder, "mf4", tmp_path))
    same_table(table, exported(canrig, run_folder, "parquet", tmp_path))


@pytest.mark.parametrize("name", ["run_folder", "motor_run"])
def test_frames_decoded_by_the_dbc(request, name):
    same_decoded(request.getfixturevalue(name))


def test_tables_of_a_sweep(sweep_folder):
    same_rows(sweep_folder / "runs.csv", sweep_folder / "runs.parquet")
