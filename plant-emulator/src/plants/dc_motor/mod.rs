//! A DC motor that lifts a load through gearbox, pinion and rack, against a spring: current in, position and speed out.
//!
//! The amplifier sources the current, so neither inductance nor back electromotive force matters: up to the motor's
//! no-load speed at 12 V the shipped motor needs less than 15 V for 1 A.

mod heat;
mod motion;
#[cfg(test)]
mod tests;

use std::sync::LazyLock;

use scenario::custom::Minima;

use crate::integrator::in_equal_steps;
use crate::plant::{Faults, Inputs, InvalidPlant, Plant, Port, Ports, follows, one_axis};
use crate::plants::condition::Condition;
use heat::Heat;
use motion::Motion;

/// Longest integration step: the shipped plant's fastest rate is 11 1/s.
pub const STEP_SECONDS_MAX: f64 = 1e-3;

/// Tolerated excess of the steps' total length, as a share of a step: a whole number of steps but for rounding needs no
/// further step.
const STEP_EXCESS: f64 = 1e-9;

/// The motor with its gearbox, spring and load.
#[derive(Clone, Debug)]
pub struct DcMotor {
    heat: Heat,
    motion: Motion,
    condition: Condition,
}

impl DcMotor {
    /// Makes a motor with these parameters, at rest on the lower stop, without current and as warm as the air.
    fn with(config: &scenario::plant::DcMotor) -> Self {
        Self {
            heat: Heat::new(config),
            motion: Motion::new(config),
            condition: Condition::default(),
        }
    }

    /// Advances the time under constant inputs, in equal steps of at most [`STEP_SECONDS_MAX`].
    fn advance(&mut self, duration_seconds: f64, inputs: &Inputs) {
        let step = |step_seconds| {
            self.heat.step(step_seconds, inputs);
            self.motion.step(step_seconds, inputs, self.condition);
        };
        in_equal_steps(duration_seconds, STEP_SECONDS_MAX, STEP_EXCESS, step);
    }
}

impl Plant for DcMotor {
    type Config = scenario::plant::DcMotor;

    fn name() -> &'static str {
        "dc_motor"
    }

    fn new(config: &Self::Config) -> Result<Self, InvalidPlant> {
        check(config)?;
        Ok(Self::with(config))
    }

    fn ports(&self) -> Ports {
        one_axis([
            Port::output("winding_temperature_celsius", [-273.15, 327.67])
                .in_steps(1e2)
                .with_comment("Temperature of the motor's winding."),
            Port::output("motor_speed_revolutions_per_minute", [-32_768.0, 32_767.0])
                .in_steps(1.0)
                .with_comment("Speed of the motor's shaft, upwards."),
            Port::output("spring_force_newtons", [-327.68, 327.67])
                .in_steps(1e2)
                .with_comment("Force of the spring, downwards."),
            // Without a range the port is for a sensor only.
            Port::output("pinion_angle_degrees", [f64::NEG_INFINITY, f64::INFINITY])
                .with_comment("Angle of the pinion, or of a spindle in its place, upwards."),
        ])
    }

    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        self.advance(duration_seconds, &Inputs::of(inputs));
    }

    fn read(&self, outputs: &mut [f64]) {
        outputs.copy_from_slice(&[
            self.motion.position_metres,
            self.heat.winding_celsius,
            self.motion.speed_radians_per_second() * 60.0 / std::f64::consts::TAU,
            self.motion.spring_newtons(),
            self.motion.pinion_angle_radians().to_degrees(),
        ]);
    }

    fn heated_celsius(&self, _input: usize) -> Option<f64> {
        Some(self.heat.winding_celsius)
    }

    fn set_condition(&mut self, _input: usize, faults: &Faults, time_seconds: f64) {
        self.condition = Condition::at(faults, time_seconds);
    }
}

/// Checks the parameters, and that the integrator can follow.
fn check(config: &scenario::plant::DcMotor) -> Result<(), InvalidPlant> {
    static MINIMA: LazyLock<Minima> = LazyLock::new(Minima::of::<scenario::plant::DcMotor>);
    MINIMA.check(config)?;
    let heat = Heat::new(config).fastest_rate_per_second();
    follows("heat", heat, STEP_SECONDS_MAX)?;
    let motion = Motion::new(config).fastest_rate_per_second();
    follows("motion", motion, STEP_SECONDS_MAX)
}
