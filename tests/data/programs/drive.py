"""A drive with a plant of its own: it answers SDO, follows the controlword, and measures at each SYNC.

The plant creeps towards 40 mm for each ampere, with a time constant of 50 ms."""

import os
import struct

import canrig_node as node

PART = node.part()
NODE, PERIOD = PART.node_id, PART.period_seconds
READS, WRITES = PART.loops[0].reads, PART.loops[0].writes
NMT, SYNC, HEARTBEAT, ASK, ANSWER = 0x000, 0x080, 0x700, 0x600, 0x580
# The low byte of the statusword and what the command of a controlword makes of it (CiA 402-2, tables 29 and 30).
DISABLED, READY, SWITCHED_ON, ENABLED = 0x50, 0x31, 0x33, 0x37
OBJECTS = {(0x1000, 0): 0x00020192, (0x1018, 1): 0x000002FE, (0x1018, 2): 0x00000077, (0x1018, 3): 0x00010000}
# By the command of a controlword: the state that it leads to, and those from which it does.
FOLLOWED = {
    0x06: (READY, (DISABLED, READY, SWITCHED_ON, ENABLED)),
    0x07: (SWITCHED_ON, (READY, SWITCHED_ON, ENABLED)),
    0x0F: (ENABLED, (SWITCHED_ON, ENABLED)),
}
# Where it is from 1 s on, for a test of the bench's watch over its limits.
JUMP = os.environ.get("DRIVE_JUMPS_TO_MILLIMETRES")


class Drive(node.Node):
    filters = [NMT, SYNC, WRITES.id, ASK + NODE, HEARTBEAT + 1]
    silent = [WRITES.id, HEARTBEAT + 1]

    def on_start(self):
        self.objects, self.state, self.millimetres = dict(OBJECTS), DISABLED, 0.0
        self.is_operational, self.command, self.cycles = False, (0, 0.0), 0
        self.send(HEARTBEAT + NODE, b"\0")
        self.every(0.05, "heartbeat")

    def on_time(self, name):
        self.send(HEARTBEAT + NODE, bytes([5 if self.is_operational else 127]))

    def on_frame(self, frame):
        if frame.id == NMT and frame.data[1] in (0, NODE):
            if frame.data[0] in (129, 130):
                self.send(HEARTBEAT + NODE, b"\0")
            self.is_operational, self.state = frame.data[0] == 1, DISABLED
        elif frame.id == ASK + NODE:
            self.send(ANSWER + NODE, self.answer(frame.data))
        elif frame.id == WRITES.id and self.is_operational:
            self.command = struct.unpack_from("<H", frame.data)[0], WRITES.decode(frame.data)["target_current_amperes"]
        elif frame.id == SYNC and self.is_operational:
            self.cycle()

    def answer(self, request):
        """To an expedited download or upload (CiA 301, 7.2.4.3)."""
        index, sub_index = struct.unpack_from("<HB", request, 1)
        if request[0] >> 5 == 1:
            self.objects[index, sub_index] = int.from_bytes(request[4:], "little")
            return struct.pack("<BHB4x", 0x60, index, sub_index)
        return struct.pack("<BHBI", 0x43, index, sub_index, self.objects.get((index, sub_index), 0))

    def cycle(self):
        controlword, amperes = self.command
        amperes = amperes if self.state == ENABLED else 0.0
        self.millimetres += PERIOD / 0.05 * (40.0 * amperes - self.millimetres)
        self.cycles += 1
        state, before = FOLLOWED.get(controlword & 0x8F, (DISABLED, (self.state,)))
        self.state = state if self.state in before else self.state
        is_beyond = JUMP is not None and self.cycles * PERIOD > 1.0
        position = float(JUMP) if is_beyond else self.millimetres
        data = bytearray(READS.encode(position_millimetres=position, current_amperes=amperes))
        data[0:2] = struct.pack("<H", self.state | 0x0200)
        self.send(READS.id, bytes(data))

    def on_stop(self):
        self.state = DISABLED


Drive.run()
