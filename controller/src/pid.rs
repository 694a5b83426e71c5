//! PID on the position error; the output is a current, the derivative acts on the filtered measurement.

use scenario::controller::Pid as Config;
use scenario::reference::SetPoint;

use crate::law::{
    CURRENT_AMPERES_MAX, Command, ControlLaw, Explanation, Measurement, Saturation, limited_current,
};

/// The gains.
#[derive(Clone, Debug)]
pub struct Pid {
    config: Config,
}

/// The law's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    integral_amperes: f64,
    filtered_position_metres: f64,
    last_position_metres: f64,
    started: bool,
}

impl Pid {
    /// A PID law with these gains.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        Self {
            config: config.clone(),
        }
    }

    /// First-order filter of the position; gives the filtered velocity.
    fn velocity(&self, state: &mut State, period_seconds: f64) -> f64 {
        let pole = self.config.derivative_filter_radians_per_second;
        let share = 1.0 - libm::exp(-pole * period_seconds);
        let difference = state.last_position_metres - state.filtered_position_metres;
        state.filtered_position_metres += share * difference;
        pole * difference
    }

    /// Integrates the error unless that would push the command further beyond its limit (conditional integration).
    fn integrate(&self, state: &mut State, error: f64, command: f64, period_seconds: f64) {
        let winds_up =
            (command >= CURRENT_AMPERES_MAX && error > 0.0) || (command <= 0.0 && error < 0.0);
        if !winds_up {
            state.integral_amperes +=
                self.config.integral_amperes_per_metre_second * error * period_seconds;
        }
    }
}

impl ControlLaw for Pid {
    type State = State;

    fn start(&self) -> State {
        State::default()
    }

    fn step(
        &self,
        state: &mut State,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command {
        if measurement.position_metres.is_finite() {
            state.last_position_metres = measurement.position_metres;
        }
        if !state.started {
            state.filtered_position_metres = state.last_position_metres;
            state.started = true;
        }
        let velocity = self.velocity(state, period_seconds);
        let error = set_point.position_metres - state.last_position_metres;
        let current = self.config.proportional_amperes_per_metre * error + state.integral_amperes
            - self.config.derivative_ampere_seconds_per_metre * velocity;
        self.integrate(state, error, current, period_seconds);
        Command {
            current_amperes: limited_current(current),
            explanation: Explanation {
                reference_position_metres: set_point.position_metres,
                reference_velocity_metres_per_second: set_point.velocity_metres_per_second,
                estimated_velocity_metres_per_second: velocity,
                saturation: Saturation {
                    at_upper_limit: current > CURRENT_AMPERES_MAX,
                    at_lower_limit: current < 0.0,
                    on_stop: state.last_position_metres <= 0.0,
                },
                ..Explanation::default()
            },
        }
    }
}
