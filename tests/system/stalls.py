"""Tests in real time on a machine that others use."""

import os
import re
import threading
import time

# Both as in tests/real_time.rs.
STALL_SECONDS = 0.015
ATTEMPTS = 10
# What canrig says of a run that a busy machine spoiled. It sees stalls that are none of this process, as in a kernel of its own.
SPOILED = re.compile("stalls cover|too busy for real time")


def while_time_flows(action):
    """Calls the action, and calls it again if it fails while the machine stood still, or beside stalls that canrig noted: that shows
    nothing."""
    for left in reversed(range(ATTEMPTS)):
        stalls, is_over = dict.fromkeys(os.sched_getaffinity(0), 0.0), threading.Event()
        watches = [threading.Thread(target=watch, args=(processor, is_over, stalls)) for processor in stalls]
        for thread in watches:
            thread.start()
        try:
            return action()
        except AssertionError as error:
            failure = error
        finally:
            is_over.set()
            for thread in watches:
                thread.join()
        stall = max(stalls.values())
        is_spoiled = stall >= STALL_SECONDS or SPOILED.search(str(failure))
        if not is_spoiled or left == 0:
            raise failure
        print(f"failed, but the machine was busy (longest stall {1e3 * stall:.0f} ms): once more", flush=True)


def watch(processor, is_over, stalls):
    """Measures for how long this processor did not run a thread that only sleeps."""
    os.sched_setaffinity(0, {processor})
    while not is_over.is_set():
        before = time.monotonic()
        time.sleep(0.002)
        stalls[processor] = max(stalls[processor], time.monotonic() - before)
