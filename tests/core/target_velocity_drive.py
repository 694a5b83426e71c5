"""A drive in cyclic synchronous velocity mode: its speed follows the target (0x60FF, in micrometres
per second) with a time constant of 20 ms. With `--stands-still` it follows no target."""

import math
import sys

import canopen_drive

TIME_CONSTANT_SECONDS = 0.02
CYCLIC_SYNCHRONOUS_VELOCITY = 9
STANDS_STILL = "--stands-still" in sys.argv[1:]


class Drive(canopen_drive.Drive):
    EDS = "target_velocity.eds"
    millimetres = speed = wanted = 0.0

    def advance(self, seconds, is_enabled):
        values = self.objects.values
        remains = math.exp(-seconds / TIME_CONSTANT_SECONDS)
        gap = self.wanted - self.speed
        self.millimetres += self.wanted * seconds - gap * TIME_CONSTANT_SECONDS * (1.0 - remains)
        self.speed = self.wanted - gap * remains
        is_led = values[0x6060, 0] == CYCLIC_SYNCHRONOUS_VELOCITY and not STANDS_STILL
        self.wanted = values[0x60FF, 0] / 1e3 if is_enabled and is_led else 0.0
        values[0x6064, 0] = round(1e3 * self.millimetres)
        values[0x606C, 0] = round(1e3 * self.speed)


Drive.run()
