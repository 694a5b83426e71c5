"""Python's waits and clocks in virtual time, for python-can, python-canopen, can-isotp and udsoncan.

The first line of a program:

.. code-block:: python

    import canrig.virtual

    import can
    import canopen

    with canopen.Network() as network:
        network.connect(interface="canrig")
        drive = network.add_node(16, "drive.eds")
        drive.nmt.wait_for_bootup(1.0)

If canrig plays the program in virtual time (`CANRIG_BUS` begins with `lockstep:`), `time.sleep`, the clocks of `time`, and every wait of
`threading` and `queue` go by the time of the bus. The threads of `can.Notifier`, `isotp.TransportLayer` and udsoncan's
`PythonIsoTpV1Connection` take turns with the program. A thread of the program's own and an `asyncio` loop raise `RuntimeError`. In real
time the line changes nothing.
"""

from __future__ import annotations

import _thread
import logging
import os
import queue
import sys
import threading
import time
from typing import Any, Callable, Optional

from . import _turns
from .node import ADDRESS

__all__ = ["is_active"]

#: Whether waits and clocks are those of virtual time.
is_active = os.environ.get(ADDRESS, "").startswith("lockstep:")

#: Threads that wait for nothing but frames, locks and times.
_KNOWN = ("can.notifier.Notifier.", "isotp.protocol.TransportLayer.", "udsoncan.connections.PythonIsoTpV1Connection.")
#: Modules that keep a clock or a wait of their own from the moment of their import.
_LATER = ("can", "canopen", "isotp", "udsoncan")


def _sleep(seconds: float) -> None:
    if seconds < 0:
        raise ValueError("sleep length must be non-negative")
    _turns.wait(bool, _turns.deadline(seconds))


class _Lock:
    """A lock whose wait is one of virtual time; all other waits of `threading` and `queue` are made of it."""

    def __init__(self) -> None:
        self._lock = _thread.allocate_lock()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if timeout != -1 and (not blocking or timeout < 0):
            raise ValueError("a time-out is positive, and only of a blocking call")
        if self._lock.acquire(False):
            return True
        if not blocking:
            return False
        return _turns.wait(lambda: self._lock.acquire(False), _turns.NEVER if timeout == -1 else _turns.deadline(timeout))

    def release(self) -> None:
        self._lock.release()

    def locked(self) -> bool:
        return self._lock.locked()

    def _at_fork_reinit(self) -> None:
        self._lock = _thread.allocate_lock()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class _Started:
    """The event by which a new thread reports that it has started: the one wait that takes no turn."""

    def __init__(self) -> None:
        self._lock = _thread.allocate_lock()
        self._lock.acquire()
        self._is_set = False

    def set(self) -> None:
        if not self._is_set:
            self._is_set = True
            self._lock.release()

    def is_set(self) -> bool:
        return self._is_set

    def wait(self, timeout: Optional[float] = None) -> bool:
        if not self._is_set:
            with self._lock:
                pass
        return True


_start: Callable[[threading.Thread], None] = threading.Thread.start
_join: Callable[[threading.Thread], None] = threading.Thread.join


def _start_in_turn(thread: Any) -> None:
    target = getattr(thread, "_target", None) or type(thread).run
    name = f"{getattr(target, '__module__', '')}.{getattr(target, '__qualname__', '')}"
    if not name.startswith(_KNOWN):
        raise RuntimeError(
            f"the thread `{thread.name}` of {name} is refused: in virtual time a program has one thread, or its runs would differ. "
            "Wait in that one, as with recv(timeout) or sleep, hear frames with can.Notifier and send them with send_periodic, "
            "or play the program in real time"
        )
    if not thread._started.is_set():
        thread._started = _Started()
        thread._canrig_turn = _turns.begin(thread, _start)
    else:
        _start(thread)


def _join_in_turn(thread: Any, timeout: Optional[float] = None) -> None:
    turn: Optional[_turns.Turn] = getattr(thread, "_canrig_turn", None)
    if turn is not None and thread is not threading.current_thread():
        # It was told to end, and looks when its wait is over.
        turn.until = min(turn.until, _turns.now_ns())
        until = _turns.NEVER if timeout is None else _turns.deadline(max(0.0, timeout))
        if not _turns.wait(lambda: turn.is_over, until):
            return
    _join(thread)


class _Swallowed(logging.Handler):
    """An error of a listener that python-canopen catches and logs: here it ends the program, as one of python-can's does."""

    def emit(self, record: logging.LogRecord) -> None:
        error = sys.exc_info()[1]
        if error is not None:
            _turns.fail(error)


def _refuse_loop(*_: Any, **__: Any) -> None:
    raise RuntimeError("an asyncio loop is refused: in virtual time a program waits in one thread, as with recv(timeout) or sleep")


def _activate() -> None:
    early = [name for name in _LATER if name in sys.modules]
    if early:
        raise RuntimeError(f"`import canrig.virtual` comes too late: it must stand before the import of {', '.join(early)}")
    others = [thread.name for thread in threading.enumerate() if thread is not threading.current_thread()]
    if others:
        raise RuntimeError(f"`import canrig.virtual` comes too late: the thread `{others[0]}` runs already")
    from asyncio import base_events

    for name in ("time", "monotonic", "perf_counter"):
        setattr(time, name, _turns.seconds)
        setattr(time, f"{name}_ns", _turns.read_ns)
    setattr(time, "sleep", _sleep)
    # Conditions, events, semaphores and queues are Python over locks; the standard library knows the locks by these names.
    for name, value in (("Lock", _Lock), ("_allocate_lock", _Lock), ("RLock", getattr(threading, "_PyRLock")), ("_time", _turns.seconds)):
        setattr(threading, name, value)
    setattr(threading.Thread, "start", _start_in_turn)
    setattr(threading.Thread, "join", _join_in_turn)
    setattr(queue, "time", _turns.seconds)
    setattr(queue, "SimpleQueue", getattr(queue, "_PySimpleQueue"))
    setattr(base_events.BaseEventLoop, "run_forever", _refuse_loop)
    logging.getLogger("canopen.network").addHandler(_Swallowed(logging.ERROR))


if is_active:
    _activate()
