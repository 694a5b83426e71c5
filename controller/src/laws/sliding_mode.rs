//! Sliding mode on the nominal model, Eq. (13) and (14) with PAPER E3 to E5, fed by the observer, fast in a move and calm in a
//! hold.

use scenario::controller::SlidingMode as Config;
use scenario::reference::SetPoint;

use crate::law::{CommandRange, Cycle, Law, LoopReads, Port, Ports, Width, flag, one_loop};
use crate::mode::{self, Course, Modes};
use crate::nominal_model::{LocalModel, NominalModel, State as ModelState};
use crate::observer::{self, Observer};
use crate::reference_filter::{self, JerkRange, Point, Reference, ReferenceFilter};

/// Number of steps in which the published caution is resolved.
const BACK_OFF_STEPS: f64 = 31.0;

/// The law's constants.
#[derive(Clone, Debug)]
pub struct SlidingMode {
    surface: Surface,
    modes: Modes,
    observer: Observer,
    reference_filter: ReferenceFilter,
    current: CommandRange,
}

/// State of the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    mode: mode::State,
    observer: observer::State,
    reference: reference_filter::State,
    squared_current: f64,
    sliding_variable: f64,
}

/// The sliding surface and its gains, Eq. (14).
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// `λ` in 1/s.
    pub bandwidth: f64,
    /// `φ` in m/s².
    pub boundary_layer: f64,
    /// `KSM` in m/s³.
    pub switching_gain: f64,
}

/// Jerk that the surface requires.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WantedJerk {
    /// `s` in m/s².
    pub sliding_variable: f64,
    /// Jerk that keeps the state on the surface, in m/s³.
    pub equivalent: f64,
    /// Jerk that leads to the surface, in m/s³.
    pub switching: f64,
}

impl Surface {
    /// Returns `s = x̃″ + 2λ x̃′ + λ² x̃`, and `x⃛d − 2λ x̃″ − λ² x̃′ − KSM sat(s/φ)` in its two parts, Eq. (14) with
    /// PAPER E4.
    pub fn wanted_jerk(&self, position: &Point, reference: &Reference) -> WantedJerk {
        let lambda = self.bandwidth;
        let error = position.position_metres - reference.point.position_metres;
        let error_rate =
            position.velocity_metres_per_second - reference.point.velocity_metres_per_second;
        let error_acceleration = position.acceleration_metres_per_second_squared
            - reference.point.acceleration_metres_per_second_squared;
        let sliding_variable = error_acceleration + (2.0 * error_rate + lambda * error) * lambda;
        let saturated = (sliding_variable / self.boundary_layer).clamp(-1.0, 1.0);
        WantedJerk {
            sliding_variable,
            equivalent: reference.jerk_metres_per_second_cubed
                - (2.0 * error_acceleration + lambda * error_rate) * lambda,
            switching: -self.switching_gain * saturated,
        }
    }

    /// Returns `ẍd − 2λ x̃′ − λ² x̃`, Eq. (14) as it is printed.
    pub(super) fn as_printed(&self, position: &Point, reference: &Reference) -> f64 {
        let lambda = self.bandwidth;
        let error = position.position_metres - reference.point.position_metres;
        let error_rate =
            position.velocity_metres_per_second - reference.point.velocity_metres_per_second;
        reference.point.acceleration_metres_per_second_squared
            - (2.0 * error_rate + lambda * error) * lambda
    }

    /// Returns the surface with another `λ` and a proportional `KSM`, which keeps the tuning in proportion.
    fn with_bandwidth(&self, bandwidth: f64) -> Self {
        Self {
            bandwidth,
            switching_gain: self.switching_gain * bandwidth / self.bandwidth,
            ..*self
        }
    }
}

impl SlidingMode {
    /// Returns the jerks that a launched reference may have off the stop: those between no and full current after the
    /// law's own correction. Only the side towards the target is bounded, so a load that cannot be braked does not move
    /// the reference.
    fn followable(
        &self,
        reference: &mut reference_filter::State,
        surface: &Surface,
        local: &LocalModel<'_>,
        position: &Point,
        set_point: &SetPoint,
        seconds: f64,
    ) -> JerkRange {
        let target = self.reference_filter.target(reference, set_point);
        let rises = target >= reference.point.position_metres;
        let wanted = surface.wanted_jerk(position, &Reference::without_jerk(reference.point));
        let ahead = wanted.sliding_variable;
        reference.notice_lag(if rises { -ahead } else { ahead }, seconds);
        let correction = wanted.equivalent + wanted.switching;
        let jerk_at = |squared_current| local.jerk(squared_current) - correction;
        let mut followable = JerkRange::UNLIMITED;
        if rises {
            followable.max = jerk_at(self.current.max * self.current.max);
        } else {
            followable.min = jerk_at(0.0);
        }
        followable
    }
}

impl Law for SlidingMode {
    const NAME: &'static str = "sliding_mode";
    type Config = Config;
    type State = State;

    fn new(config: &Config, commands: &[CommandRange]) -> Self {
        let model = NominalModel::new(&config.nominal_model);
        Self {
            surface: Surface {
                bandwidth: config.bandwidth_radians_per_second,
                boundary_layer: config.boundary_layer_metres_per_second_squared,
                switching_gain: config.switching_gain_metres_per_second_cubed,
            },
            reference_filter: ReferenceFilter {
                poles_radians_per_second_max: config.reference_filter_radians_per_second_max,
                launch_jerk_metres_per_second_cubed: config
                    .reference_launch_jerk_metres_per_second_cubed,
                lag_max: config.boundary_layer_metres_per_second_squared,
                landing_ratio: config.reference_landing_ratio,
                position_metres_max: model.set_point_metres_max(),
            },
            modes: Modes::new(config),
            observer: Observer::new(&config.observer, model),
            current: commands[0],
        }
    }

    fn ports(&self) -> Ports {
        let [estimates @ .., equivalent, switching] = terms();
        let own = [
            Port::flag("saturation_on_stop").with_comment("The load rests on its stop."),
            Port::output("saturation_back_off", [0.0, BACK_OFF_STEPS])
                .counted(Width::Unsigned(5), 1.0)
                .with_comment("How far the law backs off since it rings; 31 is all the way."),
        ];
        let terms = estimates.into_iter().chain(own);
        one_loop::<Self>(terms.chain([equivalent, switching]))
    }

    fn objection(&self) -> Option<(&'static str, String)> {
        self.observer.model.objection()
    }

    fn start(&self) -> State {
        State {
            mode: mode::State::default(),
            observer: self.observer.start(),
            reference: reference_filter::State::default(),
            squared_current: 0.0,
            sliding_variable: 0.0,
        }
    }

    fn step(&self, state: &mut State, cycle: &Cycle, reads: &[f64], writes: &mut [f64]) {
        let LoopReads {
            position: position_metres,
            set_point,
        } = LoopReads::of(reads);
        let period_seconds = cycle.period_seconds;
        let model = &self.observer.model;
        let aim = &state.reference.point;
        let course = Course {
            error_metres: position_metres - aim.position_metres,
            velocity_metres_per_second: aim.velocity_metres_per_second,
            sliding_variable: state.sliding_variable,
            sensor_jumps: self.observer.sensor_jumps(&state.observer, position_metres),
        };
        let settings = self.modes.step(&mut state.mode, &course, period_seconds);
        let surface = self.surface.with_bandwidth(settings.bandwidth);
        self.observer.step(
            &mut state.observer,
            &settings,
            position_metres,
            state.squared_current,
            period_seconds,
        );
        let estimate = state.observer.model;
        let position = point_of(model, &estimate);
        let on_stop = model.rests_on_stop(&estimate);
        let local = model
            .at(&estimate, position.acceleration_metres_per_second_squared)
            .livelier(state.observer.liveliness(&settings));
        state.reference.caution = settings.caution;
        state.reference.memory = state.observer.memory;
        let followable = if on_stop {
            // The reference waits on the stop until the load lifts.
            state.reference = reference_filter::State::default();
            JerkRange::UNLIMITED
        } else {
            self.followable(
                &mut state.reference,
                &surface,
                &local,
                &position,
                &set_point,
                period_seconds,
            )
        };
        let reference = self.reference_filter.step(
            &mut state.reference,
            &set_point,
            &followable,
            period_seconds,
        );
        let wanted = surface.wanted_jerk(&position, &reference);
        // A load that is to stay on the stop needs no current.
        let idle = on_stop && set_point.position <= 0.0;
        let squared_current = if idle {
            0.0
        } else {
            local.squared_current_for_jerk(wanted.equivalent + wanted.switching)
        };
        let [estimates @ .., equivalent, switching] = command(
            &self.current,
            &estimate,
            &reference,
            &wanted,
            local.squared_current_for_jerk(wanted.equivalent),
            squared_current,
        );
        state.sliding_variable = wanted.sliding_variable;
        state.squared_current = estimates[0] * estimates[0];
        let (first, last) = writes.split_at_mut(estimates.len());
        first.copy_from_slice(&estimates);
        let back_off = BACK_OFF_STEPS * settings.caution;
        last.copy_from_slice(&[flag(on_stop), back_off, equivalent, switching]);
    }
}

/// Returns position, velocity and acceleration of a model's state.
fn point_of(model: &NominalModel, state: &ModelState) -> Point {
    Point {
        position_metres: state.position_metres,
        velocity_metres_per_second: state.velocity_metres_per_second,
        acceleration_metres_per_second_squared: model.acceleration(state),
    }
}

/// Returns the terms of both laws with a nominal model, in the order in which [`command`] returns them after the
/// current.
pub(crate) fn terms() -> [Port; 10] {
    let term = Port::term;
    [
        Port::position_term("reference_{signal}_{unit}")
            .with_comment("Filtered reference position."),
        Port::position_term("reference_velocity_{unit}_per_second")
            .with_comment("Velocity of the filtered reference."),
        Port::output("estimated_temperature_celsius", [-273.15, 327.67])
            .counted(Width::Signed(16), 100.0)
            .with_comment("Estimated wire temperature."),
        Port::output("estimated_martensite_fraction", [0.0, 1.0])
            .counted(Width::Unsigned(16), 50_000.0)
            .with_comment("Estimated martensite fraction."),
        Port::position_term("estimated_velocity_{unit}_per_second")
            .with_comment("Estimated velocity of the load."),
        term("sliding_variable_metres_per_second_squared")
            .with_unit("metres_per_second_squared", "m/s^2")
            .with_comment("Sliding variable s."),
        Port::flag("saturation_upper_limit")
            .with_comment("The law wants more than the largest current."),
        Port::flag("saturation_lower_limit").with_comment("The law wants less than no current."),
        term("equivalent_part_amperes_squared")
            .with_unit("amperes_squared", "A^2")
            .with_comment("Equivalent part of the squared current."),
        term("switching_part_amperes_squared")
            .with_unit("amperes_squared", "A^2")
            .with_comment("Switching part of the squared current."),
    ]
}

/// Returns the current for a wanted `u = i²` within this range, and the [`terms`].
pub(crate) fn command(
    current: &CommandRange,
    estimate: &ModelState,
    reference: &Reference,
    wanted: &WantedJerk,
    equivalent_part: f64,
    squared_current: f64,
) -> [f64; 11] {
    [
        current.limited(libm::sqrt(squared_current.max(0.0))),
        reference.point.position_metres,
        reference.point.velocity_metres_per_second,
        estimate.temperature_celsius,
        estimate.martensite_fraction,
        estimate.velocity_metres_per_second,
        wanted.sliding_variable,
        flag(squared_current > current.max * current.max),
        flag(squared_current < 0.0),
        equivalent_part,
        squared_current - equivalent_part,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::{Row, hold, run, settling_and_overshoot};
    use scenario::controller::{Controller, NominalModel as ModelConfig};

    fn controller() -> Controller {
        Controller {
            sliding_mode: Some(Config::default()),
            ..Controller::default()
        }
    }

    fn step_run(plant: &ModelConfig) -> Vec<Row> {
        run(&controller(), plant, 5.0, |time| {
            hold(if time < 3.0 { 0.01 } else { 0.035 })
        })
    }

    #[test]
    fn on_the_surface_the_reference_jerk_is_wanted() {
        let surface = Surface {
            bandwidth: 40.0,
            boundary_layer: 1.6,
            switching_gain: 64.0,
        };
        let point = Point {
            position_metres: 0.02,
            velocity_metres_per_second: 0.1,
            acceleration_metres_per_second_squared: 1.0,
        };
        let reference = Reference {
            point,
            jerk_metres_per_second_cubed: 7.0,
        };
        let wanted = surface.wanted_jerk(&point, &reference);
        assert_eq!(
            (wanted.sliding_variable, wanted.equivalent, wanted.switching),
            (0.0, 7.0, 0.0)
        );
        let below = Point {
            position_metres: 0.01,
            ..point
        };
        let wanted = surface.wanted_jerk(&below, &reference);
        assert!((wanted.sliding_variable + 16.0).abs() < 1e-12);
        assert_eq!(wanted.switching, 64.0);
    }

    #[test]
    fn step_from_a_warm_hold_meets_its_target() {
        let rows = step_run(&ModelConfig::default());
        let (settling, overshoot) = settling_and_overshoot(&rows, 3.0, 0.01, 0.035);
        assert!((0.15..0.2).contains(&settling), "{settling}");
        assert!(overshoot < 0.6, "{overshoot}");
    }

    #[test]
    fn step_from_cold_meets_its_target() {
        let rows = run(&controller(), &ModelConfig::default(), 2.0, |_| hold(0.025));
        let (settling, overshoot) = settling_and_overshoot(&rows, 0.0, 0.0, 0.025);
        assert!((0.35..0.43).contains(&settling), "{settling}");
        assert!(overshoot < 1.0, "{overshoot}");
        assert_eq!(rows[100].term("saturation_on_stop"), 1.0);
        assert_eq!(rows[100].command(), 1.0);
    }

    #[test]
    fn step_on_a_plant_that_the_model_does_not_know_stays_stable() {
        let plant = ModelConfig {
            conduction_watts_per_metre_kelvin: 0.235,
            austenite_start_celsius: 56.0,
            martensite_start_celsius: 64.0,
            martensite_finish_celsius: 32.0,
            austenite_modulus_pascals: 66e9,
            load_kilograms: 0.038,
            damping_newton_seconds_per_metre: 0.4,
            ..ModelConfig::default()
        };
        let (settling, overshoot) = settling_and_overshoot(&step_run(&plant), 3.0, 0.01, 0.035);
        assert!(settling < 0.3, "{settling}");
        assert!(overshoot < 5.0, "{overshoot}");
    }

    #[test]
    fn sine_is_followed_within_a_sensor_step() {
        let omega = core::f64::consts::TAU / 5.0;
        let sine = |time: f64| SetPoint {
            position: 0.025 + 0.01 * libm::sin(omega * time),
            velocity: 0.01 * omega * libm::cos(omega * time),
            acceleration: -0.01 * omega * omega * libm::sin(omega * time),
            jerk: -0.01 * omega * omega * omega * libm::cos(omega * time),
            has_exact_derivatives: true,
        };
        let rows = run(&controller(), &ModelConfig::default(), 10.0, sine);
        let late = &rows[5000..];
        let error = |row: &Row| row.position_metres - sine(row.time_seconds).position;
        let square = late.iter().map(|row| error(row) * error(row)).sum::<f64>();
        let rms = libm::sqrt(square / 5000.0);
        assert!(rms < 5e-5, "{rms}");
    }

    #[test]
    fn infeasible_set_points_are_left_without_trace() {
        let rows = run(
            &controller(),
            &ModelConfig::default(),
            6.0,
            |time| match time {
                ..2.0 => hold(0.02),
                ..4.0 => hold(0.5),
                _ => hold(0.02),
            },
        );
        let (settling, _) = settling_and_overshoot(&rows, 4.0, 0.05, 0.02);
        assert!(settling < 1.0, "{settling}");
        assert!(rows.iter().all(|row| row.temperature_celsius < 110.0));
    }

    #[test]
    fn a_load_that_shall_stay_on_the_stop_gets_no_current() {
        let rows = run(&controller(), &ModelConfig::default(), 0.5, |_| hold(0.0));
        assert!(rows.iter().all(|row| row.command() == 0.0));
    }

    #[test]
    fn parts_add_up_to_the_command() {
        for row in step_run(&ModelConfig::default()) {
            let equivalent = row.term("equivalent_part_amperes_squared");
            let sum = equivalent + row.term("switching_part_amperes_squared");
            let current = row.command();
            assert!((current - libm::sqrt(sum.clamp(0.0, 1.0))).abs() <= 0.0005 + 1e-12);
            assert_eq!(row.term("saturation_upper_limit"), flag(sum > 1.0));
            assert_eq!(row.term("saturation_lower_limit"), flag(sum < 0.0));
        }
    }
}
