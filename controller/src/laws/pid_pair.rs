//! PID for two antagonistic drives. The output is added to the current of the first one and subtracted from that of the
//! second. Both always carry a base current, which stiffens them (co-contraction).

use scenario::controller::PidPair as Config;

use super::pid::{Pid, State, terms};
use crate::law::{CommandRange, Cycle, Law, LoopReads, Ports, flag, one_loop};

/// The gains.
#[derive(Clone, Debug)]
pub struct PidPair {
    /// Its range ends where a drive reaches the smaller one of the two largest currents; beyond it the integral rests.
    pid: Pid,
    co_contraction: f64,
    currents: [CommandRange; 2],
}

impl Law for PidPair {
    const NAME: &'static str = "pid_pair";
    const DRIVES: Option<usize> = Some(2);
    type Config = Config;
    type State = State;

    fn new(config: &Config, commands: &[CommandRange]) -> Self {
        let [first, second] = [commands[0], commands[1]];
        let output_max = first.max.min(second.max) - config.co_contraction;
        let output = CommandRange {
            min: -output_max,
            max: output_max,
            ..first
        };
        let gains = scenario::controller::Pid {
            proportional: config.proportional,
            integral: config.integral,
            derivative: config.derivative,
            set_point_weight: 1.0,
            derivative_filter_radians_per_second: config.derivative_filter_radians_per_second,
        };
        Self {
            pid: Pid::new(&gains, &[output]),
            co_contraction: config.co_contraction,
            currents: [first, second],
        }
    }

    fn ports(&self) -> Ports {
        one_loop::<Self>(terms())
    }

    fn start(&self) -> State {
        State::default()
    }

    fn step(&self, state: &mut State, cycle: &Cycle, reads: &[f64], writes: &mut [f64]) {
        let reads = LoopReads::of(reads);
        let set_point = reads.set_point;
        let (output, velocity) = self.pid.wanted_amperes(state, cycle, &reads);
        let CommandRange { min, max, .. } = self.pid.current;
        let both = self.co_contraction;
        writes.copy_from_slice(&[
            self.currents[0].limited(both + output),
            self.currents[1].limited(both - output),
            set_point.position,
            set_point.velocity,
            velocity,
            flag(output > max),
            flag(output < min),
        ]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::{CYCLE, hold};

    fn currents(position: f64, wanted: f64) -> [f64; 2] {
        let law = PidPair::new(&Config::default(), &[CommandRange::default(); 2]);
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
