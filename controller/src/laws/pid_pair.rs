//! PID for two antagonistic drives. The output is added to the current of the first one and subtracted from that of the
//! second. Both always carry a base current, which stiffens them (co-contraction).

use scenario::controller::PidPair as Config;

use super::pid::terms;
use crate::filtered_position::FilteredPosition;
use crate::law::{CurrentRange, Cycle, Law, LoopReads, Ports, flag, one_loop};

/// The gains.
#[derive(Clone, Debug)]
pub struct PidPair {
    config: Config,
    currents: [CurrentRange; 2],
}

/// State of the law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    integral_amperes: f64,
    position: FilteredPosition,
}

impl PidPair {
    /// Returns the output at which a drive reaches the smaller one of the two largest currents.
    fn output_max(&self) -> f64 {
        let [first, second] = self.currents;
        first.max.min(second.max) - self.config.co_contraction
    }
}

impl Law for PidPair {
    const NAME: &'static str = "pid_pair";
    const DRIVES: Option<usize> = Some(2);
    type Config = Config;
    type State = State;

    fn new(config: &Config, currents: &[CurrentRange]) -> Self {
        Self {
            config: config.clone(),
            currents: [currents[0], currents[1]],
        }
    }

    fn ports(&self) -> Ports {
        one_loop::<Self>(terms())
    }

    fn start(&self) -> State {
        State::default()
    }

    fn step(&self, state: &mut State, cycle: &Cycle, reads: &[f64], writes: &mut [f64]) {
        let LoopReads {
            position,
            set_point,
        } = LoopReads::of(reads);
        state.position.measure(position);
        let pole = self.config.derivative_filter_radians_per_second;
        let velocity = state.position.velocity(pole, cycle.period_seconds);
        let error = set_point.position - state.position.latest();
        let output = self.config.proportional * error + state.integral_amperes
            - self.config.derivative * velocity;
        let max = self.output_max();
        let winds_up = (output >= max && error > 0.0) || (output <= -max && error < 0.0);
        if !winds_up && error.is_finite() {
            let gain = self.config.integral;
            state.integral_amperes += gain * error * cycle.period_seconds;
        }
        let both = self.config.co_contraction;
        writes.copy_from_slice(&[
            self.currents[0].limited(both + output),
            self.currents[1].limited(both - output),
            set_point.position,
            set_point.velocity,
            velocity,
            flag(output > max),
            flag(output < -max),
        ]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::{CYCLE, hold};

    fn currents(position: f64, wanted: f64) -> [f64; 2] {
        let law = PidPair::new(&Config::default(), &[CurrentRange::default(); 2]);
        let reads = LoopReads {
            position,
            set_point: hold(wanted),
        };
        let mut writes = [0.0; 7];
        law.step(&mut law.start(), &CYCLE, &reads.values(), &mut writes);
        [writes[0], writes[1]]
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
