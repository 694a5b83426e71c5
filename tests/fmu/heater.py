"""A heater, for pythonfmu3 (FMI 3.0): power in, temperature out, with units."""
from math import exp

from pythonfmu3 import CoSimulation, Fmi3Causality, Fmi3Initial, Fmi3SlaveBase, Fmi3Variability, Float64, Int32, Unit


class Heater(Fmi3SlaveBase, CoSimulation):
    description = "A block of metal that a resistor heats and the air cools"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.register_units([
            Unit("W", kg=1, m=2, s=-3),
            Unit("degC", K=1, offset=273.15),
            Unit("J/K", kg=1, m=2, s=-2, K=-1),
            Unit("kA", A=1, factor=1000.0),
        ])
        self.time = 0.0
        self.current = 0.0
        self.temperature = 20.0
        self.capacity = 40.0
        self.steps = 0
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous))
        self.register_variable(Float64("current", causality=Fmi3Causality.input, unit="kA"))
        self.register_variable(Float64("temperature", causality=Fmi3Causality.output, unit="degC", initial=Fmi3Initial.exact))
        self.register_variable(Float64("capacity", causality=Fmi3Causality.parameter, variability=Fmi3Variability.fixed, unit="J/K"))
        self.register_variable(Int32("steps", causality=Fmi3Causality.output))

    def do_step(self, current_time, step_size):
        power = 2.0 * (1e3 * self.current) ** 2
        end = 20.0 + power / 0.5
        self.temperature = end + (self.temperature - end) * exp(-step_size * 0.5 / self.capacity)
        self.steps += 1
        return True
