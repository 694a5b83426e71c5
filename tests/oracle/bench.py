"""Parts of all oracle scripts: their arguments, their checks, and canrig's nodes as processes."""

import argparse
import contextlib
import pathlib
import subprocess
import sys
import threading
import time

import canopen

ROOT = pathlib.Path(__file__).resolve().parents[2]
DRIVE_EDS = str(ROOT / "dbc" / "drive.eds")
DISTURBANCE_EDS = str(ROOT / "dbc" / "disturbance.eds")
STEP = ROOT / "scenarios" / "step.toml"
CONTROLLER, DRIVE, DISTURBANCE = 0x01, 0x10, 0x11

canopen.sdo.SdoClient.RESPONSE_TIMEOUT = 3.0  # a busy machine may not run the other side for a while


def arguments(description, **more):
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("program", help="the program under test")
    parser.add_argument("interface", help="a CAN interface that is up, such as vcan0")
    for name, text in more.items():
        parser.add_argument(name, help=text)
    return parser.parse_args()


def check(condition, text, found=""):
    """Ends the script with an error unless the condition holds."""
    if not condition:
        print(f"FAILED  {text}: {found}", flush=True)
        sys.exit(1)


def done(text):
    print(f"ok  {text}", flush=True)


def eventually(condition, text, patience_seconds=5.0):
    end = time.monotonic() + patience_seconds
    while not condition():
        if time.monotonic() > end:
            check(False, text() if callable(text) else text, f"not within {patience_seconds} s")
        time.sleep(0.005)


def aborts_with(code, action, text):
    """The action must be refused by the server with this abort code."""
    try:
        action()
    except canopen.SdoAbortedError as error:
        check(error.code == code, text, f"{error} instead of 0x{code:08X}")
        return
    check(False, text, f"was not refused (expected 0x{code:08X})")


@contextlib.contextmanager
def network(interface):
    with canopen.Network() as bus:
        bus.connect(interface="socketcan", channel=interface)
        yield bus


@contextlib.contextmanager
def node_process(program, role, interface, scenario=STEP, more=()):
    """One of canrig's nodes; closing its standard input asks it to stop."""
    command = [program, "node", role, "--bus", interface, "--scenario", str(scenario), *more]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.stdin.close()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def restart(bus, node, command):
    """Resets a node and waits for its boot-up (python-canopen's own waiting may begin after the boot-up came)."""
    heard = Heard(bus, 0x700 + node.id)
    node.nmt.state = command
    eventually(lambda: any(data == b"\0" for _, data in heard.frames), f"node {node.id} boots after {command}")


class Heard:
    """Counts and keeps the frames of one identifier."""

    def __init__(self, bus, can_id):
        self.frames = []
        self._lock = threading.Lock()
        bus.subscribe(can_id, self._take)

    def _take(self, _can_id, data, timestamp):
        with self._lock:
            self.frames.append((timestamp, bytes(data)))

    def clear(self):
        with self._lock:
            self.frames.clear()

    def intervals(self, count):
        """The seconds between the next `count` frames."""
        self.clear()
        eventually(lambda: len(self.frames) > count, f"{count} frames", 30)
        with self._lock:
            stamps = [stamp for stamp, _ in self.frames]
        return [after - before for before, after in zip(stamps, stamps[1:])]
