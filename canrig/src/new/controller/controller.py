"""A CANopen manager in Python with a PID, for a drive as canrig emulates it: it starts the drive, sends SYNC, and commands a current."""

import math
import struct

import canrig_node as node

OWN, NMT, SYNC, POSITION, COMMAND, SDO_ANSWER, SDO_ASK, HEARTBEAT = 0x01, 0x000, 0x080, 0x180, 0x200, 0x580, 0x600, 0x700
PART = node.part()
DRIVE, PERIOD = PART.loops[0].drive_id, PART.period_seconds
# An expedited SDO download each (CiA 301, 7.2.4.3.3): the drive stops when it has not heard us for 1 s, the period of SYNC in
# microseconds, cyclic synchronous torque.
OBJECTS = [
    struct.pack("<BHBI", 0x23, 0x1016, 1, OWN << 16 | 1000),
    struct.pack("<BHBI", 0x23, 0x1006, 0, round(1e6 * PERIOD)),
    struct.pack("<BHBI", 0x2F, 0x6060, 0, 10),
]


class Pid:
    """The derivative is on the measurement, in metres and amperes; the integral waits while the current is at its limit."""

    KP, KI, KD, WEIGHT, POLE = 64.8, 489.0, 3.74, 0.377, 500.0

    def __init__(self):
        self.integral, self.filtered = 0.0, None

    def __call__(self, wanted, position):
        self.filtered = position if self.filtered is None else self.filtered
        moved = (1.0 - math.exp(-self.POLE * PERIOD)) * (position - self.filtered)
        self.filtered += moved
        current = self.KP * (self.WEIGHT * wanted - position) + self.integral - self.KD * moved / PERIOD
        error = wanted - position
        low, high = PART.loops[0].command_range
        if not (current >= high and error > 0.0) and not (current <= low and error < 0.0):
            self.integral += self.KI * error * PERIOD
        return min(max(current, low), high)


def towards_enabled(statusword):
    """The controlword towards Operation enabled (CiA 402-2, table 30)."""
    if statusword & 0x4F == 0x40:
        return 0x06  # switch on disabled
    if statusword & 0x6F == 0x21:
        return 0x07  # ready to switch on
    return 0x80 if statusword & 0x4F == 0x08 else 0x0F


class Controller(node.Node):
    filters = [POSITION + DRIVE, SDO_ANSWER + DRIVE, HEARTBEAT + DRIVE]
    silent = [HEARTBEAT + DRIVE]

    def on_start(self):
        self.pid, self.is_up, self.is_enabled, self.step = Pid(), False, False, 0
        self.sync_at = self.zero = None  # of the scenario: the first SYNC after the drive reported Operation enabled
        self.every(0.02, "heartbeat")
        self.at(self.now, "look")
        self.reset_at = self.now

    def on_time(self, name):
        if name == "heartbeat":
            self.send(HEARTBEAT + OWN, bytes([5]))
        elif name == "sync":
            self.sync_at = self.bus.now_ns
            if self.is_enabled and self.zero is None:
                self.zero = self.sync_at
            self.send(SYNC)
        elif self.step > len(OBJECTS):
            self.every(PERIOD, "sync")
        else:
            self.look()

    def look(self):
        """Looks for the drive's boot-up, and asks for it."""
        self.at(self.now + 0.01, "look")
        if self.is_up and self.step == 0:
            self.bring_up()
        elif not self.is_up and self.now >= self.reset_at:
            self.send(NMT, bytes([130, DRIVE]))
            self.reset_at = self.now + 0.5

    def bring_up(self):
        """One thing after the other, each as the answer to the one before comes."""
        if self.step < len(OBJECTS):
            self.send(SDO_ASK + DRIVE, OBJECTS[self.step])
        else:
            self.send(NMT, bytes([1, 0]))
        self.step += 1

    def on_frame(self, frame):
        if frame.id == HEARTBEAT + DRIVE:
            self.is_up = self.is_up or frame.data == b"\0"
        elif frame.id == SDO_ANSWER + DRIVE:
            if frame.data[0] == 0x60 and self.step <= len(OBJECTS):
                self.bring_up()
        else:
            statusword, micrometres = struct.unpack_from("<Hi", frame.data)
            self.is_enabled, current = statusword & 0x6F == 0x27, 0.0
            if self.is_enabled and self.zero is not None:
                wanted = PART.loops[0].set_point((self.sync_at - self.zero) / 1e9)
                current = self.pid(1e-3 * wanted, 1e-6 * micrometres)
            self.command(towards_enabled(statusword), current)

    def command(self, controlword, amperes):
        self.send(COMMAND + DRIVE, struct.pack("<Hh", controlword, round(1000 * amperes)))

    def on_stop(self):
        self.command(0x06, 0.0)  # shutdown: no current


Controller.run()
