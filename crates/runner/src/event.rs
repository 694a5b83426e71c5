//! What happens while scenarios are played: the one kind of message from runs to those who look on, such as the terminal.
//!
//! Commands that read a recording back need none of it: nothing happens meanwhile, so they print what they return.

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
    /// A scenario was played; now it is judged, and its files are written.
    Played {
        /// How often its frames or cycles are gone through for that.
        ways: u64,
    },
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

/// Who looks on.
pub trait Listener: Sync {
    fn on_event(&self, event: &RunEvent<'_>);
}
