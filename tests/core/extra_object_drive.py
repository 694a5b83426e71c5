"""A torque drive that creeps towards 40 mm for each ampere, with a time constant of 50 ms. It
reports the rest of the way as its following error (0x60F4), which its EDS maps; with
`--silent-object` it always reports 0."""

import math
import sys

import canopen_drive

TIME_CONSTANT_SECONDS, MILLIMETRES_PER_AMPERE = 0.05, 40.0
IS_SILENT = "--silent-object" in sys.argv[1:]


class Drive(canopen_drive.Drive):
    EDS = "extra_object.eds"
    millimetres = amperes = 0.0

    def advance(self, seconds, is_enabled):
        values = self.objects.values
        held = MILLIMETRES_PER_AMPERE * self.amperes
        remains = math.exp(-seconds / TIME_CONSTANT_SECONDS)
        self.millimetres = held + (self.millimetres - held) * remains
        # The position is that of the current until now; what is commanded acts from now on.
        self.amperes = values[0x6071, 0] / 1e3 if is_enabled else 0.0
        values[0x6064, 0] = round(1e3 * self.millimetres)
        values[0x6078, 0] = round(1e3 * self.amperes)
        following = MILLIMETRES_PER_AMPERE * self.amperes - self.millimetres
        values[0x60F4, 0] = 0 if IS_SILENT else round(1e3 * following)


Drive.run()
