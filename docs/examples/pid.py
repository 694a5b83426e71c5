"""A PID on the position error, with the derivative on the measurement and conditional integration."""

import math

import canrig.law


class Pid:
    def __init__(self, setup):
        self.gains = setup.parameters
        self.low, self.high = setup.ranges[0]
        self.integral_amperes = 0.0
        self.position = 0.0
        self.filtered = None

    def wanted_amperes(self, cycle, x):
        """The current before it is limited to what the drive can be commanded."""
        if math.isfinite(x.position_metres):
            self.position = x.position_metres
        if self.filtered is None:
            self.filtered = self.position
        pole = self.gains.derivative_filter_radians_per_second
        moved = (1.0 - math.exp(-pole * cycle.period_seconds)) * (self.position - self.filtered)
        self.filtered += moved
        weighted = self.gains.set_point_weight * x.set_point_metres
        current = (
            self.gains.proportional_amperes_per_metre * (weighted - self.position)
            + self.integral_amperes
            - self.gains.derivative_ampere_seconds_per_metre * (moved / cycle.period_seconds)
        )
        error = x.set_point_metres - self.position
        winds_up = (current >= self.high and error > 0.0) or (current <= self.low and error < 0.0)
        if not winds_up:
            integral = self.gains.integral_amperes_per_metre_second * error * cycle.period_seconds
            self.integral_amperes += integral
        return current

    def step(self, cycle, x):
        return {
            "command": self.wanted_amperes(cycle, x),
            "integral_amperes": self.integral_amperes,
        }


canrig.law.register(Pid)
