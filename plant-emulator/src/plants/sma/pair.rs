//! A joint with two antagonistic wires: two currents in, an angle out. The wire that is not heated is slack.
//!
//! Each wire is that of the actuator: heat, Eq. (1), phase, Eq. (2), and tension, Eq. (9). The joint between them is
//! `J θ̈ + c θ̇ = r (T_flexor − T_extensor) − r m g`. An added load hangs on a cord around the same pulley and pulls
//! towards the extensor's side.

use std::sync::LazyLock;

use scenario::custom::Minima;
use scenario::plant::{self, Mechanics as MechanicsConfig, SmaPair as Config};

use super::heat::{HeatBalance, Heating};
use super::phase::Transformation;
use super::validity::{CONVECTION_FACTOR_MAX, STEP_SECONDS_MAX, check_wire};
use super::wire::Mechanics;
use super::{STEP_EXCESS, turns_not_remembered};
use crate::integrator::{in_equal_steps, runge_kutta_4};
use crate::plant::{Faults, InvalidPlant, Plant, Port, Ports, follows};
use crate::plants::GRAVITY;
use crate::plants::condition::Condition;

const FLEXOR: usize = 0;
const EXTENSOR: usize = 1;
/// Direction in which each wire turns the joint.
const SIGNS: [f64; 2] = [1.0, -1.0];

/// Indices of the inputs; the currents of the wires come first, in their order.
const CONVECTION_FACTOR: usize = 2;
const ADDED_LOAD: usize = 3;

/// A wire without its load.
#[derive(Clone, Debug)]
struct Wire {
    phase: Transformation,
    temperature_celsius: f64,
    condition: Condition,
}

/// The joint with its wires.
#[derive(Clone, Debug)]
pub struct SmaPair {
    heat: HeatBalance,
    mechanics: Mechanics,
    wires: [Wire; 2],
    /// Radius of the pulley, `r`, m.
    radius: f64,
    /// Moment of inertia `J`, kg m².
    inertia: f64,
    /// Viscous friction `c`, N m s.
    damping: f64,
    /// Contraction of both wires in the middle, m.
    middle: f64,
    /// Angle of the stops, from the middle.
    stop_degrees: f64,
    stop_radians: f64,
    /// Angle `θ`, towards the flexor's side.
    angle_radians: f64,
    /// Its rate `θ̇`.
    speed_radians_per_second: f64,
}

/// The inputs as terms of the equations.
struct Acting {
    heating: [Heating; 2],
    /// Mass of the load, `m`, kg.
    load: f64,
}

impl SmaPair {
    /// Makes the joint in its middle, without current, wires at the equilibrium of cooling element and air, all
    /// martensite.
    fn with(config: &Config) -> Self {
        let heat = HeatBalance::new(&config.heat);
        let wire = Wire {
            phase: Transformation::new(&config.phase, config.kinetics),
            temperature_celsius: heat.equilibrium_celsius(0.0, 1.0),
            condition: Condition::default(),
        };
        let mechanics = mechanics(config);
        Self {
            mechanics: Mechanics::new(&mechanics),
            wires: [wire.clone(), wire],
            radius: config.pulley_radius_millimetres * 1e-3,
            inertia: config.inertia_kilogram_square_metres,
            damping: config.damping_newton_metre_seconds,
            middle: 0.5 * mechanics.recoverable_strain * mechanics.wire_length_metres,
            stop_degrees: config.stop_degrees,
            stop_radians: config.stop_degrees.to_radians(),
            angle_radians: 0.0,
            speed_radians_per_second: 0.0,
            heat,
        }
    }

    /// Returns `T` of a wire at a temperature and an angle, on its present branch; 0 for a slack wire.
    fn tension_newtons(&self, place: usize, celsius: f64, angle_radians: f64) -> f64 {
        let wire = &self.wires[place];
        if wire.condition.is_wire_broken {
            return 0.0;
        }
        let contraction = self.middle + SIGNS[place] * self.radius * angle_radians;
        let factor = wire.condition.recoverable_strain_factor;
        self.mechanics
            .tension_newtons(wire.phase.martensite_fraction(celsius), contraction, factor)
    }

    fn is_jammed(&self) -> bool {
        let mut wires = self.wires.iter();
        wires.any(|wire| wire.condition.is_pulley_jammed)
    }

    /// Returns whether the joint is pushed against a stop and rests there.
    fn is_resting(&self, angle: f64, speed: f64, acceleration: f64) -> bool {
        let side = angle.signum();
        angle.abs() >= self.stop_radians && speed * side >= 0.0 && acceleration * side >= 0.0
    }

    /// Returns `(dT/dt, dT/dt, θ̇, θ̈)`.
    fn derivative(
        &self,
        &[flexor, extensor, angle, speed]: &[f64; 4],
        acting: &Acting,
    ) -> [f64; 4] {
        let celsius = [flexor, extensor];
        let rate = |place: usize| {
            self.heat.transforming_rate_kelvin_per_second(
                celsius[place],
                &acting.heating[place],
                || self.wires[place].phase.fraction_per_kelvin(celsius[place]),
            )
        };
        let tension = |place: usize| self.tension_newtons(place, celsius[place], angle);
        let pull = tension(FLEXOR) - tension(EXTENSOR) - acting.load * GRAVITY;
        let inertia = self.inertia + acting.load * self.radius * self.radius;
        let acceleration = (self.radius * pull - self.damping * speed) / inertia;
        let rates = [rate(FLEXOR), rate(EXTENSOR)];
        if self.is_jammed() || self.is_resting(angle, speed, acceleration) {
            [rates[0], rates[1], 0.0, 0.0]
        } else {
            [rates[0], rates[1], speed, acceleration]
        }
    }

    fn acting(&self, inputs: &[f64]) -> Acting {
        let heating = [FLEXOR, EXTENSOR].map(|place| {
            let amperes = self.wires[place].condition.heating_amperes(inputs[place]);
            self.heat.heating(amperes, inputs[CONVECTION_FACTOR])
        });
        Acting {
            heating,
            load: inputs[ADDED_LOAD].max(0.0),
        }
    }

    /// Takes one step. Each wire's branch follows the sign of its `dT/dt`, which constant inputs never change. An
    /// impact on a stop is inelastic.
    fn advance(&mut self, duration_seconds: f64, acting: &Acting) {
        for (wire, heating) in self.wires.iter_mut().zip(&acting.heating) {
            let rate = self
                .heat
                .rate_kelvin_per_second(wire.temperature_celsius, heating);
            wire.phase.follow(rate, wire.temperature_celsius);
        }
        let state = [
            self.wires[FLEXOR].temperature_celsius,
            self.wires[EXTENSOR].temperature_celsius,
            self.angle_radians,
            self.speed_radians_per_second,
        ];
        let [flexor, extensor, angle, speed] =
            runge_kutta_4(state, duration_seconds, |_, state| {
                self.derivative(state, acting)
            });
        self.wires[FLEXOR].temperature_celsius = flexor;
        self.wires[EXTENSOR].temperature_celsius = extensor;
        let is_stopped = angle.abs() > self.stop_radians || self.is_jammed();
        self.angle_radians = angle.clamp(-self.stop_radians, self.stop_radians);
        self.speed_radians_per_second = if is_stopped { 0.0 } else { speed };
    }

    /// Returns an upper bound of the joint's rate: that with both wires austenite.
    fn fastest_rate_per_second(&self) -> f64 {
        let stiffness = 2.0 * self.mechanics.stiffness_newtons_per_metre();
        let natural = libm::sqrt(stiffness * self.radius * self.radius / self.inertia);
        natural.max(self.damping / self.inertia)
    }
}

/// Returns the wire in terms of the actuator's equations, with a transmission of 1.
fn mechanics(config: &Config) -> MechanicsConfig {
    MechanicsConfig {
        austenite_modulus_pascals: config.austenite_modulus_pascals,
        wire_diameter_metres: config.wire_diameter_millimetres * 1e-3,
        wire_length_metres: config.wire_length_millimetres * 1e-3,
        recoverable_strain: config.recoverable_strain,
        inner_pulley_radius_metres: 1.0,
        outer_pulley_radius_metres: 1.0,
        ..MechanicsConfig::default()
    }
}

impl Plant for SmaPair {
    type Config = Config;

    fn name() -> &'static str {
        plant::SMA_PAIR
    }

    fn new(config: &Config) -> Result<Self, InvalidPlant> {
        static MINIMA: LazyLock<Minima> = LazyLock::new(Minima::of::<Config>);
        MINIMA.check(config)?;
        check_wire(config.kinetics, &config.heat, &config.phase)?;
        let pair = Self::with(config);
        let heat = pair.heat.rate_per_second(CONVECTION_FACTOR_MAX);
        follows("heat", heat, STEP_SECONDS_MAX)?;
        follows("motion", pair.fastest_rate_per_second(), STEP_SECONDS_MAX)?;
        Ok(pair)
    }

    fn ports(&self) -> Ports {
        let current = |wire: &str| {
            let name = format!("{wire}_current_amperes");
            Port::input(&name, [0.0, 1.0]).with_comment(&format!("Current through the {wire}."))
        };
        let temperature = |wire: &str| {
            let name = format!("{wire}_temperature_celsius");
            Port::output(&name, [-273.15, 327.67])
                .in_steps(1e2)
                .with_comment(&format!("Temperature of the {wire}."))
        };
        let tension = |wire: &str| {
            let name = format!("{wire}_tension_newtons");
            Port::output(&name, [0.0, 655.35])
                .in_steps(1e2)
                .with_comment(&format!("Tension of the {wire}; 0 where it is slack."))
        };
        let turns = |wire: &str| turns_not_remembered(&format!("{wire}_turns_not_remembered"));
        let stop = self.stop_degrees;
        Ports {
            inputs: vec![
                current("flexor"),
                current("extensor"),
                Port::input("convection_factor", [0.0, 32.767])
                    .resting_at(1.0)
                    .with_comment("Multiplies the convection to the air."),
                Port::input("added_load_kilograms", [0.0, 3.276_7])
                    .with_comment("Hangs on the pulley and pulls towards the extensor's side."),
            ],
            outputs: vec![
                Port::output("angle_degrees", [-stop, stop])
                    .with_comment("Angle of the joint, towards the flexor's side."),
                temperature("flexor"),
                tension("flexor"),
                temperature("extensor"),
                tension("extensor"),
                Port::output("speed_degrees_per_second", [-3_276.8, 3_276.7])
                    .in_steps(10.0)
                    .with_comment("Speed of the joint."),
                turns("flexor"),
                turns("extensor"),
            ],
        }
    }

    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        let acting = self.acting(inputs);
        let step = |step_seconds| self.advance(step_seconds, &acting);
        in_equal_steps(duration_seconds, STEP_SECONDS_MAX, STEP_EXCESS, step);
    }

    fn read(&self, outputs: &mut [f64]) {
        let celsius = |place: usize| self.wires[place].temperature_celsius;
        let tension =
            |place: usize| self.tension_newtons(place, celsius(place), self.angle_radians);
        let turns = |place: usize| f64::from(self.wires[place].phase.turns_not_remembered());
        outputs.copy_from_slice(&[
            self.angle_radians.to_degrees(),
            celsius(FLEXOR),
            tension(FLEXOR),
            celsius(EXTENSOR),
            tension(EXTENSOR),
            self.speed_radians_per_second.to_degrees(),
            turns(FLEXOR),
            turns(EXTENSOR),
        ]);
    }

    fn heated_celsius(&self, input: usize) -> Option<f64> {
        let wire = self.wires.get(input)?;
        Some(wire.temperature_celsius)
    }

    fn conducts(&self, input: usize) -> bool {
        let wire = self.wires.get(input);
        wire.is_none_or(|wire| !wire.condition.is_wire_broken)
    }

    fn set_condition(&mut self, input: usize, faults: &Faults, time_seconds: f64) {
        if let Some(wire) = self.wires.get_mut(input) {
            wire.condition = Condition::at(faults, time_seconds);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::tests::faults;

    fn pair() -> SmaPair {
        SmaPair::new(&Config::default()).unwrap()
    }

    fn read(pair: &SmaPair) -> [f64; 8] {
        let mut outputs = [0.0; 8];
        pair.read(&mut outputs);
        outputs
    }

    /// Advances under the currents of flexor and extensor in still air.
    fn run(pair: &mut SmaPair, seconds: f64, [flexor, extensor]: [f64; 2], load: f64) {
        pair.step(seconds, &[flexor, extensor, 1.0, load]);
    }

    #[test]
    fn each_wire_turns_the_joint_its_way_and_the_other_one_is_slack() {
        for (currents, sign) in [([0.8, 0.0], 1.0), ([0.0, 0.8], -1.0)] {
            let mut pair = pair();
            run(&mut pair, 5.0, currents, 0.0);
            let [angle, _, flexor, _, extensor, ..] = read(&pair);
            assert!(angle * sign > 30.0, "{angle}");
            let slack = if sign > 0.0 { extensor } else { flexor };
            // In the end both tensions are equal and almost zero.
            assert!(slack < 0.05, "{slack}");
        }
    }

    #[test]
    fn both_wires_alike_hold_the_joint_in_its_middle_and_stiffen_it() {
        let bent = |current| {
            let mut pair = pair();
            run(&mut pair, 5.0, [current, current], 0.0);
            assert!(read(&pair)[0].abs() < 1e-9);
            run(&mut pair, 5.0, [current, current], 0.2);
            read(&pair)[0].abs()
        };
        let (soft, stiff) = (bent(0.6), bent(0.8));
        assert!(stiff < soft && soft > 0.0, "{soft} {stiff}");
    }

    #[test]
    fn a_broken_wire_pulls_and_conducts_no_more() {
        let mut pair = pair();
        let faults = faults("[[fault.plant.broken_wire]]\nfrom_seconds = 1.0\n");
        pair.set_condition(FLEXOR, &faults, 0.5);
        assert!(pair.conducts(FLEXOR) && pair.conducts(EXTENSOR));
        run(&mut pair, 5.0, [0.8, 0.0], 0.0);
        pair.set_condition(FLEXOR, &faults, 1.5);
        assert!(!pair.conducts(FLEXOR) && pair.conducts(EXTENSOR));
        assert_eq!(read(&pair)[2], 0.0);
    }

    #[test]
    fn many_short_steps_come_to_the_same_as_one_long_one() {
        let (mut short, mut long) = (pair(), pair());
        for _ in 0..2000 {
            run(&mut short, 1e-3, [0.7, 0.2], 0.05);
        }
        run(&mut long, 2.0, [0.7, 0.2], 0.05);
        for (short, long) in read(&short).into_iter().zip(read(&long)) {
            assert!((short - long).abs() < 1e-6, "{short} {long}");
        }
    }

    #[test]
    fn a_joint_that_is_too_fast_is_refused() {
        let config = Config {
            inertia_kilogram_square_metres: 1e-8,
            ..Config::default()
        };
        let error = SmaPair::new(&config).unwrap_err().to_string();
        assert!(error.starts_with("motion changes at up to"), "{error}");
    }
}
