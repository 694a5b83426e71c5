"""A control law in Python, which canrig plays in every world: ``[controller.program]`` of a scenario.

The scenario names the inputs and outputs of the law; a class computes them:

.. code-block:: python

    import canrig.law

    @canrig.law.register
    class Proportional:
        def __init__(self, setup):
            self.gain = setup.parameters.gain

        def step(self, cycle, x):
            error = x.set_point_millimetres - x.position_millimetres
            return {"command": self.gain * error}

It needs the standard library only. The protocol between law and canrig is in the book: "Seats".
"""

from __future__ import annotations

import json
import os
import socket
import struct
import sys
from typing import Any, Iterator, List, Mapping, Tuple

from .node import described

__all__ = ["Cycle", "Names", "Setup", "register"]

#: The socket of the law's seat, where canrig started this program.
ADDRESS = "CANRIG_PORTS"

_MESSAGE_BYTES_MAX = 128 << 10
_HEADER = struct.Struct("<BBHIQ")
_VERSION = 1
_MAGIC = 0x47495243
_NEVER = 0xFFFFFFFFFFFFFFFF
_HELLO, _WELCOME, _DONE, _STOP, _STEP, _VALUES = 1, 2, 4, 5, 6, 7
_STOPPED, _FAILED = 1, 2
_PORT_SEAT = 1
_WELCOME_BYTES = 40


class Names:
    """Values by their names: ``x.position_millimetres``, or ``x["flexor.position_degrees"]``."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.__dict__.update(values)

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.__dict__)

    def __len__(self) -> int:
        return len(self.__dict__)

    def __getattr__(self, name: str) -> Any:
        known = ", ".join(self.__dict__) or "nothing"
        raise AttributeError(f"there is no `{name}`; known here: {known}")

    def __repr__(self) -> str:
        return f"Names({self.__dict__!r})"


class Setup:
    """The law's part of the scenario."""

    def __init__(self, welcome: Mapping[str, Any], seed: int) -> None:
        #: What the law reads, in the scenario's order.
        self.reads: List[str] = welcome["reads"]
        #: What it commands.
        self.writes: List[str] = welcome["writes"]
        #: What it writes besides.
        self.terms: List[str] = welcome["terms"]
        #: Lowest and highest value of each of ``writes`` that its drive can be commanded.
        self.ranges: List[Tuple[float, float]] = [(low, high) for low, high in welcome["ranges"]]
        #: Its parameters, by their names.
        self.parameters = Names(welcome["parameters"])
        #: Time between two cycles.
        self.period_seconds: float = welcome["period_seconds"]
        #: The seed of the run.
        self.seed = seed


class Cycle:
    """Number and time of the law's step."""

    __slots__ = ("is_missing", "period_seconds", "time_seconds")

    def __init__(self) -> None:
        #: Time since the start of the scenario.
        self.time_seconds = 0.0
        #: Time since the cycle before.
        self.period_seconds = 0.0
        #: Whether a value that is read is missing in this cycle: it is not a number.
        self.is_missing = False


def register(law: Any) -> Any:
    """Plays a class as the law of this program, where canrig has started it; elsewhere, as in a test that imports it, does nothing.

    The class is made with a :class:`Setup`. Its ``step(cycle, x)`` returns a value for each of ``writes`` and ``terms``, by their
    names. A method ``stop()``, if it has one, is called at the end. Code after the class in the file is not reached.
    """
    address = os.environ.get(ADDRESS)
    if address is None:
        return law
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as channel:
        channel.connect(address)
        _play(law, channel)
    sys.exit(0)


def _play(law: Any, channel: socket.socket) -> None:
    name = law.__name__.encode()[:31]
    hello = _HEADER.pack(_HELLO, _VERSION, 0, _MAGIC, 0)
    channel.send(hello + struct.pack("<BBHI32s", _PORT_SEAT, 0, 0, 0, name))
    welcome = channel.recv(_MESSAGE_BYTES_MAX)
    if not welcome:
        return
    if welcome[0] != _WELCOME:
        raise RuntimeError(f"canrig sent a message of kind {welcome[0]} in place of WELCOME")
    (seed,) = struct.unpack_from("<Q", welcome, 24)
    setup = Setup(json.loads(welcome[_WELCOME_BYTES:]), seed)
    try:
        played = law(setup)
    except Exception as error:
        channel.send(_HEADER.pack(_DONE, _FAILED, 0, 0, _NEVER) + described(error, __file__).encode()[:1024])
        raise
    channel.send(_done(0, 0))
    outputs = setup.writes + setup.terms
    step_of = struct.Struct(f"<BBHIQd{len(setup.reads)}d")
    values_of = struct.Struct(f"<BBHIQ{len(outputs)}d")
    x = Names(dict.fromkeys(setup.reads, 0.0))
    reads, cycle = x.__dict__, Cycle()
    step, buffer = played.step, bytearray(_MESSAGE_BYTES_MAX)
    while channel.recv_into(buffer):
        kind, number = buffer[0], int.from_bytes(buffer[4:8], "little")
        if kind == _STOP:
            if hasattr(played, "stop"):
                played.stop()
            channel.send(_done(number, _STOPPED))
            return
        if kind != _STEP:
            raise RuntimeError(f"canrig sent a message of kind {kind}, and a law knows STEP and STOP")
        _, missing, _, _, time, cycle.period_seconds, *read = step_of.unpack_from(buffer)
        cycle.time_seconds, cycle.is_missing = time / 1e9, bool(missing & 1)
        reads.update(zip(setup.reads, read))
        try:
            values = _values(step(cycle, x), outputs)
            answer = values_of.pack(_VALUES, 0, len(outputs), number, time, *values)
        except Exception as error:
            answer = _HEADER.pack(_VALUES, _FAILED, 0, number, time) + described(error, __file__).encode()[:1024]
            channel.send(answer)
            raise
        channel.send(answer)


def _done(number: int, a: int) -> bytes:
    return _HEADER.pack(_DONE, a, 0, number, _NEVER) + bytes(8)


def _values(returned: Any, outputs: List[str]) -> List[float]:
    """The values that a step returned, in the order of the outputs."""
    try:
        values = [returned[name] for name in outputs]
    except (KeyError, TypeError) as error:
        missing = _missing(returned, outputs)
        raise ValueError(f"step() is to return a dictionary with {', '.join(outputs)}{missing}") from error
    if len(returned) != len(outputs):
        unknown = ", ".join(name for name in returned if name not in outputs)
        raise ValueError(f"step() returned {unknown}, which is neither in `writes` nor in `terms`")
    return values


def _missing(returned: Any, outputs: List[str]) -> str:
    if not isinstance(returned, dict):
        return f", not {type(returned).__name__}"
    return f"; it lacks {', '.join(name for name in outputs if name not in returned)}"
