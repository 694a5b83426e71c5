//! A current profile by scenario time, without feedback.

use scenario::controller::OpenLoop as Config;
use scenario::reference::Trajectory;

use crate::law::{CommandRange, Cycle, Law, Ports, one_loop};

/// The profile, prepared for the query of each cycle.
#[derive(Clone, Debug)]
pub struct OpenLoop {
    profile: Trajectory,
    current: CommandRange,
}

impl Law for OpenLoop {
    const NAME: &'static str = "open_loop";
    type Config = Config;
    type State = ();

    fn new(config: &Config, commands: &[CommandRange]) -> Self {
        Self {
            profile: config.profile(),
            current: commands[0],
        }
    }

    fn ports(&self) -> Ports {
        one_loop::<Self>([])
    }

    fn start(&self) {}

    fn step(&self, (): &mut (), cycle: &Cycle, _: &[f64], writes: &mut [f64]) {
        let wanted = self.profile.at(cycle.scenario_time_seconds).position;
        writes[0] = self.current.limited(wanted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::CYCLE;
    use scenario::controller::CurrentStep;

    #[test]
    fn profile_is_played_by_time_and_limited() {
        let step = |at_seconds, current| CurrentStep {
            at_seconds,
            current,
        };
        let config = Config {
            step: vec![step(1.0, 0.62), step(2.0, 1.7)],
            ..Config::default()
        };
        let law = OpenLoop::new(&config, &[CommandRange::default()]);
        let current = |scenario_time_seconds| {
            let cycle = Cycle {
                scenario_time_seconds,
                ..CYCLE
            };
            let mut writes = [0.0];
            law.step(&mut (), &cycle, &[], &mut writes);
            writes[0]
        };
        assert_eq!([current(0.5), current(1.0), current(2.5)], [0.0, 0.62, 1.0]);
    }
}
