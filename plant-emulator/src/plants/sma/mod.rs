//! The SMA actuator: heat, phase and motion, combined and integrated.

mod curve;
mod heat;
pub mod pair;
mod phase;
mod turns;
mod validity;
mod wire;

use heat::{HeatBalance, Heating};
use phase::Transformation;
pub use validity::{CONVECTION_FACTOR_MAX, STEP_SECONDS_MAX, check};
pub use wire::stress_pascals;
use wire::{Load, Mechanics};

use scenario::plant::SMA_ACTUATOR;

use crate::integrator::{in_equal_steps, runge_kutta_4_from};
use crate::plant::{Faults, Inputs, InvalidPlant, Plant, Port, Ports, one_axis};
use crate::plants::condition::Condition;

/// Tolerated excess of the steps' total length, as a share of a step. Every fourth SYNC of 1 kHz is some bits late and
/// needs no second step.
const STEP_EXCESS: f64 = 0.1;

/// The inputs as terms of the equations.
#[derive(Clone, Copy, Debug)]
struct Acting {
    heating: Heating,
    load: Load,
    condition: Condition,
}

/// The integrated quantities, and the fraction that follows from them.
#[derive(Clone, Copy, Debug)]
struct State {
    /// Temperature `T` of the wire.
    temperature_celsius: f64,
    /// Height `x` of the load, zero on the stop, upwards.
    position_metres: f64,
    /// Its rate `ẋ`.
    velocity_metres_per_second: f64,
    /// Martensite fraction `ξ` at `T` on the present branch.
    martensite_fraction: f64,
}

/// The actuator: wire, cooling element, pulley and load.
#[derive(Clone, Debug)]
pub struct Actuator {
    heat: HeatBalance,
    phase: Transformation,
    mechanics: Mechanics,
    state: State,
    condition: Condition,
    step_seconds_max: f64,
}

impl Actuator {
    /// Makes the start state: at rest on the stop, without current, at the equilibrium of cooling element and air, all
    /// martensite.
    pub fn new(plant: &scenario::plant::Sma) -> Self {
        let heat = HeatBalance::new(&plant.heat);
        let phase = Transformation::new(&plant.phase, plant.kinetics);
        let temperature_celsius = heat.equilibrium_celsius(0.0, 1.0);
        let state = State {
            temperature_celsius,
            position_metres: 0.0,
            velocity_metres_per_second: 0.0,
            martensite_fraction: phase.martensite_fraction(temperature_celsius),
        };
        Self {
            heat,
            phase,
            mechanics: Mechanics::new(&plant.mechanics),
            state,
            condition: Condition::default(),
            step_seconds_max: STEP_SECONDS_MAX,
        }
    }

    /// Returns the same state with another longest integration step.
    pub fn continued_with_step(&self, step_seconds_max: f64) -> Self {
        Self {
            step_seconds_max,
            ..self.clone()
        }
    }

    /// Advances by `duration_seconds` under constant inputs, in equal steps of at most the longest step plus a small
    /// excess.
    pub fn advance(&mut self, duration_seconds: f64, inputs: &Inputs) {
        let acting = self.acting(inputs);
        let longest_seconds = self.step_seconds_max;
        let step = |step_seconds| self.step(step_seconds, &acting);
        in_equal_steps(duration_seconds, longest_seconds, STEP_EXCESS, step);
    }

    fn acting(&self, inputs: &Inputs) -> Acting {
        let condition = self.condition;
        let heating_amperes = condition.heating_amperes(inputs.current_amperes);
        Acting {
            heating: self.heat.heating(heating_amperes, inputs.convection_factor),
            load: self.mechanics.load(condition.added_load_kilograms(inputs)),
            condition,
        }
    }

    /// Takes one step. The branch follows the sign of `dT/dt`, which constant inputs never change: Eq. (1) approaches its
    /// equilibrium monotonically. At a turn the fraction is continuous except for the last bits.
    fn step(&mut self, duration_seconds: f64, acting: &Acting) {
        let temperature = self.state.temperature_celsius;
        let rate = self
            .heat
            .rate_kelvin_per_second(temperature, &acting.heating);
        if self.phase.follow(rate, temperature) {
            self.state.martensite_fraction = self.phase.martensite_fraction(temperature);
        }
        self.state = self.integrated(duration_seconds, acting);
    }

    /// Returns the state one step later on the present branch.
    fn integrated(&self, duration_seconds: f64, acting: &Acting) -> State {
        match self.phase.endless() {
            Some(curve) => self.integrated_on(duration_seconds, acting, |celsius| {
                curve.martensite_fraction(celsius)
            }),
            None => self.integrated_on(duration_seconds, acting, |celsius| {
                self.phase.at(celsius).martensite_fraction
            }),
        }
    }

    /// Returns the state one step later with this `ξ` over the temperature. An impact on the stop is inelastic
    /// (PAPER E6).
    #[inline]
    fn integrated_on(
        &self,
        duration_seconds: f64,
        acting: &Acting,
        martensite_fraction: impl Fn(f64) -> f64,
    ) -> State {
        let state = [
            self.state.temperature_celsius,
            self.state.position_metres,
            self.state.velocity_metres_per_second,
        ];
        let fraction = self.state.martensite_fraction;
        let at_start = self.derivative(&state, fraction, acting);
        let [temperature_celsius, position, velocity] =
            runge_kutta_4_from(state, at_start, duration_seconds, |_, state| {
                self.derivative(state, martensite_fraction(state[0]), acting)
            });
        let is_beyond = position < 0.0;
        let is_stopped = is_beyond || acting.condition.is_pulley_jammed;
        State {
            temperature_celsius,
            position_metres: if is_beyond { 0.0 } else { position },
            velocity_metres_per_second: if is_stopped { 0.0 } else { velocity },
            martensite_fraction: martensite_fraction(temperature_celsius),
        }
    }

    /// Returns `(dT/dt, ẋ, ẍ)` from Eq. (1), (2) and (7), with the stop at `x = 0`.
    #[inline]
    fn derivative(
        &self,
        &[temperature, position, velocity]: &[f64; 3],
        martensite_fraction: f64,
        acting: &Acting,
    ) -> [f64; 3] {
        let rate =
            self.heat
                .transforming_rate_kelvin_per_second(temperature, &acting.heating, || {
                    self.phase.fraction_per_kelvin(temperature)
                });
        let tension = if acting.condition.is_wire_broken {
            0.0
        } else {
            let strain_factor = acting.condition.recoverable_strain_factor;
            self.mechanics
                .tension_newtons(martensite_fraction, position, strain_factor)
        };
        let acceleration = self.mechanics.acceleration(tension, velocity, &acting.load);
        let is_jammed = acting.condition.is_pulley_jammed;
        if is_jammed || wire::is_resting(position, velocity, acceleration) {
            [rate, 0.0, 0.0]
        } else {
            [rate, velocity, acceleration]
        }
    }

    /// Returns `T`, the temperature of the wire.
    pub fn temperature_celsius(&self) -> f64 {
        self.state.temperature_celsius
    }

    /// Returns `ξ`, from 0 (austenite) to 1 (martensite).
    pub fn martensite_fraction(&self) -> f64 {
        self.state.martensite_fraction
    }

    /// Returns `x`, the height of the load above its stop.
    pub fn position_metres(&self) -> f64 {
        self.state.position_metres
    }

    /// Returns `ẋ`, upwards.
    pub fn velocity_metres_per_second(&self) -> f64 {
        self.state.velocity_metres_per_second
    }

    /// Returns `T2`, the tension of a sound wire; never negative.
    pub fn tension_newtons(&self) -> f64 {
        self.mechanics
            .tension_newtons(self.martensite_fraction(), self.state.position_metres, 1.0)
    }

    /// Returns the equilibrium temperature of the wire under these inputs.
    pub fn equilibrium_celsius(&self, inputs: &Inputs) -> f64 {
        self.heat.equilibrium_celsius(
            self.condition.heating_amperes(inputs.current_amperes),
            inputs.convection_factor,
        )
    }
}

/// Returns the port that counts the turns that did not fit into the memory of a wire.
fn turns_not_remembered(name: &str) -> Port {
    Port::output(name, [0.0, f64::from(u16::MAX)])
        .in_steps(1.0)
        .if_recorded()
        .with_comment("Turns of the temperature that found no room in the memory of 64.")
}

impl Plant for Actuator {
    type Config = scenario::plant::Sma;

    fn name() -> &'static str {
        SMA_ACTUATOR
    }

    fn new(config: &Self::Config) -> Result<Self, InvalidPlant> {
        check(config)?;
        Ok(Self::new(config))
    }

    fn ports(&self) -> Ports {
        one_axis([
            Port::output("wire_temperature_celsius", [-273.15, 327.67])
                .in_steps(1e2)
                .with_comment("Wire temperature."),
            Port::output("martensite_fraction", [0.0, 1.0])
                .in_steps(5e4)
                .with_comment("Martensite fraction of the wire."),
            turns_not_remembered("turns_not_remembered"),
        ])
    }

    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        self.advance(duration_seconds, &Inputs::of(inputs));
    }

    fn read(&self, outputs: &mut [f64]) {
        outputs.copy_from_slice(&[
            self.position_metres(),
            self.temperature_celsius(),
            self.martensite_fraction(),
            f64::from(self.phase.turns_not_remembered()),
        ]);
    }

    fn heated_celsius(&self, _input: usize) -> Option<f64> {
        Some(self.temperature_celsius())
    }

    fn conducts(&self, _input: usize) -> bool {
        !self.condition.is_wire_broken
    }

    fn set_condition(&mut self, _input: usize, faults: &Faults, time_seconds: f64) {
        self.condition = Condition::at(faults, time_seconds);
    }
}
