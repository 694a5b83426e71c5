//! Answer of a participant to a question.

use std::time::Duration;

use can::{CanFrame, Progress};

/// Result of a participant's step.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Answer {
    /// Frames that it queued, oldest first, each with the time at which it was queued.
    pub frames: Vec<(Duration, CanFrame)>,
    /// Time of its next tick; `None` if only a frame can wake it.
    pub next_deadline: Option<Duration>,
    /// Time that it has reached.
    pub reached: Duration,
    /// Progress of the node.
    pub progress: Progress,
}
