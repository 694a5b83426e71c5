"""The controller of gain2.py for pythonfmu3 (FMI 3.0)."""
from pythonfmu3 import CoSimulation, Fmi3Causality, Fmi3SlaveBase, Fmi3Variability, Float64


class Gain3(Fmi3SlaveBase, CoSimulation):
    description = "A gain on the error"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time = 0.0
        self.y = 0.0
        self.r = 0.0
        self.u = 0.0
        self.seen = 0.0
        self.gain = 0.0
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous))
        for name in ["y", "r"]:
            self.register_variable(Float64(name, causality=Fmi3Causality.input))
        for name in ["u", "seen"]:
            self.register_variable(Float64(name, causality=Fmi3Causality.output))
        self.register_variable(Float64("gain", causality=Fmi3Causality.parameter, variability=Fmi3Variability.fixed))

    def do_step(self, current_time, step_size):
        self.u, self.seen = self.gain * (self.r - self.y), self.y
        return True
