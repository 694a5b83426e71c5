"""The MF4 and MCAP files of runs hold every frame, every signal of every frame, and every event, read by asammdf, mcap-ros2-support
and the importer of Rerun."""

import collections
import csv
import io
import math
import pathlib
import shutil
import subprocess
import sys

import asammdf
import mcap.reader
import mcap_ros2
import mcap_ros2.reader
import pytest
import rerun
from rerun.experimental import RrdReader

OTHER_FRAMES = ("190#R8", "18FF0102#0102", "20000004#0001000000000000", "700#")
LEVELS = {"info": 20, "warning": 30, "error": 40}


class Recording:
    """A run by the tables of `canrig export`."""

    def __init__(self, canrig, run):
        self.canrig, self.run = canrig, run
        self.frames = self.table("frames")
        self.events = self.table("events")
        names = {row["message"] for row in self.frames if row["data"] not in ("error", "remote")} - {""}
        self.messages = {name: self.table("frames", "--message", name) for name in sorted(names)}
        self.values = sum(len(rows) * (len(rows[0]) - 1) for rows in self.messages.values())

    def table(self, kind, *arguments):
        text = subprocess.run([self.canrig, "export", self.run, "--format", kind, *arguments], check=True, capture_output=True, text=True).stdout
        return list(csv.DictReader(io.StringIO(text)))

    def file(self, kind, folder):
        """The same bytes whenever it is written."""
        paths = [pathlib.Path(folder, f"{number}.{kind}") for number in range(2)]
        for path in paths:
            subprocess.run([self.canrig, "export", self.run, "--format", kind, "--output", path], check=True)
        assert paths[0].read_bytes() == paths[1].read_bytes(), kind
        return paths[0]

    def is_message(self, name, found, exactly):
        """Whether rows (time, values by name) are those of a message."""
        rows = self.messages[name]
        assert len(rows) == len(found), (name, len(rows), len(found))
        for row, (time_seconds, values) in zip(rows, found):
            assert abs(float(row["time_seconds"]) - time_seconds) < 2e-6, (name, row, time_seconds)
            assert set(values) == set(row) - {"time_seconds"}, (name, values)
            for signal, value in values.items():
                wanted = float(row[signal]) if row[signal] else math.nan
                is_same = wanted == value or math.isnan(wanted) and math.isnan(value)
                # Others multiply by 0.001 where canrig divides by 1000.
                is_near = not exactly and abs(wanted - value) <= 1e-12 * abs(wanted)
                assert is_same or is_near, (name, signal, row, value)


def frame_of(row):
    """Identifier, kind, bytes as digits."""
    kind = row["data"] if row["data"] in ("error", "remote") else "data"
    return int(row["identifier"]), kind, row["data"] if kind == "data" else ""


def is_near(row, time_seconds):
    return abs(float(row["time_seconds"]) - time_seconds) < 2e-6


def mf4_frames(measurement, group, kind):
    """Rows of a kind: time, then as `frame_of`."""
    read = measurement.get(f"CAN_{group}")
    parts = {part: read.samples[f"CAN_{group}.{part}"] for part in ("ID", "IDE", "BusChannel", "DataLength", "DataBytes")}
    assert set(parts["BusChannel"]) == {1} and set(parts["IDE"]) <= {0, 1}
    for place, time_seconds in enumerate(read.timestamps):
        digits = bytes(parts["DataBytes"][place][: parts["DataLength"][place]]).hex().upper()
        yield time_seconds, (int(parts["ID"][place]), kind, digits if kind == "data" else "")


def check_mf4(recording, path):
    kinds = {"DataFrame": "data", "RemoteFrame": "remote", "ErrorFrame": "error"}
    wanted = collections.defaultdict(list)
    for row in recording.frames:
        wanted[frame_of(row)[1]].append(row)
    with asammdf.MDF(path) as measurement:
        for group, kind in kinds.items():
            assert (f"CAN_{group}" in measurement.channels_db) == bool(wanted[kind]), kind
            found = list(mf4_frames(measurement, group, kind)) if wanted[kind] else []
            assert len(found) == len(wanted[kind]), (kind, len(found), len(wanted[kind]))
            for row, (time_seconds, frame) in zip(wanted[kind], found):
                assert is_near(row, time_seconds) and frame_of(row) == frame, (row, time_seconds, frame)
        decoded = measurement.extract_bus_logging({"CAN": [(recording.run / "frames.dbc", 0)]})
        groups = {group.channel_group.comment.split("message ")[1].split()[0]: number for number, group in enumerate(decoded.groups)}
        with_signals = {name for name, rows in recording.messages.items() if len(rows[0]) > 1}
        assert set(groups) == with_signals, set(groups) ^ with_signals
        for name, number in groups.items():
            signals = {channel.name: decoded.get(channel.name, group=number, raw=True).physical(ignore_value2text_conversions=True) for channel in decoded.groups[number].channels[1:]}
            times = next(iter(signals.values())).timestamps
            columns = {signal: read.samples.tolist() for signal, read in signals.items()}
            found = [(time, {signal: values[place] for signal, values in columns.items()}) for place, time in enumerate(times)]
            recording.is_message(name, found, exactly=False)
    counts = ", ".join(f"{len(rows)} {kind}" for kind, rows in wanted.items() if rows)
    print(f"mf4: {len(recording.frames)} frames ({counts}); {recording.values} values in {len(groups)} messages by extract_bus_logging, by asammdf {asammdf.__version__}")


def check_mcap(recording, path):
    with open(path, "rb") as file:
        reader = mcap.reader.make_reader(file)
        assert reader.get_header().profile == "ros2"
        (metadata,) = reader.iter_metadata()
    zero = int(metadata.metadata["scenario_zero_nanoseconds"])
    topics = collections.defaultdict(list)
    last = 0
    for message in mcap_ros2.reader.read_ros2_messages(path):
        assert message.log_time_ns == message.publish_time_ns >= last
        last = message.log_time_ns
        topics[message.channel.topic].append(((message.log_time_ns - zero) / 1e9, message.ros_msg))
    found = topics.pop("/from_can_bus")
    assert len(found) == len(recording.frames)
    for row, (time_seconds, frame) in zip(recording.frames, found):
        kind = "error" if frame.is_error else "remote" if frame.is_rtr else "data"
        digits = frame.data[: frame.dlc].hex().upper() if kind == "data" else ""
        assert is_near(row, time_seconds) and frame_of(row) == (frame.id, kind, digits), (row, frame)
        assert frame.header.frame_id == "can0" and abs(frame.header.stamp.sec + frame.header.stamp.nanosec / 1e9 - zero / 1e9 - time_seconds) < 2e-6
    events = topics.pop("/rosout", [])
    assert len(events) == len(recording.events) > 0
    for row, (time_seconds, event) in zip(recording.events, events):
        assert is_near(row, time_seconds) and (event.level, event.msg) == (LEVELS[row["level"]], row["text"]), (row, event)
    assert {topic.removeprefix("/") for topic in topics} == set(recording.messages)
    for topic, rows in topics.items():
        name = topic.removeprefix("/")
        recording.is_message(name, [(time, {field: getattr(values, field) for field in values.__slots__}) for time, values in rows], exactly=True)
    print(f"mcap: {len(found)} frames, {recording.values} values in {len(topics)} messages, {len(events)} events, by mcap-ros2-support {mcap_ros2.__version__}")


def check_rerun(recording, path, folder):
    """Rerun's importer finds every topic, every value and the texts of the events."""
    converted = pathlib.Path(folder, "run.rrd")
    ran = subprocess.run([sys.executable, "-m", "rerun_cli", "mcap", "convert", path, "-o", converted], capture_output=True, text=True)
    assert ran.returncode == 0 and converted.exists(), ran.stderr
    rows, texts = collections.defaultdict(list), []
    for chunk in RrdReader(converted).stream():
        if chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.endswith(":message"):
                times = batch.column("message_log_time").cast("int64").to_pylist()
                rows[str(chunk.entity_path)] += zip(times, (one for [one] in batch.column(name).to_pylist()))
            if name == "TextLog:text":
                texts += batch.column(name).flatten().to_pylist()
    assert len(rows["/from_can_bus"]) == len(recording.frames)
    assert sorted(texts) == sorted(f"[canrig] {event['text']}" for event in recording.events), texts
    values = 0
    for name, wanted in recording.messages.items():
        found = [one for _, one in sorted(rows[f"/{name}"], key=lambda row: row[0])]
        assert len(found) == len(wanted), name
        for row, one in zip(wanted, found):
            for signal in set(row) - {"time_seconds"}:
                value = float(row[signal]) if row[signal] else math.nan
                assert value == one[signal] or math.isnan(value) and math.isnan(one[signal]), (name, signal, row, one)
                values += 1
    assert values == recording.values
    print(f"mcap: {values} values, {len(rows['/from_can_bus'])} frames and {len(texts)} events, by the importer of Rerun {rerun.__version__}")


def with_other_frames(run, folder):
    """A copy of a run that ends with frames that no simulated bus has: a remote frame, one with 29 bits, a driver's error message."""
    copy = shutil.copytree(run, pathlib.Path(folder, "run"))
    with open(copy / "bus.log", "rb+") as log:
        stamp = log.readlines()[-1].split()[0].decode()
        log.write("".join(f"{stamp} can0 {frame}\n" for frame in OTHER_FRAMES).encode())
    return copy


@pytest.fixture(params=["run_folder", "motor_run"])
def recording(request, canrig, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))  # where the viewer's tools write
    return Recording(canrig, with_other_frames(request.getfixturevalue(request.param), tmp_path))


def test_mf4(recording, tmp_path):
    check_mf4(recording, recording.file("mf4", tmp_path))


def test_mcap(recording, tmp_path):
    path = recording.file("mcap", tmp_path)
    check_mcap(recording, path)
    check_rerun(recording, path, tmp_path)
