"""A mass on a spring, for pythonfmu (FMI 2.0): force in, position out, without units. It discards steps above 4 ms."""
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real, String


class Spring(Fmi2Slave):
    description = "A mass on a spring"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.force = 0.0
        self.position = 0.0
        self.speed = 0.0
        self.mass = 0.5
        self.damped = True
        self.label = "spring"
        self.register_variable(Real("force", causality=Fmi2Causality.input))
        self.register_variable(Real("position", causality=Fmi2Causality.output))
        self.register_variable(Real("speed", causality=Fmi2Causality.output))
        self.register_variable(Real("mass", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(Boolean("damped", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(String("label", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))

    def do_step(self, current_time, step_size):
        if step_size > 0.004:
            return False
        damping = 0.8 if self.damped else 0.0
        acceleration = (self.force - 30.0 * self.position - damping * self.speed) / self.mass
        self.speed += acceleration * step_size
        self.position += self.speed * step_size
        return True
