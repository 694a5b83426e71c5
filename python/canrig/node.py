"""A node in Python for canrig: a controller, a drive or an io node, from one source in every world.

A rig file names it (``[node.controller] program = ["python3", "controller.py"]``), or the command line
(``canrig simulate step.toml -- python3 controller.py``). In virtual time it plays repeatably, in real time by the clock. As a class:

.. code-block:: python

    import canrig.node

    class Controller(canrig.node.Node):
        filters = [0x190, 0x590, 0x710]

        def on_start(self):
            self.every(0.001, "sync")

        def on_time(self, name):
            self.send(0x080)

        def on_frame(self, frame):
            ...

    Controller.run()

As a loop:

.. code-block:: python

    with canrig.node.Bus.open(filters=[0x190]) as bus:
        while not bus.is_stopping:
            frame = bus.wait(until=bus.now + 0.001)

It needs the standard library only, and no thread besides the one that opened the bus. The protocol between node and canrig is in
the book: "Seats of programs".
"""

from __future__ import annotations

import heapq
import json
import os
import select
import socket
import struct
import threading
import time
import traceback
from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple, Union

__all__ = ["Bus", "Ended", "Frame", "Layout", "Loop", "Node", "Part", "part"]

#: The bus of the node, its part of the plan, and the pipe that ends with canrig, where canrig has started this program.
ADDRESS, PART, LIFELINE = "CANRIG_BUS", "CANRIG_PART", "CANRIG_LIFELINE"

#: Flags of identifiers, as the kernel has them.
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
#: Frames that may wait to be sent at one time.
FRAMES_MAX = 1024

_STANDARD_ID, _EXTENDED_ID = 0x7FF, 0x1FFFFFFF
_ERRORS = (0, ERROR | 0x1FFFFFFF)
_MESSAGE_BYTES_MAX = 128 << 10
_HEADER = struct.Struct("<BBHIQ")
_RECORD = struct.Struct("<QIBBH8s")
_FILTER = struct.Struct("<II")
_KERNEL_FRAME = struct.Struct("=IB3x8s")
_VERSION, _MAGIC, _NEVER = 1, 0x47495243, 0xFFFFFFFFFFFFFFFF
_HELLO, _WELCOME, _GRANT, _DONE, _STOP = 1, 2, 3, 4, 5
_STOPPED, _FAILED = 1, 2
_HALTED = 1
_BUS_SEAT, _ERRORS_TOO = 0, 2
_WELCOME_BYTES = 40
_WAKE_UPS_MAX = 1000
_SECOND = 1_000_000_000

Filters = Iterable[Union[int, Tuple[int, int]]]


class Frame(NamedTuple):
    """A frame, with the time at which it passed, in seconds."""

    time: float
    id: int
    data: bytes


class Ended(Exception):
    """The end of canrig or of the bus."""


class Bus:
    """A bus for a program that is a loop."""

    @staticmethod
    def open(address: Optional[str] = None, *, name: str = "", filters: Filters = (), silent: Filters = (), errors: bool = False) -> "Bus":
        """Opens a bus; without an address the one that canrig has put into the environment.

        ``filters`` are the frames that arrive: identifiers, or pairs of identifier and mask. ``silent`` are those of them at which
        the node neither sends nor moves its wake-up earlier, which saves questions in virtual time. With ``errors`` error frames arrive, too.
        """
        address = address or os.environ.get(ADDRESS)
        if not address:
            raise RuntimeError(f"no bus is named: canrig starts this program, or set {ADDRESS}, as in {ADDRESS}=vcan0")
        world, _, path = address.partition(":")
        heard, quiet = _pairs(filters), _pairs(silent)
        if world == "lockstep":
            return _VirtualBus(path, name, heard, quiet, errors)
        return _RealBus(address, heard + ([_ERRORS] if errors else []))

    #: canrig has asked for the end: bring the outputs to a safe state, then leave.
    is_stopping = False

    @property
    def now(self) -> float:
        """The time in seconds: of the latest frame or wake-up, or of the clock in real time."""
        return self.now_ns / _SECOND

    @property
    def now_ns(self) -> int:
        raise NotImplementedError

    def wait(self, until: Optional[float] = None) -> Optional[Frame]:
        """Waits for the next frame. Returns `None` when the time has come, or when canrig asks for the end.

        A node that waits until a time promises to send nothing before it unless a frame arrives.
        """
        return self.wait_ns(_NEVER if until is None else max(0, round(until * _SECOND)))

    def wait_ns(self, until: int) -> Optional[Frame]:
        raise NotImplementedError

    def send(self, identifier: int, data: bytes = b"") -> None:
        """Queues a frame. An identifier of 29 bits is ``EXTENDED`` and its bits; others have 11 bits."""
        raise NotImplementedError

    def fail(self, why: str) -> None:
        """Ends the run with a reason, in which this node is named."""
        raise NotImplementedError

    def close(self) -> None:
        """Leaves the bus."""
        raise NotImplementedError

    def __enter__(self) -> "Bus":
        return self

    def __exit__(self, kind: Any, error: Any, _: Any) -> None:
        if error is None or isinstance(error, Ended):
            self.close()
        else:
            self.fail(described(error))


def described(error: BaseException, *own: str) -> str:
    """An error with the line of the program that it came from: not one of a library, of this file, or of the files `own`."""
    libraries = os.path.dirname(os.__file__)
    place: Optional[traceback.FrameSummary] = None
    for frame in traceback.extract_tb(error.__traceback__):
        is_of_library = frame.filename.startswith(libraries) or "site-packages" in frame.filename
        if frame.filename not in (__file__, *own) and not is_of_library:
            place = frame
    where = f" ({os.path.basename(place.filename)}, line {place.lineno})" if place else ""
    return f"{type(error).__name__}: {error}{where}"


def _refuse_cut(identifier: int) -> None:
    """Refuses an identifier that a frame cannot have: its bits would be cut, and the frame be another one."""
    bits = identifier & ~(EXTENDED | REMOTE)
    if not 0 <= bits <= (_EXTENDED_ID if identifier & EXTENDED else _STANDARD_ID):
        size = 29 if identifier & EXTENDED else 11
        hint = "" if size == 29 else ": a frame of 29 bits has the identifier EXTENDED | 0x{:X} (canrig.node.EXTENDED)".format(bits)
        raise ValueError(f"the identifier 0x{bits:X} does not fit {size} bits{hint}")


def _pairs(filters: Filters) -> List[Tuple[int, int]]:
    return [_exact(one) if isinstance(one, int) else one for one in filters]


def _exact(identifier: int) -> Tuple[int, int]:
    _refuse_cut(identifier)
    return identifier, EXTENDED | REMOTE | (_EXTENDED_ID if identifier & EXTENDED else _STANDARD_ID)


def _standard(wanted: int, mask: int) -> Iterator[int]:
    """The identifiers of 11 bits that pass a filter."""
    fixed, free = wanted & mask, ~mask & 0x7FF
    part = free
    while fixed <= 0x7FF:
        yield fixed | part
        if not part:
            return
        part = (part - 1) & free


class _VirtualBus(Bus):
    def __init__(self, path: str, name: str, filters: List[Tuple[int, int]], silent: List[Tuple[int, int]], errors: bool) -> None:
        self._channel = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel.connect(path)
        self._thread = threading.get_ident()
        self._buffer = bytearray(_MESSAGE_BYTES_MAX)
        hello = _HEADER.pack(_HELLO, _VERSION, len(filters), _MAGIC, 0)
        hello += struct.pack("<BBHI32s", _BUS_SEAT, _ERRORS_TOO if errors else 0, len(silent), 0, name.encode()[:31])
        self._channel.send(hello + b"".join(_FILTER.pack(*one) for one in filters + silent))
        length = self._receive()
        if length < _WELCOME_BYTES or self._buffer[0] != _WELCOME:
            raise RuntimeError(f"canrig sent a message of kind {self._buffer[0]} in place of WELCOME")
        self._now: int = _HEADER.unpack_from(self._buffer)[4]
        #: Rate of the bus, seed of the run, node-ID.
        self.bits_per_second, _, self.seed, self.node_id = struct.unpack_from("<IIQB", self._buffer, 16)
        #: Identifiers of 11 bits whose frames no node answers. Remote frames and extended ones may always be answered.
        self._quiet = {one for pair in _FILTER.iter_unpack(bytes(self._buffer[_WELCOME_BYTES:length])) for one in _standard(*pair)}
        self._records: Any = iter(())
        self._record: Optional[Tuple[Any, ...]] = None
        self._queued: List[bytes] = []
        self._is_asked = self._may_go_on = self._is_over = False
        self._number = self._to = self._until = self._idle = 0

    @property
    def now_ns(self) -> int:
        return self._now

    def _receive(self) -> int:
        length = self._channel.recv_into(self._buffer)
        if not length:
            self._is_over = True
            raise Ended("canrig is gone")
        return length

    def _ask(self) -> bool:
        """Receives a question; true if it asks for the end."""
        length = self._receive()
        kind, a, count, self._number, self._to = _HEADER.unpack_from(self._buffer)
        self._is_asked, self._may_go_on, self._until = True, False, self._to
        self._records, self._record = iter(()), None
        if kind == _STOP:
            self.is_stopping, self._now = True, max(self._now, self._to)
            return True
        if kind != _GRANT or length != 24 + count * _RECORD.size:
            raise RuntimeError(f"canrig sent a message of kind {kind}, and a node knows GRANT and STOP")
        (self._until,) = struct.unpack_from("<Q", self._buffer, 16)
        if a & _HALTED:
            self._now = max(self._now, self._to)
        self._records = _RECORD.iter_unpack(bytes(self._buffer[24:length]))
        self._record = next(self._records, None)
        self._may_go_on = all(_RECORD.unpack(record)[1] in self._quiet for record in self._queued)
        return False

    def _answer(self, a: int, until: int, reached: int, text: bytes = b"") -> None:
        header = _HEADER.pack(_DONE, a, len(self._queued), self._number, until)
        message = header + struct.pack("<Q", reached) + b"".join(self._queued) + text
        self._queued.clear()
        self._is_asked, self._now = False, max(self._now, reached)
        try:
            self._channel.send(message)
        except (BrokenPipeError, ConnectionResetError) as error:
            self._is_over = True
            raise Ended("canrig is gone") from error

    def _wake(self, until: int) -> None:
        self._idle = 0 if until > self._now else self._idle + 1
        self._now = max(self._now, until)
        if self._idle > _WAKE_UPS_MAX:
            raise RuntimeError(f"more than {_WAKE_UPS_MAX} wake-ups at {self.now} s: the deadline does not move")

    def wait_ns(self, until: int) -> Optional[Frame]:
        self._refuse_threads()
        if self._is_over:
            raise Ended("canrig is gone")
        while True:
            if self._is_asked:
                if self._record is not None:
                    at, identifier, length, _, _, data = self._record
                    if until < at:
                        self._wake(until)
                        return None
                    self._record, self._idle, self._now = next(self._records, None), 0, max(self._now, at)
                    return Frame(at / _SECOND, identifier, data[:length])
                if until <= self._to or (self._may_go_on and until <= self._until):
                    self._wake(until)
                    return None
                self._answer(0, until, self._until if self._may_go_on else max(self._now, self._to))
            if self._ask():
                return None

    def send(self, identifier: int, data: bytes = b"") -> None:
        self._refuse_threads()
        _refuse_cut(identifier)
        if len(data) > 8:
            raise ValueError(f"a frame has at most 8 bytes, not {len(data)}")
        if len(self._queued) == FRAMES_MAX:
            raise BufferError(f"{FRAMES_MAX} frames wait to be sent: wait() first")
        self._queued.append(_RECORD.pack(self._now, identifier, len(data), 0, 0, bytes(data)))
        self._may_go_on = self._may_go_on and identifier in self._quiet

    def _refuse_threads(self) -> None:
        if threading.get_ident() != self._thread:
            name = threading.current_thread().name
            raise RuntimeError(f"the thread `{name}` cannot use the bus: in virtual time only the one that opened it can")

    def _leave(self, a: int, text: bytes = b"") -> None:
        try:
            while not self._is_over and not self._is_asked:
                self._ask()
            if not self._is_over:
                self._answer(a, _NEVER, self._now, text)
        except Ended:
            pass
        self._is_over = True
        self._channel.close()

    def fail(self, why: str) -> None:
        self._leave(_FAILED, why.encode()[:1024])

    def close(self) -> None:
        self._leave(_STOPPED)


class _RealBus(Bus):
    def __init__(self, address: str, filters: List[Tuple[int, int]]) -> None:
        world, _, path = address.partition(":")
        if world == "embedded":
            self._channel = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self._channel.connect(path)
            self._channel.send(b"".join(struct.pack("=II", *one) for one in filters or [(0, ERROR)]))
            self._channel.recv(16)
        else:
            self._channel = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            heard = [one for one in filters if one != _ERRORS]
            self._channel.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"".join(struct.pack("=II", *one) for one in heard))
            if len(heard) < len(filters):
                self._channel.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_ERR_FILTER, 0x1FFFFFFF)
            self._channel.bind((address,))
        lifeline = os.environ.get(LIFELINE)
        self._lifeline = int(lifeline) if lifeline is not None and _is_open(int(lifeline)) else None
        self._end = _NEVER

    @property
    def now_ns(self) -> int:
        return time.monotonic_ns()

    def wait_ns(self, until: int) -> Optional[Frame]:
        while True:
            end = min(until, self._end)
            left = None if end == _NEVER else max(0, end - self.now_ns) / _SECOND
            watched = [self._channel] + ([self._lifeline] if self._lifeline is not None else [])
            ready, _, _ = select.select(watched, [], [], left)
            if not ready:
                if end < until:
                    raise Ended("canrig waits no longer")
                return None
            if self._lifeline is not None and self._lifeline in ready and not os.read(self._lifeline, 8):
                self._lifeline, self.is_stopping, self._end = None, True, self.now_ns + _SECOND
                return None
            if self._channel in ready:
                packet = self._channel.recv(_KERNEL_FRAME.size)
                if not packet:
                    raise Ended("the bus is gone")
                if len(packet) == _KERNEL_FRAME.size:
                    identifier, length, data = _KERNEL_FRAME.unpack(packet)
                    return Frame(self.now, identifier, data[:length])

    def send(self, identifier: int, data: bytes = b"") -> None:
        _refuse_cut(identifier)
        if len(data) > 8:
            raise ValueError(f"a frame has at most 8 bytes, not {len(data)}")
        self._channel.send(_KERNEL_FRAME.pack(identifier, len(data), bytes(data)))

    def fail(self, why: str) -> None:
        self.close()

    def close(self) -> None:
        self._channel.close()


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


class Layout:
    """Signals in the data of a frame."""

    def __init__(self, told: Dict[str, Any]) -> None:
        self.id: int = told["id"]
        self.length: int = told["length"]
        self.signals: List[Dict[str, Any]] = told["signals"]

    def decode(self, data: bytes) -> Dict[str, float]:
        """The signals in the data, by their names."""
        raw = int.from_bytes(data, "little")
        values: Dict[str, float] = {}
        for signal in self.signals:
            first, bits = signal["start_bit"], signal["bits"]
            if first + bits <= 8 * len(data):
                values[signal["name"]] = _physical(raw >> first & (1 << bits) - 1, signal)
        return values

    def encode(self, **values: float) -> bytes:
        """Data with these signals, and 0 for all others."""
        raw = 0
        for signal in self.signals:
            value = values.pop(signal["name"], 0.0)
            raw |= _steps(value, signal) << signal["start_bit"]
        if values:
            known = ", ".join(signal["name"] for signal in self.signals)
            raise ValueError(f"there is no signal `{next(iter(values))}`; known here: {known}")
        return raw.to_bytes(self.length, "little")


def _physical(raw: int, signal: Dict[str, Any]) -> float:
    bits: int = signal["bits"]
    factor: float = signal["factor"]
    offset: float = signal["offset"]
    value: float
    if signal["kind"] == "float":
        value = struct.unpack("<f" if bits == 32 else "<d", raw.to_bytes(bits // 8, "little"))[0]
    else:
        is_negative = signal["kind"] == "signed" and raw >> bits - 1
        value = raw - (1 << bits) if is_negative else raw
    return value * factor + offset


def _steps(value: float, signal: Dict[str, Any]) -> int:
    bits: int = signal["bits"]
    steps: float = (value - signal["offset"]) / signal["factor"]
    if signal["kind"] == "float":
        return int.from_bytes(struct.pack("<f" if bits == 32 else "<d", steps), "little")
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signal["kind"] == "signed" else (0, (1 << bits) - 1)
    return min(max(round(steps), low), high) & (1 << bits) - 1


class Loop:
    """The facts about a loop that a node may know."""

    def __init__(self, told: Dict[str, Any]) -> None:
        #: Its name among several; empty for an only one.
        self.name: str = told["name"]
        #: Name and node-ID of its drive, and of io nodes beside it.
        self.drive: str = told["drive"]["name"]
        self.drive_id: int = told["drive"]["node_id"]
        self.io_ids: List[int] = [io["node_id"] for io in told["io"]]
        #: Signal that follows the set-point, with the range of both.
        self.signal: str = told["signal"]
        self.range: Tuple[float, float] = tuple(told["range"])
        #: What its drive can be commanded.
        self.command_range: Tuple[float, float] = tuple(told["command_range"])
        #: Frames: the drive's with the signal, and the one with its command.
        self.reads: Optional[Layout] = Layout(told["reads"]) if told["reads"] else None
        self.writes: Optional[Layout] = Layout(told["writes"]) if told["writes"] else None
        #: Rows of time in seconds and set-point, with straight lines between them.
        self.rows: Sequence[Tuple[float, float]] = told.get("set_point", [])
        #: The frame with the set-point of the next SYNC, where the bench sends it.
        self.set_points: Optional[Layout] = Layout(told["set_points"]) if told.get("set_points") else None
        self._place = 0

    def set_point(self, seconds: float) -> float:
        """The set-point at a time of the scenario, which begins with the first SYNC after the drive reported Operation enabled."""
        rows = self.rows
        if self._place and rows[self._place][0] > seconds:
            self._place = 0
        while self._place + 1 < len(rows) and rows[self._place + 1][0] <= seconds:
            self._place += 1
        if self._place + 1 >= len(rows):
            return rows[-1][1] if rows else 0.0
        (before, value), (after, next_value) = rows[self._place], rows[self._place + 1]
        return value + (next_value - value) * max(0.0, seconds - before) / (after - before)


class Part:
    """The facts about the plan that a node may know: itself, the bus, and of each loop the frames, the limits and the set-point."""

    def __init__(self, told: Dict[str, Any]) -> None:
        self.name: str = told["node"]["name"]
        self.node_id: int = told["node"]["node_id"]
        self.bits_per_second: int = told["bus"]["bits_per_second"]
        self.period_seconds: float = told["bus"]["period_seconds"]
        self.loops = [Loop(one) for one in told["loops"]]


def part() -> Part:
    """The part of this node, where canrig has started it."""
    path = os.environ.get(PART)
    if path is None:
        raise RuntimeError(f"canrig starts this program: {PART} is not set")
    with open(path, encoding="utf-8") as file:
        return Part(json.load(file))


class Node:
    """A node as a class, with methods for its start, a frame, a time, and the end."""

    #: Frames that arrive: identifiers, or pairs of identifier and mask.
    filters: Filters = ()
    #: Those of them that make it neither send nor wake earlier.
    silent: Filters = ()
    #: Whether error frames arrive, too.
    errors = False

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self._times: List[Tuple[int, int, str, int]] = []
        self._order = 0

    @classmethod
    def run(cls, address: Optional[str] = None) -> None:
        """Plays the node until canrig asks for the end."""
        bus = Bus.open(address, name=cls.__name__, filters=cls.filters, silent=cls.silent, errors=cls.errors)
        try:
            with bus:
                cls(bus).play()
        except Ended:
            pass

    def play(self) -> None:
        """Plays the node until canrig asks for the end."""
        self.on_start()
        while not self.bus.is_stopping:
            due = self._times[0][0] if self._times else _NEVER
            frame = self.bus.wait_ns(due)
            if frame is not None:
                self.on_frame(frame)
            elif not self.bus.is_stopping and self._times:
                at, _, name, period = heapq.heappop(self._times)
                if period:
                    # Missed periods are skipped.
                    missed = (self.bus.now_ns - at) // period
                    self._push(at + (1 + max(0, missed)) * period, name, period)
                self.on_time(name)
        self.on_stop()

    @property
    def now(self) -> float:
        """The time in seconds."""
        return self.bus.now

    def send(self, identifier: int, data: bytes = b"") -> None:
        """Queues a frame."""
        self.bus.send(identifier, data)

    def at(self, seconds: float, name: str) -> None:
        """Asks for :meth:`on_time` once, at a time."""
        self._push(max(0, round(seconds * _SECOND)), name, 0)

    def every(self, period: float, name: str) -> None:
        """Asks for :meth:`on_time` now and then after each period, in seconds; missed periods are skipped."""
        self._push(self.bus.now_ns, name, max(1, round(period * _SECOND)))

    def _push(self, at: int, name: str, period: int) -> None:
        self._order += 1
        heapq.heappush(self._times, (at, self._order, name, period))

    def on_start(self) -> None:
        """Begins."""

    def on_frame(self, frame: Frame) -> None:
        """Takes a frame."""

    def on_time(self, name: str) -> None:
        """Acts at a time that was asked for."""

    def on_stop(self) -> None:
        """Brings the outputs to a safe state, at once."""
