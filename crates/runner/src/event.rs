//! What happens while scenarios are played, as those hear it who look on: the terminal, for one.

use std::path::Path;

use judge::verdict::Verdict;
use recording::progress::RunProgress;
use worlds::preflight::PreflightEvent;

use crate::run::Judged;

/// One thing that happened.
pub enum RunEvent<'a> {
    /// Something to know about the run: its bus, its clock, its rig, what the machine refuses.
    Note(String),
    /// A step of the pre-flight of an external drive.
    Preflight(&'a PreflightEvent),
    /// A scenario begins.
    Began {
        /// How long it is.
        duration_seconds: f64,
    },
    /// How far the scenario is. It comes from another thread.
    Reached(RunProgress),
    /// A scenario was played and judged.
    Judged {
        /// Its file.
        path: &'a Path,
        /// What came of it.
        judged: &'a Judged,
    },
    /// Something went wrong that ends no other scenario.
    Failed(String),
    /// All scenarios were played.
    Ended(&'a [Verdict]),
}

/// Whoever hears of it.
pub trait Listener: Sync {
    /// Hears of one thing.
    fn hear(&self, event: &RunEvent<'_>);
}
