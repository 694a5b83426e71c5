//! Events while scenarios are played: the only kind of message from runs to their listeners, such as the terminal.
//!
//! Commands that read a recording back need none of it: they have no events, and print their results.

use std::path::Path;

use judge::verdict::Verdict;
use recording::progress::RunProgress;
use worlds::preflight::PreflightEvent;

use crate::run::Judged;

/// Event of a run.
pub enum RunEvent<'a> {
    /// Note on the run: its bus, its clock, its rig, or a refusal of the machine.
    Note(String),
    /// Step of the pre-flight of an external drive.
    Preflight(&'a PreflightEvent),
    /// A scenario begins.
    Began {
        /// Duration of the scenario.
        duration_seconds: f64,
    },
    /// Progress of the scenario, which comes from another thread.
    Reached(RunProgress),
    /// A scenario was played. It is judged next, and its files are written.
    Played {
        /// Number of passes over its frames or cycles for that.
        passes: u64,
    },
    /// A scenario was played and judged.
    Judged {
        /// File of the scenario.
        path: &'a Path,
        /// Result of the run.
        judged: &'a Judged,
    },
    /// Stalls of the computer spoiled the play, and the scenario is played again.
    Spoiled(String),
    /// A failure that ends no other scenario.
    Failed(String),
    /// All scenarios were played.
    Ended(&'a [Verdict]),
}

/// Receiver of the events.
pub trait Listener: Sync {
    fn on_event(&self, event: &RunEvent<'_>);

    /// Takes a note on the run.
    fn on_note(&self, text: String) {
        self.on_event(&RunEvent::Note(text));
    }
}
