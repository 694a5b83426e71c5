//! A current profile by scenario time, without feedback.

use scenario::controller::OpenLoop as Config;
use scenario::reference::SetPoint;

use crate::law::{Command, ControlLaw, Measurement, limited_current};

/// A piece of the profile: from its start the current moves to its value until its end; a step has no length.
#[derive(Clone, Copy, Debug)]
struct Piece {
    from_seconds: f64,
    until_seconds: f64,
    current_amperes: f64,
}

/// The profile, ordered by time.
#[derive(Clone, Debug)]
pub struct OpenLoop {
    pieces: Vec<Piece>,
}

impl OpenLoop {
    /// Orders the pieces of the profile by time.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let steps = config.step.iter().map(|step| Piece {
            from_seconds: step.at_seconds,
            until_seconds: step.at_seconds,
            current_amperes: step.current_amperes,
        });
        let ramps = config.ramp.iter().map(|ramp| Piece {
            from_seconds: ramp.from_seconds,
            until_seconds: ramp.until_seconds,
            current_amperes: ramp.current_amperes,
        });
        let mut pieces: Vec<Piece> = steps.chain(ramps).collect();
        pieces.sort_by(|a, b| a.from_seconds.total_cmp(&b.from_seconds));
        Self { pieces }
    }

    /// The current at a time; 0 before the first piece.
    #[must_use]
    pub fn current_amperes(&self, seconds: f64) -> f64 {
        self.pieces
            .iter()
            .take_while(|piece| piece.from_seconds <= seconds)
            .fold(0.0, |before, piece| piece.current_after(before, seconds))
    }
}

impl Piece {
    fn current_after(&self, before: f64, seconds: f64) -> f64 {
        if seconds >= self.until_seconds {
            return self.current_amperes;
        }
        let share = (seconds - self.from_seconds) / (self.until_seconds - self.from_seconds);
        before + (self.current_amperes - before) * share
    }
}

impl ControlLaw for OpenLoop {
    type State = ();

    fn start(&self) {}

    fn step(&self, (): &mut (), measurement: &Measurement, _: &SetPoint, _: f64) -> Command {
        Command {
            current_amperes: limited_current(self.current_amperes(measurement.scenario_time_seconds)),
            ..Command::default()
        }
    }
}
