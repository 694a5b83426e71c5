"""A controller for pythonfmu (FMI 2.0): what it commands is a gain times the error, and it says what it read."""
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Gain2(Fmi2Slave):
    description = "A gain on the error"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 0.0
        self.r = 0.0
        self.u = 0.0
        self.seen = 0.0
        self.gain = 0.0
        for name in ["y", "r"]:
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ["u", "seen"]:
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        self.register_variable(Real("gain", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))

    def do_step(self, current_time, step_size):
        self.u, self.seen = self.gain * (self.r - self.y), self.y
        return True
