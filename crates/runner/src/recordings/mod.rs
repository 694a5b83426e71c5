//! What can be done with recordings after the run: look at them, judge them again, compare them, hand them on.

pub mod compare;
pub mod coverage;
pub mod export;
mod recorded;
pub mod replay;
pub mod report;

pub use recorded::{Recorded, RecordedError};

use crate::console::complain;
use crate::exit::Exit;

/// Tells why a recording cannot be used; the exit code of that.
fn refuse(error: RecordedError) -> Exit {
    match error {
        RecordedError::Scenario(error) => complain(&format!("{:?}", miette::Report::new(*error))),
        RecordedError::Rig(error) => complain(&format!("{:?}", miette::Report::new(*error))),
        error => complain(&format!("canrig: {error}")),
    }
    Exit::ScenarioInvalid
}
