//! A current profile by scenario time, without feedback.

use scenario::controller::OpenLoop as Config;
use scenario::profile::Profile;
use scenario::reference::SetPoint;

use crate::law::{Command, ControlLaw, Measurement, limited_current};

/// The profile, ready to be asked every cycle.
#[derive(Clone, Debug)]
pub struct OpenLoop {
    profile: Profile,
}

impl ControlLaw for OpenLoop {
    const NAME: &'static str = "open_loop";
    type Config = Config;
    type State = ();

    fn new(config: &Config) -> Self {
        Self {
            profile: config.profile(),
        }
    }

    fn start(&self) {}

    fn step(&self, (): &mut (), measurement: &Measurement, _: &SetPoint, _: f64) -> Command {
        Command {
            current_amperes: limited_current(
                self.profile.current_at(measurement.scenario_time_seconds),
            ),
            ..Command::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::controller::CurrentStep;

    #[test]
    fn profile_is_played_by_time_and_limited() {
        let step = |at_seconds, current_amperes| CurrentStep {
            at_seconds,
            current_amperes,
        };
        let law = OpenLoop::new(&Config {
            step: vec![step(1.0, 0.62), step(2.0, 1.7)],
            ..Config::default()
        });
        let current = |scenario_time_seconds| {
            let measurement = Measurement {
                scenario_time_seconds,
                position_metres: f64::NAN,
            };
            law.step(&mut (), &measurement, &SetPoint::default(), 1e-3)
                .current_amperes
        };
        assert_eq!([current(0.5), current(1.0), current(2.5)], [0.0, 0.62, 1.0]);
    }
}
