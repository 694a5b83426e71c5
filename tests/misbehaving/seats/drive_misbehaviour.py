

# What follows is appended to tests/data/programs/drive.py.
import json

# What it does wrong, as JSON: times are seconds since it was enabled.
WRONG = json.loads(os.environ.get("DRIVE", "{}"))
NEVER = float("inf")
FAULT = 0x38


class Misbehaving(Drive):
    """Falls silent, trips, switches off or boots again."""

    def on_start(self):
        self.syncs, self.zero = 0, None
        super().on_start()

    def has_come(self, key):
        time = -1.0 if self.zero is None else self.now - self.zero
        return time >= WRONG.get(key, NEVER)

    def on_time(self, name):
        if not self.has_come("mute_from") and not self.has_come("heartbeat_until"):
            super().on_time(name)

    def cycle(self):
        if self.state == ENABLED and self.zero is None:
            self.zero = self.now
        self.syncs += 1
        if self.has_come("boots_at"):
            WRONG.pop("boots_at")
            self.is_operational, self.state = False, DISABLED
            self.send(HEARTBEAT + NODE, bytes([0]))
        elif self.has_come("trips_at"):
            if self.state != FAULT:
                self.send(0x080 + NODE, bytes.fromhex("1023090000000000"))
            self.report(FAULT)
        elif self.has_come("switches_off_at"):
            self.report(DISABLED)
        elif not self.has_come("mute_from") and self.syncs % WRONG.get("leaves_out_each", 10**9):
            super().cycle()

    def report(self, state):
        self.state = state
        data = bytearray(READS.encode(position_millimetres=self.millimetres, current_amperes=0.0))
        data[0:2] = struct.pack("<H", state | 0x0200)
        self.send(READS.id, bytes(data))


Misbehaving.run()
