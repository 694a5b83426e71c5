//! Motion of rack and load; all rotating parts are reduced to a mass at the rack.

use scenario::plant::DcMotor;

use crate::integrator::runge_kutta_4;
use crate::plant::Inputs;
use crate::plants::GRAVITY;
use crate::plants::condition::Condition;

/// Largest number of reversals in one step; then the load rests until the next step.
const TURNS_MAX: u32 = 4;

/// The equation of motion and its state.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    /// Radius of the pinion, `r`, m.
    pinion_radius_metres: f64,
    /// Angle of the motor per travel of the rack, `n / r`, 1/m.
    transmission: f64,
    /// Force on the rack per current, `kM n / r`, N/A.
    force_per_ampere: f64,
    /// Inertia of rotor and gearbox as a mass on the rack, `(JR + JG) (n / r)²`, kg.
    rotating_kilograms: f64,
    /// Mass of the load, `mL`, kg.
    load_kilograms: f64,
    /// Coulomb friction of motor and gearbox on the rack, `MC n / r + MG / r`, N.
    coulomb_newtons: f64,
    /// Viscous friction on the rack, `b (n / r)²`, N s/m.
    damping: f64,
    /// Stiffness of the spring, `k`, N/m.
    stiffness: f64,
    /// Height of the upper stop, `xmax`, m.
    travel_metres: f64,
    /// Height `x` of the load, zero on the lower stop, upwards.
    pub(super) position_metres: f64,
    /// Its rate `ẋ`.
    pub(super) velocity_metres_per_second: f64,
}

/// Forces of constant inputs on the rack, and the moved mass.
struct Forces {
    /// Force of the motor minus the weight, N.
    constant_newtons: f64,
    mass_kilograms: f64,
}

impl Motion {
    /// Makes a motion at rest on the lower stop.
    pub(super) fn new(config: &DcMotor) -> Self {
        let transmission = config.gear_ratio / config.pinion_radius_metres;
        let inertia = config.rotor_inertia_kilogram_square_metres
            + config.gear_inertia_kilogram_square_metres;
        Self {
            pinion_radius_metres: config.pinion_radius_metres,
            transmission,
            force_per_ampere: config.torque_constant_newton_metres_per_ampere * transmission,
            rotating_kilograms: inertia * transmission * transmission,
            load_kilograms: config.load_kilograms,
            coulomb_newtons: config.coulomb_friction_newton_metres * transmission
                + config.gear_friction_newton_metres / config.pinion_radius_metres,
            damping: config.viscous_friction_newton_metre_seconds * transmission * transmission,
            stiffness: config.spring_newtons_per_metre,
            travel_metres: config.travel_metres,
            position_metres: 0.0,
            velocity_metres_per_second: 0.0,
        }
    }

    /// Takes one step. Coulomb friction and the stops change the equation at a reversal, so the step is divided there.
    pub(super) fn step(&mut self, duration_seconds: f64, inputs: &Inputs, condition: Condition) {
        let forces = self.forces(inputs, condition);
        let mut left = duration_seconds;
        for _ in 0..TURNS_MAX {
            let direction = if condition.is_pulley_jammed {
                0.0
            } else {
                self.direction(&forces)
            };
            if direction == 0.0 {
                self.velocity_metres_per_second = 0.0;
                return;
            }
            let before = self.velocity_metres_per_second;
            let [position, velocity] = self.integrated(left, direction, &forces);
            if velocity * direction >= 0.0 {
                self.settle([position, velocity]);
                return;
            }
            // The velocity is nearly linear within a step.
            let turn = left * before / (before - velocity);
            let [position, _] = self.integrated(turn, direction, &forces);
            self.settle([position, 0.0]);
            left -= turn;
        }
    }

    fn forces(&self, inputs: &Inputs, condition: Condition) -> Forces {
        let added_load_kilograms = condition.added_load_kilograms(inputs);
        let load_kilograms = (self.load_kilograms + added_load_kilograms).max(0.0);
        Forces {
            constant_newtons: self.force_per_ampere * inputs.current_amperes
                - load_kilograms * GRAVITY,
            mass_kilograms: self.rotating_kilograms + load_kilograms,
        }
    }

    /// Returns the direction in which the load moves or is about to: upwards (1), downwards (−1), or none (0).
    fn direction(&self, forces: &Forces) -> f64 {
        let velocity = self.velocity_metres_per_second;
        if velocity != 0.0 {
            return velocity.signum();
        }
        let force = forces.constant_newtons - self.spring_newtons();
        if force > self.coulomb_newtons && self.position_metres < self.travel_metres {
            1.0
        } else if force < -self.coulomb_newtons && self.position_metres > 0.0 {
            -1.0
        } else {
            0.0
        }
    }

    /// Integrates `M ẍ = kM i n/r − mL g − k x − B ẋ − sgn(ẋ) MC` in one direction.
    fn integrated(&self, duration_seconds: f64, direction: f64, forces: &Forces) -> [f64; 2] {
        let constant = forces.constant_newtons - direction * self.coulomb_newtons;
        let state = [self.position_metres, self.velocity_metres_per_second];
        runge_kutta_4(state, duration_seconds, |_, &[position, velocity]| {
            let force = constant - self.stiffness * position - self.damping * velocity;
            [velocity, force / forces.mass_kilograms]
        })
    }

    /// Sets the state. An impact on a stop is inelastic.
    fn settle(&mut self, [position, velocity]: [f64; 2]) {
        let is_beyond = !(0.0..=self.travel_metres).contains(&position);
        self.position_metres = position.clamp(0.0, self.travel_metres);
        self.velocity_metres_per_second = if is_beyond { 0.0 } else { velocity };
    }

    /// Returns an upper bound of the motion's rate: that without the load.
    pub(super) fn fastest_rate_per_second(&self) -> f64 {
        let mass = self.rotating_kilograms;
        libm::sqrt(self.stiffness / mass) + self.damping / mass
    }

    pub(super) fn speed_radians_per_second(&self) -> f64 {
        self.velocity_metres_per_second * self.transmission
    }

    pub(super) fn pinion_angle_radians(&self) -> f64 {
        self.position_metres / self.pinion_radius_metres
    }

    pub(super) fn spring_newtons(&self) -> f64 {
        self.stiffness * self.position_metres
    }
}
