"""Turns of threads in virtual time: one thread runs, and time passes when all of them wait.

A wait is a condition and a time. The thread that waits last lets the bus go on to the earliest of the times, or to a frame. The next
thread follows from the order alone in which they began to wait, so each play of a program is the same.
"""

from __future__ import annotations

import _thread
import math
import threading
from typing import Callable, List, Optional

#: A time that never comes, in nanoseconds.
NEVER = 0xFFFFFFFFFFFFFFFF
SECOND = 1_000_000_000
#: Readings of the clocks between two waits; each further one takes a microsecond, so that a loop that looks at a clock comes to its end.
READINGS_MAX = 100
READING_NS = 1000


class Clock:
    """A bus whose time is that of the program."""

    #: The time in nanoseconds.
    now_ns: int
    #: canrig has asked for the end.
    is_stopping: bool

    def pass_ns(self, until: int) -> None:
        """Lets time pass until a frame arrives, but not beyond a time."""
        raise NotImplementedError


class Turn:
    """A thread that takes turns."""

    def __init__(self) -> None:
        #: Held while another thread runs.
        self.lock = _thread.allocate_lock()
        self.lock.acquire()
        self.is_over = False
        self.is_ready: Callable[[], bool] = bool
        self.until = NEVER
        self.result = False


_first = _running = Turn()
_ident = _thread.get_ident()
_waiting: List[Turn] = []
_clock: Optional[Clock] = None
_is_joined = _is_told = False
#: The time when there is no bus, or no longer.
_now = 0
_failure: Optional[BaseException] = None
_readings = 0
_is_passing = False
#: What clocks in seconds are ahead at a time: see `deadline`.
_ahead = 0.0
_ahead_at = 0


def join(clock: Clock) -> None:
    """Takes the time from a bus, which the calling thread has opened."""
    global _clock, _ident, _is_joined
    _clock, _ident, _is_joined = clock, _thread.get_ident(), True


def leave(clock: Clock) -> None:
    """Stops taking the time from the bus; from then on it passes by itself."""
    global _clock, _now
    if _clock is clock:
        _now, _clock = clock.now_ns, None


def now_ns() -> int:
    """The time in nanoseconds, 0 before the first bus is open."""
    return _now if _clock is None else _clock.now_ns


def read_ns() -> int:
    """A reading of the program's clock, in nanoseconds."""
    global _readings
    if _clock is not None and _thread.get_ident() == _ident and not _is_passing:
        if _readings == READINGS_MAX:
            wait(bool, _clock.now_ns + READING_NS)
            _readings = READINGS_MAX
        else:
            _readings += 1
    return now_ns()


def seconds() -> float:
    """A reading of the program's clock, in seconds."""
    now = read_ns()
    return now / SECOND + (_ahead if now == _ahead_at else 0.0)


def deadline(timeout: float) -> int:
    """The time in nanoseconds at which a time-out in seconds is over.

    A loop that waits until a time in floats waits once more for the rounding error of their sums, some 1e-16 s. No time passes in
    such a wait; it puts the clock ahead by the error, so that the loop ends.
    """
    global _ahead, _ahead_at
    now = now_ns()
    left = round(timeout * SECOND)
    if left == 0 < timeout:
        _ahead = (_ahead if now == _ahead_at else 0.0) + 4 * math.ulp(now / SECOND)
        _ahead_at = now
    return min(now + max(0, left), NEVER)


def refuse_others() -> None:
    """Raises `RuntimeError` in a thread that takes no turns."""
    if _thread.get_ident() != _ident:
        name = threading.current_thread().name
        raise RuntimeError(
            f"the thread `{name}` cannot use the bus: in virtual time only the one that opened it can; "
            "for a can.Notifier, make `import canrig.virtual` the first line of the program"
        )


def wait(is_ready: Callable[[], bool], until: int) -> bool:
    """Waits for a condition or a time; true if it was the condition.

    Raises, in the first thread, `SystemExit` when canrig asks for the end, and the errors of the bus.
    """
    global _readings
    refuse_others()
    me = _running
    if _failure is None and is_ready():
        return True
    if until > now_ns():
        _readings = 0
    elif _clock is not None:
        # It asks for what has arrived by now.
        _pass(now_ns())
    me.is_ready, me.until, me.result = is_ready, until, False
    _waiting.append(me)
    _pass_on(me)
    if me is _first:
        _tell()
    return me.result


def begin(thread: threading.Thread, start: Callable[[threading.Thread], None]) -> Turn:
    """Starts a thread, which runs when another one waits."""
    turn, run = Turn(), thread.run
    turn.is_ready = lambda: True

    def run_in_turn() -> None:
        global _ident
        turn.lock.acquire()
        _ident = _thread.get_ident()
        try:
            run()
        except SystemExit:
            pass
        except BaseException as error:
            fail(error)
        finally:
            turn.is_over = True
            _pass_on(turn)

    thread.run = run_in_turn  # type: ignore[method-assign]
    _waiting.append(turn)
    start(thread)
    return turn


def fail(error: BaseException) -> None:
    """Raises an error of another thread, or of a listener, in the wait of the program, which is its end."""
    global _failure
    _failure = _failure or error


def _pass_on(me: Turn) -> None:
    """Lets the next thread run, and returns when it is this one's turn, or at its end."""
    global _running, _ident
    following = _next()
    _waiting.remove(following)
    if following is not me:
        ident = _ident
        _running = following
        following.lock.release()
        if not me.is_over:
            me.lock.acquire()
            _ident = ident


def _next() -> Turn:
    """The thread that can go on first; lets time pass until there is one."""
    while True:
        if _first in _waiting and (_failure is not None or _has_news()):
            return _first
        for turn in _waiting:
            if turn.is_ready():
                turn.result = True
                return turn
            if turn.until <= now_ns():
                return turn
        _pass(min(turn.until for turn in _waiting))


def _pass(until: int) -> None:
    global _failure, _is_passing
    _is_passing = True
    try:
        _go_on(until)
    except Exception as error:
        _failure = error
    finally:
        _is_passing = False


def _go_on(until: int) -> None:
    global _now
    if _clock is not None:
        _clock.pass_ns(until)
    elif not _is_joined:
        raise RuntimeError("no bus is open yet: in virtual time a program can wait when it has opened its bus")
    elif until == NEVER:
        raise RuntimeError("the program waits without a time-out, and its bus is shut down")
    else:
        _now = until


def _has_news() -> bool:
    return _clock is not None and _clock.is_stopping and not _is_told


def _tell() -> None:
    global _is_told, _failure
    if _failure is not None:
        error, _failure = _failure, None
        raise error
    if _has_news():
        _is_told = True
        raise SystemExit(0)
