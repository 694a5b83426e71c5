"""The brake of `two_ecus.dbc`: it slows a car of 20 m/s down by 0.1 m/s² for each percent of the
pedal, and sends its message each 10 ms. With `--silent-from SECONDS` it falls silent that long
after its start."""

import pathlib
import struct
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "python" / "canrig"))
import node  # noqa: E402

PEDAL, WHEEL = 256, 272
PERIOD_SECONDS = 0.01
METRES_PER_SECOND_SQUARED_PER_PERCENT, BAR_PER_PERCENT = 0.1, 1.2
OPTIONS = dict(zip(sys.argv[1::2], sys.argv[2::2]))
SILENT_FROM = float(OPTIONS.get("--silent-from", "inf"))


class Brake(node.Node):
    filters = silent = [PEDAL]

    def on_start(self):
        self.percent, self.metres_per_second = 0.0, 20.0
        self.every(PERIOD_SECONDS, "cycle")

    def on_frame(self, frame):
        self.percent = struct.unpack_from("<H", frame.data)[0] / 100

    def on_time(self, name):
        slower = METRES_PER_SECOND_SQUARED_PER_PERCENT * self.percent * PERIOD_SECONDS
        self.metres_per_second = max(0.0, self.metres_per_second - slower)
        if self.now < SILENT_FROM:
            bar = BAR_PER_PERCENT * self.percent
            values = round(1e3 * self.metres_per_second), round(1e2 * bar), 0
            self.send(WHEEL, struct.pack("<HHI", *values))


Brake.run()
