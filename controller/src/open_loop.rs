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

impl OpenLoop {
    /// A law that plays this profile.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        Self {
            profile: config.profile(),
        }
    }
}

impl ControlLaw for OpenLoop {
    type State = ();

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
