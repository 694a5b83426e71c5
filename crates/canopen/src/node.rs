//! The contract between a node and whatever moves its frames and its time.

use std::time::Duration;

use crate::frame::{CanFrame, Filter};

/// The earliest of some deadlines; `None` when there is none.
#[must_use]
#[inline]
pub fn earliest(deadlines: impl IntoIterator<Item = Option<Duration>>) -> Option<Duration> {
    deadlines.into_iter().fold(None, earlier)
}

/// The earlier of two deadlines; `None` when there is none.
#[must_use]
#[inline]
pub fn earlier(left: Option<Duration>, right: Option<Duration>) -> Option<Duration> {
    // Asked after every event of every node, and most services have none: nothing else is compared.
    match (left, right) {
        (Some(left), Some(right)) => Some(left.min(right)),
        (deadline, None) | (None, deadline) => deadline,
    }
}

/// How far a node is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Progress {
    /// The node works.
    #[default]
    Running,
    /// The node was asked to stop, has reached its safe state and has nothing more to say.
    Stopped,
    /// The node cannot go on; the text says why and what to do.
    Failed(String),
}

/// A participant of the bus as a state machine: no I/O, no clock, no thread.
///
/// Time is the `Duration` since the node's start and never decreases. After each call that takes `&mut self` with a
/// time, drain [`Node::next_frame`] until it is empty. Call [`Node::on_tick`] when `now` has reached [`Node::next_deadline`].
pub trait Node {
    /// The identifiers that the node listens to; everything else may be withheld from it.
    fn filters(&self) -> Vec<Filter>;

    /// The same in a run in which nobody configures the node to listen to other identifiers, as in lock-step: what it would
    /// not read is not delivered.
    fn filters_as_configured(&self) -> Vec<Filter> {
        self.filters()
    }

    /// A promise that lets lock-step deliver frames late: a frame that passes one of these makes the node neither queue
    /// a frame nor want an earlier tick. Frames of which no such thing is known are not among them.
    fn silent_filters(&self) -> Vec<Filter> {
        Vec::new()
    }

    /// Handles a frame that the bus delivered.
    fn on_frame(&mut self, now: Duration, frame: &CanFrame);

    /// Does what is due at `now`.
    fn on_tick(&mut self, now: Duration);

    /// Asks the node for its safe state: no current in the wire, nothing left running. It may take frames and ticks
    /// until [`Node::progress`] says [`Progress::Stopped`].
    fn on_stop(&mut self, now: Duration);

    /// The next frame to send, oldest first.
    fn next_frame(&mut self) -> Option<CanFrame>;

    /// When the node wants its next tick; `None` when only a frame can wake it. A new node wants one at once.
    fn next_deadline(&self) -> Option<Duration>;

    /// How far the node is.
    fn progress(&self) -> Progress;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_earliest_of_none_is_none() {
        let at = |millis| Some(Duration::from_millis(millis));
        assert_eq!(earliest([]), None);
        assert_eq!(earliest([None, None]), None);
        assert_eq!(earliest([None, at(3), at(2), None, at(5)]), at(2));
    }
}
