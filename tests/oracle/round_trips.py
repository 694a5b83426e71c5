"""SDO round trips per second: canrig's client and drive beside python-canopen's client and LocalNode."""

import subprocess
import sys
import time

import canopen

from bench import DRIVE, DRIVE_EDS, Heard, arguments, check, eventually, network, node_process

SECONDS = 3
# In user-mode Linux system calls dominate both sides, and python-canopen's rate varies by a factor of five from run to
# run, so the ratio is shown and only being slower is a failure.
RATIO_MIN = 1.0


def serve(interface):
    """A LocalNode in this process until its standard input ends."""
    with network(interface) as bus:
        bus.add_node(canopen.LocalNode(DRIVE, DRIVE_EDS)).nmt.state = "INITIALISING"
        sys.stdin.read()


def python_rate(interface):
    command = [sys.executable, __file__, "--serve", interface]
    with network(interface) as bus:
        node = bus.add_node(canopen.RemoteNode(DRIVE, DRIVE_EDS))
        boot_up = Heard(bus, 0x700 + DRIVE)
        with subprocess.Popen(command, stdin=subprocess.PIPE) as server:
            eventually(lambda: boot_up.frames, "the LocalNode boots", 20)
            start, count = time.monotonic(), 0
            while time.monotonic() < start + SECONDS:
                node.sdo.upload(0x1000, 0)
                count += 1
            rate = count / (time.monotonic() - start)
            server.stdin.close()
            server.wait(10)
    return rate


def canrig_rate(given):
    with network(given.interface) as bus:
        boot_up = Heard(bus, 0x700 + DRIVE)
        with node_process(given.program, "plant-emulator", given.interface):
            eventually(lambda: boot_up.frames, "the drive boots", 20)
            bus.notifier.stop()  # python does not take part in what is measured
            command = [given.client, given.interface, str(DRIVE), str(SECONDS)]
            return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main():
    if sys.argv[1:2] == ["--serve"]:
        serve(sys.argv[2])
        return
    given = arguments(__doc__, client="the example sdo_round_trips")
    ours, theirs = canrig_rate(given), python_rate(given.interface)
    print(f"SDO uploads per second: canrig {ours:.0f}, python-canopen {theirs:.0f}, ratio {ours / theirs:.1f}", flush=True)
    check(ours > RATIO_MIN * theirs, "canrig is not slower than python-canopen", ours / theirs)


if __name__ == "__main__":
    main()
