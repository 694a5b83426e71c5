//! PID for two drives that pull against each other: what the error asks for is added to the current of the first one and taken from
//! that of the second, and both have some current always, which makes them hold stiff (co-contraction).

use scenario::controller::PidPair as Config;
use scenario::reference::SetPoint;

use crate::filtered_position::FilteredPosition;
use crate::law::{
    CURRENT_AMPERES_MAX, Explanation, LawOfSeveral, Measurement, Saturation, limited_current,
};

/// The gains.
#[derive(Clone, Debug)]
pub struct PidPair {
    config: Config,
}

/// The law's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    integral_amperes: f64,
    position: FilteredPosition,
}

impl PidPair {
    /// The output at which one drive has all the current that there is, whatever the other has.
    fn output_max(&self) -> f64 {
        CURRENT_AMPERES_MAX - self.config.co_contraction_amperes
    }
}

impl LawOfSeveral for PidPair {
    const NAME: &'static str = "pid_pair";
    const DRIVES: usize = 2;
    type Config = Config;
    type State = State;

    fn new(config: &Config) -> Self {
        Self {
            config: config.clone(),
        }
    }

    fn start(&self) -> State {
        State::default()
    }

    fn step(
        &self,
        state: &mut State,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
        currents_amperes: &mut [f64],
    ) -> Explanation {
        state.position.measure(measurement.position_metres);
        let pole = self.config.derivative_filter_radians_per_second;
        let velocity = state.position.velocity(pole, period_seconds);
        let error = set_point.position_metres - state.position.latest();
        let output = self.config.proportional_amperes_per_metre * error + state.integral_amperes
            - self.config.derivative_ampere_seconds_per_metre * velocity;
        let max = self.output_max();
        let winds_up = (output >= max && error > 0.0) || (output <= -max && error < 0.0);
        if !winds_up && error.is_finite() {
            let gain = self.config.integral_amperes_per_metre_second;
            state.integral_amperes += gain * error * period_seconds;
        }
        let both = self.config.co_contraction_amperes;
        for (current, wanted) in currents_amperes
            .iter_mut()
            .zip([both + output, both - output])
        {
            *current = limited_current(wanted);
        }
        Explanation {
            reference_position_metres: set_point.position_metres,
            reference_velocity_metres_per_second: set_point.velocity_metres_per_second,
            estimated_velocity_metres_per_second: velocity,
            saturation: Saturation {
                at_upper_limit: output > max,
                at_lower_limit: output < -max,
                on_stop: false,
            },
            ..Explanation::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn currents(position: f64, wanted: f64) -> [f64; 2] {
        let law = PidPair::new(&Config::default());
        let mut state = law.start();
        let measurement = Measurement {
            scenario_time_seconds: 0.0,
            position_metres: position,
        };
        let set_point = SetPoint {
            position_metres: wanted,
            ..SetPoint::default()
        };
        let mut currents = [0.0; 2];
        law.step(&mut state, &measurement, &set_point, 1e-3, &mut currents);
        currents
    }

    #[test]
    fn one_pulls_more_by_what_the_other_pulls_less() {
        assert_eq!(currents(3.0, 3.0), [0.5, 0.5]);
        assert_eq!(currents(0.0, 10.0), [0.7, 0.3]);
        assert_eq!(currents(10.0, 0.0), [0.3, 0.7]);
        assert_eq!(currents(-90.0, 90.0), [1.0, 0.0]);
    }

    #[test]
    fn nothing_but_currents_comes_out() {
        for position in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX] {
            let currents = currents(position, 5.0);
            let are_sound = currents.iter().all(|current| (0.0..=1.0).contains(current));
            assert!(are_sound, "{currents:?}");
        }
    }
}
