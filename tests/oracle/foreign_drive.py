"""A drive that is not ours, a LocalNode of python-canopen, under canrig's controller, on a real CAN interface."""

import contextlib
import logging
import pathlib
import struct
import subprocess
import tempfile

import canopen

from bench import DRIVE, DRIVE_EDS, Heard, arguments, check, done, eventually, network, node_process

CURRENT_PERMILLE = 300
# Python in user-mode Linux on a busy machine does not keep up with a SYNC each millisecond.
SCENARIO = """\
schema = 1
rig = "sma_actuator"
name = "foreign drive"
duration_seconds = 60.0

[bus]
sync_period_milliseconds = 50.0

[[controller.open_loop.step]]
at_seconds = 0.1
current_amperes = 0.3
"""

# Statuswords (CiA 402-2, table 30) with voltage enabled and remote.
SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED = 0x0250, 0x0231, 0x0233, 0x0237


class ForeignDrive:
    """Obeys NMT, PDOs and the power state machine; its load stays where it is."""

    def __init__(self, bus):
        self.node = bus.add_node(canopen.LocalNode(DRIVE, DRIVE_EDS))
        self.statusword = SWITCH_ON_DISABLED
        self.target = 0
        self.written = {}
        self.is_silent = False
        self.node.add_write_callback(self._written)
        bus.subscribe(0x000, self._on_nmt)
        bus.subscribe(0x080, self._on_sync)

    def boot(self):
        self.node.nmt.state = "INITIALISING"  # sends the boot-up
        self.node.nmt.state = "PRE-OPERATIONAL"

    def _written(self, index, subindex, od, data):
        self.written[index, subindex] = bytes(data)

    def _on_nmt(self, _can_id, data, _timestamp):
        command, node = data
        if node not in (0, DRIVE):
            return
        if command in (129, 130):
            self.boot()
        elif command == 1:
            for pdo in (self.node.tpdo[1], self.node.rpdo[1]):
                pdo.read()
            self.node.rpdo[1].callbacks = [self._on_command]

    def _on_command(self, rpdo):
        controlword, self.target = rpdo[0x6040].raw, rpdo[0x6071].raw
        if controlword & 0x86 == 0x06 and controlword & 0x01 == 0:
            self.statusword = READY
        elif controlword & 0x8F == 0x07 and self.statusword != SWITCH_ON_DISABLED:
            self.statusword = SWITCHED_ON
        elif controlword & 0x8F == 0x0F and self.statusword in (SWITCHED_ON, ENABLED):
            self.statusword = ENABLED
        elif controlword & 0x06 != 0x06:
            self.statusword = SWITCH_ON_DISABLED

    def _on_sync(self, _can_id, _data, _timestamp):
        if self.node.nmt.state != "OPERATIONAL" or self.is_silent:
            return
        tpdo = self.node.tpdo[1]
        tpdo[0x6041].raw = self.statusword
        tpdo[0x6064].raw = 9500
        tpdo[0x6078].raw = self.target
        tpdo.transmit()

    def leave(self, bus):
        self.node.nmt.stop_heartbeat()
        self.is_silent = True
        bus.unsubscribe(0x000, self._on_nmt)
        bus.unsubscribe(0x080, self._on_sync)
        del bus.nodes[DRIVE]
        self.node.remove_network()


@contextlib.contextmanager
def controlled(given, bus, scenario):
    """A foreign drive and our controller."""
    drive = ForeignDrive(bus)
    try:
        with node_process(given.program, "controller", given.interface, scenario) as controller:
            yield drive, controller
    finally:
        drive.leave(bus)


def ends(controller, text):
    """The controller must end by itself with exit code 1 and a message that contains the text."""
    controller.wait(20)  # its standard input stays open: it is not asked to stop
    message = controller.stderr.read()
    check(controller.returncode == 1, "exit code of the controller", controller.returncode)
    check(text in message, f"the message says \"{text}\"", message)
    return message.strip()


def led(drive, controller):
    """Waits until the law has run for a while."""
    is_led = lambda: drive.statusword == ENABLED and drive.target == CURRENT_PERMILLE  # noqa: E731
    eventually(lambda: is_led() or controller.poll() is not None, "the law's command arrives", 20)
    check(is_led(), "the controller leads the drive", controller.poll() and controller.stderr.read())


def brought_up(given, bus, scenario):
    """The controller configures the drive, starts it and leads it to operation enabled; its end is orderly"""
    with controlled(given, bus, scenario) as (drive, controller):
        # As if its last owner had mapped something else.
        drive.node.set_data(0x1A00, 0, b"\1")
        drive.boot()
        led(drive, controller)
        check(drive.written[0x1016, 1] == struct.pack("<L", 0x00010064), "consumer heartbeat time")
        check(drive.written[0x1017, 0] == struct.pack("<H", 20), "producer heartbeat time")
        check(drive.written[0x6060, 0] == b"\x0A", "cyclic synchronous torque")
        check(drive.written[0x1006, 0] == struct.pack("<L", 50000), "SYNC period")
        check(drive.written[0x1A00, 0] == b"\3", "the PDO that differed is mapped anew")
        check((0x1600, 0) not in drive.written, "the PDO that did not differ is left alone")
        orders = Heard(bus, 0x000)
        controller.stdin.close()
        check(controller.wait(10) == 0, "orderly end", controller.returncode)
        eventually(lambda: drive.statusword == SWITCH_ON_DISABLED and drive.target == 0, "no current at the end")
        eventually(lambda: bytes([2, DRIVE]) in [data for _, data in orders.frames], "NMT stop")


def lost_heartbeat(given, bus, scenario):
    """The drive vanishes"""
    with controlled(given, bus, scenario) as (drive, controller):
        drive.boot()
        led(drive, controller)
        commands = Heard(bus, 0x210)
        drive.node.nmt.stop_heartbeat()
        drive.is_silent = True
        message = ends(controller, "heartbeat from the drive (node 16) missing for")
        eventually(lambda: commands.frames[-1][1][2:] == b"\0\0", "the last command is no current")
        return message


def lost_positions(given, bus, scenario):
    """The drive sends heartbeats, but no positions any more"""
    with controlled(given, bus, scenario) as (drive, controller):
        drive.boot()
        led(drive, controller)
        drive.is_silent = True
        return ends(controller, "no position from the drive (node 16, frame 0x190) in 21 cycles (limit 20)")


def emergency(given, bus, scenario):
    """The drive reports an emergency"""
    with controlled(given, bus, scenario) as (drive, controller):
        drive.boot()
        led(drive, controller)
        drive.node.emcy.send(0x2310, 0x03)
        return ends(controller, "the drive (node 16) reports emergency 0x2310, error register 0x03")


def refused_write(given, bus, scenario):
    """The drive refuses a mode: object, value and abort are reported"""
    def refuse(index, subindex, od, data):
        if index == 0x6060:
            raise canopen.SdoAbortedError(0x06090030)

    with controlled(given, bus, scenario) as (drive, controller):
        drive.node.add_write_callback(refuse)
        drive.boot()
        return ends(controller, "the drive did not accept 10 for Modes of operation: object 0x6060:00 of node 0x10: "
                                "abort 0x0609_0030")


def other_product(given, bus, scenario):
    """The node is another product"""
    with controlled(given, bus, scenario) as (drive, controller):
        drive.node.set_data(0x1018, 2, struct.pack("<L", 7))
        drive.boot()
        return ends(controller, "Product code (0x1018:02) is 0x00000007 instead of 0x00000001")


def guests(given, bus, _scenario):
    """canrig's tools find the drive, and read and write its objects, though it has no second SDO channel"""
    def tool(*arguments):
        command = [given.program, *arguments, "--bus", given.interface]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
        check(ended.returncode == 0, " ".join(command), ended.stderr)
        return ended.stdout

    drive = ForeignDrive(bus)
    try:
        drive.node.set_data(0x1017, 0, bytes(2))  # without a heartbeat it is found by its answers only
        drive.boot()
        listed = tool("nodes")
        check("16 (0x10)" in listed and "no heartbeat" in listed and "drive.eds" in listed, "canrig nodes", listed)
        read = tool("sdo", "read", "drive", "Manufacturer device name")
        check('= "SMA wire drive"' in read, "canrig sdo read", read)
        written = tool("sdo", "write", "16", "Target torque", "250")
        check(written.startswith("0x6071:00  Target torque (INTEGER16) = 250  written"), "canrig sdo write", written)
        check(drive.written[0x6071, 0] == struct.pack("<h", 250), "the value arrived", drive.written)
    finally:
        drive.leave(bus)


def main():
    given = arguments(__doc__)
    logging.disable(logging.ERROR)
    with tempfile.TemporaryDirectory() as folder, network(given.interface) as bus:
        scenario = pathlib.Path(folder) / "foreign_drive.toml"
        scenario.write_text(SCENARIO)
        for test in (brought_up, lost_heartbeat, lost_positions, emergency, refused_write, other_product, guests):
            message = test(given, bus, scenario)
            done(f"{test.__name__}: {test.__doc__}" + (f" -> \"{message}\"" if message else ""))
    print("python-canopen as foreign drive: all passed", flush=True)


if __name__ == "__main__":
    main()
