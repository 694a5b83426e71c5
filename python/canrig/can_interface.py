"""The interface `canrig` of python-can: the bus of a run, in virtual and in real time.

.. code-block:: python

    import can

    with can.Bus(interface="canrig") as bus:
        bus.send(can.Message(arbitration_id=0x000, data=[1, 0], is_extended_id=False))
        for message in bus:
            print(message)
"""

from __future__ import annotations

import atexit
import logging
import os
import select
import signal
import struct
import sys
import threading
import time
from collections import deque
from types import FrameType
from typing import Any, Callable, Deque, Dict, Iterable, List, Optional, Sequence, Tuple, Union

import can
from can.broadcastmanager import LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC

from . import _turns
from .node import _ERRORS, _KERNEL_FRAME, ADDRESS, ERROR, EXTENDED, LIFELINE, REMOTE, Ended, Frame, _is_open, _RealBus, _VirtualBus, described

__all__ = ["CanrigBus"]

#: Filters that a bus takes.
FILTERS_MAX = 512
#: Frames that may wait for the program in virtual time; further ones are dropped.
INBOX_FRAMES_MAX = 100_000

_STANDARD_ID, _EXTENDED_ID = 0x7FF, 0x1FFFFFFF
_LOG = logging.getLogger("can.canrig")

Filter = Tuple[int, int]


class _Seat(_VirtualBus):
    """The bus of virtual time, for all threads that take turns."""

    def _refuse_threads(self) -> None:
        _turns.refuse_others()


class CanrigBus(can.BusABC, _turns.Clock):
    """A bus of canrig.

    `channel` is an address: `lockstep:/path` in virtual time, `embedded:/path`, or a SocketCAN interface; without it the one in
    `CANRIG_BUS`. `can_filters` are the frames that arrive; later ones of `set_filters` can only select from these. `bitrate` is compared
    with that of the bus in virtual time; in real time it is ignored, as settings of other interfaces are. In virtual time a timestamp is
    the time of the bus in seconds, else Unix time.

    Raises `can.CanInitializationError` if there is no bus, or it cannot do as asked.

    When canrig asks for the end, `SystemExit` is raised in the main thread, once. Frames that a `finally` then sends are still sent.
    """

    def __init__(
        self,
        channel: Optional[str] = None,
        can_filters: Any = None,
        bitrate: Optional[int] = None,
        receive_own_messages: bool = False,
        fd: bool = False,
        **_ignored: object,
    ) -> None:
        address = str(channel or os.environ.get(ADDRESS, ""))
        if not address:
            raise can.CanInitializationError(
                f"no bus is named: canrig starts this program, or give an address as the channel or in {ADDRESS}, as in embedded:/path"
            )
        if fd:
            raise can.CanInitializationError("the bus has classic CAN, not CAN FD")
        if receive_own_messages:
            raise can.CanInitializationError("a program does not receive its own messages: receive_own_messages cannot be true")
        self.channel_info = f"canrig {address}"
        self._declared: List[Filter] = _pairs(can_filters) or [(0, 0)]
        self._inbox: Deque[can.Message] = deque()
        self._tasks: List[_CyclicTask] = []
        self._dropped = 0
        self._virtual: Optional[_Seat] = None
        self._real: Optional[_RealBus] = None
        world, _, path = address.partition(":")
        try:
            if world == "lockstep":
                self._virtual = _Seat(path, os.environ.get("CANRIG_NODE", ""), self._declared, [], errors=True)
            else:
                self._real = _RealBus(address, [*self._declared, _ERRORS])
        except (OSError, RuntimeError, Ended) as error:
            why = f"there is no bus at {address}: {error}"
            raise can.CanInitializationError(f"{why}; a program has one bus in virtual time" if world == "lockstep" else why) from error
        if self._virtual is not None:
            rate = self._virtual.bits_per_second
            if bitrate is not None and bitrate != rate:
                self._virtual.close()
                raise can.CanInitializationError(f"the bus has {rate} bit/s, not {bitrate}")
            _turns.join(self)
            atexit.register(self._abandon)
        else:
            _end_with_canrig()
        super().__init__(channel=address, can_filters=can_filters)

    @property
    def now_ns(self) -> int:  # type: ignore[override]
        """The time of the bus in nanoseconds, in virtual time."""
        return self._seat.now_ns

    @property
    def is_stopping(self) -> bool:  # type: ignore[override]
        """Whether canrig has asked for the end, in virtual time."""
        return self._seat.is_stopping

    @property
    def _seat(self) -> _Seat:
        assert self._virtual is not None, "in virtual time alone"
        return self._virtual

    def recv(self, timeout: Optional[float] = None) -> Optional[can.Message]:
        """Waits for a message: at most `timeout` seconds, without it as long as it takes. Returns `None` if none came.

        Raises `can.CanOperationError` when canrig or the bus is gone, and `SystemExit` when canrig asks for the end.
        """
        self._refuse_shut_down()
        if self._virtual is None:
            return super().recv(timeout)
        until = _turns.NEVER if timeout is None else _turns.deadline(timeout)
        _turns.wait(lambda: bool(self._inbox), until)
        return self._inbox.popleft() if self._inbox else None

    def pass_ns(self, until: int) -> None:
        """Lets virtual time pass until a frame arrives, but not beyond a time, and sends the frames that are due."""
        try:
            frame = self._seat.wait_ns(min([until, *(task.due for task in self._tasks)]))
        except Ended as error:
            raise can.CanOperationError(str(error)) from None
        if frame is not None:
            self._take(_message(frame, frame.time))
        else:
            for task in [task for task in self._tasks if task.due <= self.now_ns]:
                task.send()

    def _take(self, message: can.Message) -> None:
        if not self._accepts(message):
            return
        if len(self._inbox) < INBOX_FRAMES_MAX:
            self._inbox.append(message)
        elif not self._dropped:
            self._dropped = 1
            _LOG.warning("%d frames wait for recv(), and further ones are dropped: open the bus with can_filters", INBOX_FRAMES_MAX)

    def _accepts(self, message: can.Message) -> bool:
        return message.is_error_frame or self._matches_filters(message)

    def _recv_internal(self, timeout: Optional[float]) -> Tuple[Optional[can.Message], bool]:
        assert self._real is not None
        channel = self._real._channel
        try:
            if not select.select([channel], [], [], timeout)[0]:
                return None, False
            packet = channel.recv(_KERNEL_FRAME.size)
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"the bus is gone: {error}") from error
        if not packet:
            raise can.CanOperationError("the bus is gone")
        if len(packet) != _KERNEL_FRAME.size:
            # The embedded bus says how many frames this program was too slow for.
            _LOG.warning("%d frames were dropped", *struct.unpack_from("=Q", packet))
            return None, False
        identifier, length, data = _KERNEL_FRAME.unpack(packet)
        message = _message(Frame(0.0, identifier, data[:length]), time.time())
        return (message, True) if self._accepts(message) else (None, False)

    def send(self, msg: can.Message, timeout: Optional[float] = None) -> None:
        """Queues a message; it never waits.

        Raises `can.CanOperationError` when too many wait to be sent or the bus is gone, and for CAN FD and error frames.
        """
        self._refuse_shut_down()
        if msg.is_fd:
            raise can.CanOperationError(f"the bus has classic CAN, not CAN FD: {msg}")
        if msg.is_error_frame:
            raise can.CanOperationError(f"an error frame cannot be sent: {msg}")
        flags = (EXTENDED if msg.is_extended_id else 0) | (REMOTE if msg.is_remote_frame else 0)
        data = bytes(msg.dlc) if msg.is_remote_frame else bytes(msg.data)
        try:
            (self._virtual or self._real).send(msg.arbitration_id | flags, data)  # type: ignore[union-attr]
        except (BufferError, OSError, ValueError) as error:
            raise can.CanOperationError(f"{msg} is not sent: {error}") from error

    def _send_periodic_internal(
        self,
        msgs: Union[Sequence[can.Message], can.Message],
        period: float,
        duration: Optional[float] = None,
        autostart: bool = True,
        modifier_callback: Optional[Callable[[can.Message], None]] = None,
    ) -> can.broadcastmanager.CyclicSendTaskABC:
        if self._virtual is None:
            return super()._send_periodic_internal(msgs, period, duration, autostart, modifier_callback)
        return _CyclicTask(self, self._tasks, msgs, period, duration, autostart, modifier_callback)

    def _apply_filters(self, filters: Any) -> None:
        for identifier, mask in _pairs(filters) or [(0, 0)]:
            if not any(mask & wide == wide and (identifier ^ wanted) & wide == 0 for wanted, wide in self._declared):
                raise can.CanOperationError(
                    f"frames {identifier & _EXTENDED_ID:X} with the mask {mask & _EXTENDED_ID:X} do not arrive: "
                    "open the bus with them in can_filters, or without can_filters"
                )

    def fileno(self) -> int:
        """The socket, in real time. Raises `NotImplementedError` in virtual time, which passes in waits alone."""
        if self._real is None:
            raise NotImplementedError("there is no socket to wait for in virtual time")
        return self._real._channel.fileno()

    def shutdown(self) -> None:
        """Leaves the bus; frames that wait are sent first. In virtual time a pending error ends the run, which names it."""
        if self._is_shutdown:
            return
        super().shutdown()
        error = sys.exc_info()[1]
        if self._virtual is None:
            if self._real is not None:
                self._real.close()
            return
        atexit.unregister(self._abandon)
        if isinstance(error, Exception) and not self.is_stopping:
            self._virtual.fail(described(error, __file__, _turns.__file__))
        else:
            self._virtual.close()
        _turns.leave(self)

    def _abandon(self) -> None:
        """Leaves the bus at the end of the program: in order if canrig has asked for it, else silently, and canrig reports it."""
        if self.is_stopping:
            self.shutdown()
        else:
            self._is_shutdown = True

    def _refuse_shut_down(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError("the bus is shut down")


class _CyclicTask(LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC):
    """Messages that are sent one after the other, the first at once and the next after each period, while virtual time passes."""

    def __init__(
        self,
        bus: CanrigBus,
        tasks: List["_CyclicTask"],
        messages: Union[Sequence[can.Message], can.Message],
        period: float,
        duration: Optional[float],
        autostart: bool,
        modifier_callback: Optional[Callable[[can.Message], None]],
    ) -> None:
        super().__init__(messages, period, duration)
        if self.period_ns < 1:
            raise ValueError(f"a period is at least 1 ns, not {period} s")
        self._bus, self._tasks, self._modify = bus, tasks, modifier_callback
        self._number = 0
        self._end = _turns.NEVER
        #: When the next message is sent, in nanoseconds.
        self.due = _turns.NEVER
        if autostart:
            self.start()

    def start(self) -> None:
        if self in self._tasks:
            return
        self.due = self._bus.now_ns
        self._end = self.due + round(self.duration * _turns.SECOND) if self.duration else _turns.NEVER
        self._tasks.append(self)
        self.send()

    def send(self) -> None:
        """Sends a message, and has the next one due after a period, unless the duration is over."""
        if self.due >= self._end:
            self.stop()
            return
        message = self.messages[self._number % len(self.messages)]
        self._number += 1
        self.due += self.period_ns
        if self._modify is not None:
            self._modify(message)
        self._bus.send(message)

    def stop(self) -> None:
        if self in self._tasks:
            self._tasks.remove(self)


def _pairs(filters: Optional[Iterable[Dict[str, Any]]]) -> List[Filter]:
    """Filters in the form of the kernel."""
    pairs: List[Filter] = []
    for one in filters or ():
        identifier, mask = one["can_id"], one["can_mask"]
        if "extended" in one:
            mask |= EXTENDED
            identifier |= EXTENDED if one["extended"] else 0
        pairs.append((identifier & ~ERROR, mask & ~ERROR))
    if len(pairs) > FILTERS_MAX:
        raise can.CanInitializationError(f"{len(pairs)} filters are too many: a bus has at most {FILTERS_MAX}")
    return pairs


def _message(frame: Frame, timestamp: float) -> can.Message:
    is_remote, is_error = bool(frame.id & REMOTE), bool(frame.id & ERROR)
    is_extended = bool(frame.id & EXTENDED)
    return can.Message(
        timestamp=timestamp,
        arbitration_id=frame.id & (_EXTENDED_ID if is_extended or is_error else _STANDARD_ID),
        is_extended_id=is_extended,
        is_remote_frame=is_remote,
        is_error_frame=is_error,
        dlc=len(frame.data),
        data=None if is_remote else frame.data,
    )


def _end_with_canrig() -> None:
    """Ends the program in real time as in virtual time, by a `SystemExit` in the main thread when canrig asks for the end."""
    lifeline = os.environ.get(LIFELINE)
    is_ours = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if lifeline is None or not _is_open(int(lifeline)) or not is_ours:
        return

    def end(_number: int, _frame: Optional[FrameType]) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise SystemExit(0)

    main = threading.get_ident()

    def watch() -> None:
        while os.read(int(lifeline), 8):
            pass
        signal.pthread_kill(main, signal.SIGTERM)

    signal.signal(signal.SIGTERM, end)
    threading.Thread(target=watch, name="canrig: the end of the run", daemon=True).start()
