//! PID on the position error; the output is a current, the derivative acts on the filtered measurement.

use scenario::controller::Pid as Config;
use scenario::reference::SetPoint;

use crate::law::{CommandRange, Cycle, Law, LoopReads, Port, Ports, flag, one_loop};

/// Limit of the position, in metres or in the loop's own unit; it keeps results finite and is beyond any rig.
const POSITION_MAX: f64 = 1e6;

/// Measured and filtered position, in metres or in the loop's own unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct FilteredPosition {
    latest: f64,
    filtered: f64,
    started: bool,
}

impl FilteredPosition {
    /// Takes a measurement. If it is no number, the previous one stays.
    fn measure(&mut self, position: f64) {
        if position.is_finite() {
            self.latest = position.clamp(-POSITION_MAX, POSITION_MAX);
        }
        if !self.started {
            self.filtered = self.latest;
            self.started = true;
        }
    }

    /// Filters the position to first order, and returns the velocity of the filtered position. For a ramp it is the
    /// slope.
    fn velocity(&mut self, pole_radians_per_second: f64, period_seconds: f64) -> f64 {
        let share = 1.0 - libm::exp(-pole_radians_per_second * period_seconds);
        let step = share * (self.latest - self.filtered);
        self.filtered += step;
        step / period_seconds
    }
}

/// The gains.
#[derive(Clone, Debug)]
pub struct Pid {
    config: Config,
    pub(super) current: CommandRange,
}

/// State of the law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    integral_amperes: f64,
    position: FilteredPosition,
}

impl Pid {
    /// Returns `Kp (b r − y)`.
    fn proportional(&self, state: &State, set_point: &SetPoint) -> f64 {
        let weighted = self.config.set_point_weight * set_point.position;
        self.config.proportional * (weighted - state.position.latest)
    }

    /// Returns the current before its limitation to the drive's range, and the velocity of the filtered position.
    pub fn wanted_amperes(
        &self,
        state: &mut State,
        cycle: &Cycle,
        reads: &LoopReads,
    ) -> (f64, f64) {
        let LoopReads {
            position,
            set_point,
        } = reads;
        state.position.measure(*position);
        let pole = self.config.derivative_filter_radians_per_second;
        let velocity = state.position.velocity(pole, cycle.period_seconds);
        let error = set_point.position - state.position.latest;
        let current = self.proportional(state, set_point) + state.integral_amperes
            - self.config.derivative * velocity;
        self.integrate(state, error, current, cycle.period_seconds);
        (current, velocity)
    }

    /// Integrates the error, unless that moves the command further beyond its limit (conditional integration).
    fn integrate(&self, state: &mut State, error: f64, command: f64, period_seconds: f64) {
        let CommandRange { min, max, .. } = self.current;
        let winds_up = (command >= max && error > 0.0) || (command <= min && error < 0.0);
        if !winds_up && error.is_finite() {
            state.integral_amperes += self.config.integral * error * period_seconds;
        }
    }
}

impl Law for Pid {
    const NAME: &'static str = "pid";
    type Config = Config;
    type State = State;

    fn new(config: &Config, commands: &[CommandRange]) -> Self {
        Self {
            config: config.clone(),
            current: commands[0],
        }
    }

    fn ports(&self) -> Ports {
        let on_stop =
            Port::flag("saturation_on_stop").with_comment("What the loop measures is 0 or below.");
        one_loop::<Self>(terms().into_iter().chain([on_stop]))
    }

    fn start(&self) -> State {
        State::default()
    }

    fn step(&self, state: &mut State, cycle: &Cycle, reads: &[f64], writes: &mut [f64]) {
        let reads = LoopReads::of(reads);
        let set_point = reads.set_point;
        let (current, velocity) = self.wanted_amperes(state, cycle, &reads);
        writes.copy_from_slice(&[
            self.current.limited(current),
            set_point.position,
            set_point.velocity,
            velocity,
            flag(current > self.current.max),
            flag(current < self.current.min),
            flag(state.position.latest <= 0.0),
        ]);
    }
}

/// Returns the terms of the PID laws.
pub(super) fn terms() -> [Port; 5] {
    [
        Port::position_term("reference_{signal}_{unit}")
            .with_comment("Set-point that the law follows."),
        Port::position_term("reference_velocity_{unit}_per_second")
            .with_comment("Derivative of the set-point."),
        Port::position_term("estimated_velocity_{unit}_per_second")
            .with_comment("Derivative of the filtered measurement."),
        Port::flag("saturation_upper_limit").with_comment("The law wants more than there is."),
        Port::flag("saturation_lower_limit").with_comment("The law wants less than there is."),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::{CYCLE, hold};

    fn law(proportional: f64, integral: f64, derivative: f64) -> Pid {
        let config = Config {
            proportional,
            integral,
            derivative,
            set_point_weight: 1.0,
            derivative_filter_radians_per_second: 100.0,
        };
        Pid::new(&config, &[CommandRange::default()])
    }

    fn step(law: &Pid, state: &mut State, position: f64, target: f64) -> f64 {
        let reads = LoopReads {
            position,
            set_point: hold(target),
        };
        let mut writes = [0.0; 7];
        law.step(state, &CYCLE, &reads.values(), &mut writes);
        writes[0]
    }

    #[test]
    fn proportional_and_integral_parts() {
        let law = law(20.0, 100.0, 0.0);
        let mut state = law.start();
        assert!((step(&law, &mut state, 0.01, 0.02) - 0.2).abs() < 1e-12);
        for _ in 0..99 {
            step(&law, &mut state, 0.01, 0.02);
        }
        assert!((step(&law, &mut state, 0.01, 0.02) - 0.3).abs() < 1e-3);
    }

    #[test]
    fn derivative_acts_on_the_measurement_not_on_the_set_point() {
        let law = law(0.0, 0.0, 1.0);
        let mut state = law.start();
        step(&law, &mut state, 0.02, 0.02);
        assert_eq!(step(&law, &mut state, 0.02, 0.04), 0.0);
        let current = step(&law, &mut state, 0.015, 0.04);
        assert!(current > 0.4, "{current}");
    }

    #[test]
    fn saturation_does_not_wind_up() {
        let law = law(20.0, 100.0, 0.0);
        let mut state = law.start();
        for _ in 0..10_000 {
            assert_eq!(step(&law, &mut state, 0.0, 0.055), 1.0);
        }
        assert!(state.integral_amperes <= 0.01, "{}", state.integral_amperes);
        for _ in 0..10_000 {
            assert_eq!(step(&law, &mut state, 0.055, 0.0), 0.0);
        }
        assert!(
            state.integral_amperes >= -0.01,
            "{}",
            state.integral_amperes
        );
    }

    #[test]
    fn a_drive_both_ways_brakes_and_does_not_wind_up_below() {
        let mut law = law(20.0, 100.0, 0.0);
        law.current.min = -0.5;
        let mut state = law.start();
        assert!((step(&law, &mut state, 0.02, 0.01) + 0.2).abs() < 1e-12);
        for _ in 0..10_000 {
            assert!(step(&law, &mut state, 0.055, 0.0) >= -0.5);
        }
        assert!(state.integral_amperes >= -0.51, "{state:?}");
    }

    #[test]
    fn a_missing_sample_repeats_the_last() {
        let law = law(20.0, 0.0, 0.0);
        let mut state = law.start();
        let before = step(&law, &mut state, 0.01, 0.02);
        assert_eq!(step(&law, &mut state, f64::NAN, 0.02), before);
    }

    #[test]
    fn the_velocity_of_a_ramp_is_its_slope() {
        for (periods, period_seconds) in [(5000, 1e-4), (500, 1e-3), (50, 1e-2)] {
            let mut position = FilteredPosition::default();
            let mut velocity = 0.0;
            for period in 0..periods {
                position.latest = 0.1 * f64::from(period) * period_seconds;
                velocity = position.velocity(100.0, period_seconds);
            }
            assert!(
                (velocity - 0.1).abs() < 1e-9,
                "{period_seconds}: {velocity}"
            );
        }
    }
}
