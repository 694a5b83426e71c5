"""Nodes in Python: `canrig.node`."""

import math
import socket
import struct

import canrig
import canrig.node
import pytest

LEAD = """
import struct
import threading
import canrig.node

PART = canrig.node.part()
LOOP = PART.loops[0]
OBJECTS = ["23161001e8030100", "23061000e8030000", "2f6060000a000000"]

class Lead(canrig.node.Node):
    filters = [0x190, 0x590, 0x710]
    silent = [0x710]

    def on_start(self):
        self.step, self.is_up = 0, False
        self.every(0.01, "tick")
        self.at(0.005, "once")

    def on_time(self, name):
        if name == "sync":
            self.send(0x080)
        elif name == "once":
            print("once at", self.now)
        else:
            self.send(0x701, b"\\x05")
            if not self.is_up:
                self.send(0x000, bytes([130, LOOP.drive_id]))
            elif self.step == 0:
                self.go_on()
            elif self.step == 4:
                self.step = 5
                self.every(PART.period_seconds, "sync")

    def go_on(self):
        if self.step < 3:
            self.send(0x610, bytes.fromhex(OBJECTS[self.step]))
        else:
            self.send(0x000, bytes([1, 0]))
        self.step += 1

    def on_frame(self, frame):
        if frame.id == 0x710:
            self.is_up = self.is_up or frame.data == bytes(1)
        elif frame.id == 0x590 and self.step < 4:
            self.go_on()
        elif frame.id == 0x190:
            status, micrometres = struct.unpack_from("<Hi", frame.data)
            seen = LOOP.reads.decode(frame.data)
            assert abs(seen["position_millimetres"] - 1e-3 * micrometres) < 1e-9, seen
            word = {0x40: 6, 0x21: 7, 0x08: 0x80}.get(status & 0x6F, 15)
            amperes = 0.2 if status & 0x6F == 0x27 else 0.0
            self.send(LOOP.writes.id, struct.pack("<Hh", word, round(1000 * amperes)))
            {DOES}

    def on_stop(self):
        print("stopped", self.bus.seed, self.bus.node_id)

Lead.run()
"""

SCENARIO = """
schema = 1
rig = "dc_motor"
name = "a node in Python"
seed = 7
duration_seconds = 0.5
[node.controller]
program = ["python3", "node.py"]
[[reference.hold]]
at_seconds = 0.0
position_millimetres = 10.0
"""


@pytest.fixture
def node(tmp_path):
    def write(does="pass"):
        (tmp_path / "node.py").write_text(LEAD.replace("{DOES}", does))
        scenario = tmp_path / "node.toml"
        scenario.write_text(SCENARIO)
        return scenario

    return write


def test_a_class_leads_and_repeats_itself(node, output):
    runs = [canrig.simulate(node(), output=output) for _ in range(2)]
    assert [run.outcome for run in runs] == ["pass", "pass"]
    logs = [(run.folder / "bus.log").read_bytes() for run in runs]
    assert logs[0] == logs[1]
    assert b" 210#0F00C800" in logs[0]
    assert (runs[0].folder / "controller.log").read_text() == "once at 0.005\nstopped 7 1\n"


@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("raise ValueError('no gain')", "ValueError: no gain"),
        (
            "failed = []; threading.excepthook = lambda hooked: failed.append(hooked.exc_value);"
            " other = threading.Thread(target=self.send, args=(1,), name='other'); other.start(); other.join();"
            " raise failed[0]",
            "the thread `other` cannot use the bus",
        ),
        ("self.send(1, bytes(9))", "a frame has at most 8 bytes, not 9"),
        ("[self.send(1) for _ in range(2000)]", "1024 frames wait to be sent"),
        ("self.at(self.now, 'tick'); self.on_frame = lambda frame: None; self.on_time = lambda name: self.at(self.now, name)", "does not move"),
    ],
)
def test_what_goes_wrong_is_named(node, output, does, said):
    run = canrig.simulate(node(does), output=output)
    assert run.outcome == "fail"
    assert said in (run.folder / "verdict.json").read_text()


def test_signals_are_read_and_written():
    signal = {"unit": "", "is_little_endian": True, "factor": 0.001, "offset": 0.0}
    layout = canrig.node.Layout(
        {
            "id": 0x190,
            "length": 8,
            "signals": [
                {**signal, "name": "state", "start_bit": 0, "bits": 7, "kind": "unsigned", "factor": 1.0},
                {**signal, "name": "position", "start_bit": 16, "bits": 32, "kind": "signed"},
            ],
        }
    )
    data = layout.encode(state=39, position=-12.5)
    assert data == struct.pack("<Hih", 39, -12500, 0)
    assert layout.decode(data) == {"state": 39.0, "position": -12.5}
    assert layout.decode(data[:2]) == {"state": 39.0}
    assert layout.encode(position=1e9) == struct.pack("<Hih", 0, 2**31 - 1, 0)
    with pytest.raises(ValueError, match="there is no signal `speed`; known here: state, position"):
        layout.encode(speed=1.0)


def test_a_set_point_is_followed_forwards_and_backwards():
    told = {"name": "", "drive": {"name": "drive", "node_id": 16}, "io": [], "signal": "x", "range": [0, 60], "reads": None, "writes": None}
    rows = [[0.0, 10.0], [2.0, 10.0], [2.0, 35.0], [4.0, 15.0]]
    loop = canrig.node.Loop({**told, "command_range": [-1, 1], "set_point": rows})
    for seconds, expected in [(0.0, 10.0), (1.999, 10.0), (2.0, 35.0), (3.0, 25.0), (9.0, 15.0), (1.0, 10.0), (-1.0, 10.0)]:
        assert math.isclose(loop.set_point(seconds), expected)


def test_a_bus_needs_an_address(monkeypatch):
    monkeypatch.delenv("CANRIG_BUS", raising=False)
    with pytest.raises(RuntimeError, match="no bus is named"):
        canrig.node.Bus.open()


@pytest.mark.parametrize("identifier", [0x800, 0x1FFFFFFF, canrig.node.REMOTE | 0x800, canrig.node.EXTENDED | 0x20000000, -1])
def test_an_identifier_that_would_be_cut_is_refused(identifier):
    with pytest.raises(ValueError, match="does not fit"):
        canrig.node._pairs([identifier])
    ours, _theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    bus = object.__new__(canrig.node._RealBus)
    bus._channel = ours
    with pytest.raises(ValueError, match="does not fit"):
        bus.send(identifier)
    ours.close()
    _theirs.close()


def test_a_filter_of_29_bits_takes_that_identifier_alone():
    assert canrig.node._pairs([0x7FF, canrig.node.EXTENDED | 0x12345]) == [
        (0x7FF, canrig.node.EXTENDED | canrig.node.REMOTE | 0x7FF),
        (canrig.node.EXTENDED | 0x12345, canrig.node.EXTENDED | canrig.node.REMOTE | 0x1FFFFFFF),
    ]
