

# What follows is appended to the controller that `canrig new controller --language python` writes.
import json
import os

# What it does wrong, as JSON: times are seconds of the scenario.
WRONG = json.loads(os.environ.get("CONTROLLER", "{}"))
NEVER = float("inf")
OBJECTS[0] = struct.pack("<BHBI", 0x23, 0x1016, 1, OWN << 16 | WRONG.get("watch_milliseconds", 100))


class Misbehaving(Controller):
    """Sends less, more or other frames than it should, from the begin of the scenario on."""

    def on_start(self):
        self.cycle, self.beats, self.count, self.steps_back = -1, -1, 0, 0
        self.acts = list(WRONG.get("acts", []))
        super().on_start()

    @property
    def time(self):
        return -1.0 if self.zero is None else (self.bus.now_ns - self.zero) / 1e9

    def is_left_out(self, key):
        every = WRONG.get(key)
        return every is not None and self.cycle > 0 and self.cycle % every == every - 1

    def on_time(self, name):
        is_mute = self.time >= WRONG.get("mute_from", NEVER)
        if name == "heartbeat":
            self.beats += 1
            is_due = self.beats % WRONG.get("beats_each", 1) == 0
            if is_due and not is_mute and self.time < WRONG.get("heartbeat_until", NEVER):
                super().on_time(name)
            return
        if name != "sync":
            super().on_time(name)
            return
        self.cycle += self.is_enabled or self.zero is not None
        if is_mute or self.is_left_out("leaves_out_each_sync"):
            return
        if "counter_steps_back_each" in WRONG:
            self.send_sync_with_counter()
        else:
            super().on_time(name)
        while self.acts and self.time >= self.acts[0]["at"]:
            act = self.acts.pop(0)
            self.send(int(act["id"], 16), bytes.fromhex(act["data"]))
        if self.time >= WRONG.get("floods_from", NEVER):
            for _ in range(90):
                self.send(0x001, bytes(8))

    def send_sync_with_counter(self):
        self.count += 1
        if self.count % WRONG["counter_steps_back_each"] == 0:
            self.steps_back += 3
        self.sync_at = self.bus.now_ns
        if self.is_enabled and self.zero is None:
            self.zero = self.sync_at
        self.send(SYNC, bytes([(self.count - self.steps_back) % 240 + 1]))

    def command(self, controlword, amperes):
        is_mute = self.time >= WRONG.get("mute_from", NEVER)
        if not is_mute and not self.is_left_out("leaves_out_each_command"):
            super().command(controlword, amperes)


Misbehaving.run()
