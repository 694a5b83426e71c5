//! What a participant answers to a question.

use std::time::Duration;

use canopen::{CanFrame, Progress};

/// What a participant did in a step.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Answer {
    /// The frames that it queued, oldest first, each with the time at which it was queued.
    pub frames: Vec<(Duration, CanFrame)>,
    /// When it wants its next tick; `None` when only a frame can wake it.
    pub next_deadline: Option<Duration>,
    /// The time up to which it has gone.
    pub reached: Duration,
    /// How far the node is.
    pub progress: Progress,
}
