"""A CANopen drive at a bus seat: the objects of an EDS, SDO, NMT, heartbeats, PDOs as they are
mapped, and the power states of CiA 402. A class made from it adds the motion."""

import configparser
import os
import pathlib
import struct
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "python" / "canrig"))
import node  # noqa: E402

NMT, SYNC, HEARTBEAT, ASK, ANSWER = 0x000, 0x080, 0x700, 0x600, 0x580
BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
# The low byte of the statusword by power state (CiA 402-2, table 30).
SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED = 0x50, 0x31, 0x33, 0x37
REMOTE = 0x0200
# Mask and value of a controlword, the state it leads to, and the states from which it does
# (table 29).
TRANSITIONS = [
    (0x8F, 0x0F, ENABLED, (SWITCHED_ON, ENABLED)),
    (0x8F, 0x0F, SWITCHED_ON, (READY,)),
    (0x8F, 0x07, SWITCHED_ON, (READY, SWITCHED_ON, ENABLED)),
    (0x87, 0x06, READY, (SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED)),
    (0x86, 0x02, SWITCH_ON_DISABLED, (READY, SWITCHED_ON, ENABLED)),
    (0x82, 0x00, SWITCH_ON_DISABLED, (READY, SWITCHED_ON, ENABLED)),
]
# Formats by the data types of CiA 301.
FORMATS = {0x1: "B", 0x2: "b", 0x3: "h", 0x4: "i", 0x5: "B", 0x6: "H", 0x7: "I"}
NO_OBJECT, READ_ONLY, WRONG_LENGTH, NO_SUB_INDEX = 0x06020000, 0x06010002, 0x06070010, 0x06090011
PDO_OF_NOBODY = 1 << 31
NODE = int(os.environ["CANRIG_NODE_ID"])
MANAGER = 1


class Objects:
    """The object dictionary of an EDS, with its default values."""

    def __init__(self, path):
        sheet = configparser.ConfigParser(interpolation=None)
        sheet.read(path)
        self.formats, self.values, self.read_only = {}, {}, set()
        for section in sheet.sections():
            index, _, sub_index = section.lower().partition("sub")
            try:
                place = int(index, 16), int(sub_index or "0", 16)
            except ValueError:
                continue
            keys = sheet[section]
            if keys.get("ObjectType", "0x7") != "0x7":
                continue
            self.formats[place] = FORMATS[int(keys["DataType"], 0)]
            terms = keys.get("DefaultValue", "0").split("+")
            self.values[place] = sum(NODE if term == "$NODEID" else int(term, 0) for term in terms)
            if keys["AccessType"] in ("ro", "const"):
                self.read_only.add(place)

    def answer(self, request):
        """Answers an expedited download or an upload (CiA 301, 7.2.4.3); also returns the object
        that was written, if one was."""
        place = struct.unpack_from("<HB", request, 1)
        where = struct.pack("<HB", *place)
        if place not in self.values:
            code = NO_SUB_INDEX if (place[0], 0) in self.values else NO_OBJECT
            return b"\x80" + where + struct.pack("<I", code), None
        form = "<" + self.formats[place]
        size = struct.calcsize(form)
        if request[0] >> 5 == 2:
            data = struct.pack(form, self.values[place]).ljust(4, b"\0")
            return bytes([0x43 | 4 - size << 2]) + where + data, None
        if place in self.read_only:
            return b"\x80" + where + struct.pack("<I", READ_ONLY), None
        if request[0] & 1 and 4 - (request[0] >> 2 & 3) != size:
            return b"\x80" + where + struct.pack("<I", WRONG_LENGTH), None
        (self.values[place],) = struct.unpack_from(form, request, 4)
        return b"\x60" + where + bytes(4), place

    def mapped(self, index):
        """The objects of a PDO mapping, each with its format."""
        entries = range(1, self.values[index, 0] + 1)
        objects = [self.values[index, entry] for entry in entries]
        places = [(one >> 16, one >> 8 & 0xFF) for one in objects]
        return [(place, self.formats[place]) for place in places]


class Drive(node.Node):
    """Measures at each SYNC, and acts on the target of the cycle before."""

    EDS = ""
    filters = [NMT, SYNC, 0x200 + NODE, ASK + NODE, HEARTBEAT + MANAGER]
    silent = [0x200 + NODE, HEARTBEAT + MANAGER]

    def on_start(self):
        self.boot()
        self.every(0.01, "watch")

    def boot(self):
        self.objects = Objects(pathlib.Path(__file__).with_name(self.EDS))
        self.nmt_state, self.state = PRE_OPERATIONAL, SWITCH_ON_DISABLED
        self.beat_at = self.manager_heard_at = self.measured_at = None
        self.send(HEARTBEAT + NODE, bytes([BOOT_UP]))

    def on_time(self, name):
        """Sends the heartbeat, and switches off when the manager is silent (0x1016)."""
        if self.beat_at is not None and self.now >= self.beat_at - 1e-9:
            self.beat_at += self.objects.values[0x1017, 0] / 1e3
            self.send(HEARTBEAT + NODE, bytes([self.nmt_state]))
        limit = (self.objects.values[0x1016, 1] & 0xFFFF) / 1e3
        heard = self.manager_heard_at
        if limit and heard is not None and self.now > heard + limit:
            self.state = SWITCH_ON_DISABLED

    def on_frame(self, frame):
        if frame.id == NMT and frame.data[1] in (0, NODE):
            self.follow_nmt(frame.data[0])
        elif frame.id == ASK + NODE:
            answer, written = self.objects.answer(frame.data)
            if written == (0x1017, 0):
                period = self.objects.values[0x1017, 0] / 1e3
                self.beat_at = self.now + period if period else None
            self.send(ANSWER + NODE, answer)
        elif frame.id == HEARTBEAT + MANAGER:
            self.manager_heard_at = self.now
        elif frame.id == self.objects.values[0x1400, 1] and self.nmt_state == OPERATIONAL:
            self.unpack(0x1600, frame.data)
        elif frame.id == SYNC and self.nmt_state == OPERATIONAL:
            self.cycle()

    def follow_nmt(self, command):
        if command in (129, 130):
            self.boot()
            return
        states = {1: OPERATIONAL, 2: STOPPED, 128: PRE_OPERATIONAL}
        self.nmt_state = states.get(command, self.nmt_state)
        if self.nmt_state != OPERATIONAL:
            self.state = SWITCH_ON_DISABLED

    def unpack(self, mapping, data):
        mapped = self.objects.mapped(mapping)
        form = "<" + "".join(form for _, form in mapped)
        if struct.calcsize(form) <= len(data):
            for (place, _), value in zip(mapped, struct.unpack_from(form, data)):
                self.objects.values[place] = value

    def pack(self, mapping):
        mapped = self.objects.mapped(mapping)
        form = "<" + "".join(form for _, form in mapped)
        return struct.pack(form, *(self.objects.values[place] for place, _ in mapped))

    def cycle(self):
        values = self.objects.values
        self.follow_controlword(values[0x6040, 0])
        passed = 0.0 if self.measured_at is None else self.now - self.measured_at
        self.measured_at = self.now
        self.advance(passed, self.state == ENABLED)
        values[0x6061, 0] = values[0x6060, 0]
        values[0x6041, 0] = self.state | REMOTE
        for number in range(4):
            identifier = values.get((0x1800 + number, 1), PDO_OF_NOBODY)
            if not identifier & PDO_OF_NOBODY and values[0x1800 + number, 2] == 1:
                self.send(identifier & 0x7FF, self.pack(0x1A00 + number))

    def follow_controlword(self, word):
        for mask, value, state, before in TRANSITIONS:
            if word & mask == value and self.state in before:
                self.state = state
                return

    def advance(self, seconds, is_enabled):
        """Brings the motion to the present, and writes what is measured into the objects."""
        raise NotImplementedError

    def on_stop(self):
        self.state = SWITCH_ON_DISABLED
