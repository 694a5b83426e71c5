//! The contract between a node and the mover of its frames and its time.

use std::time::Duration;

use crate::frame::{CanFrame, Filter};

/// Returns the earliest of some deadlines; `None` if there is none.
#[inline]
pub fn earliest(deadlines: impl IntoIterator<Item = Option<Duration>>) -> Option<Duration> {
    deadlines.into_iter().fold(None, earlier)
}

/// Returns the earlier of two deadlines; `None` if there is none.
#[inline]
pub fn earlier(left: Option<Duration>, right: Option<Duration>) -> Option<Duration> {
    // This is called after every event of every node, and most services have no deadline: then there is no comparison.
    match (left, right) {
        (Some(left), Some(right)) => Some(left.min(right)),
        (deadline, None) | (None, deadline) => deadline,
    }
}

/// Progress of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Progress {
    /// The node works.
    #[default]
    Running,
    /// The node was asked to stop, has reached its safe state and has nothing left to send.
    Stopped,
    /// The node cannot continue; the text gives the reason and advice.
    Failed(String),
}

/// A participant of the bus as a state machine: no I/O, no clock, no thread.
///
/// Time is the `Duration` since the node's start and never decreases. After each call that takes `&mut self` with a
/// time, drain [`Node::next_frame`] until it is empty. Call [`Node::on_tick`] when `now` has reached [`Node::next_deadline`].
pub trait Node {
    /// Returns the identifiers that the node listens to; other frames may be withheld from it.
    fn filters(&self) -> Vec<Filter>;

    /// Returns the identifiers that the node listens to as it is configured now, for runs in which its configuration stays, as in
    /// lock-step: frames that it would not read are not delivered.
    fn filters_as_configured(&self) -> Vec<Filter> {
        self.filters()
    }

    /// Promises which frames lock-step may deliver late: a frame that passes one of these filters makes the node neither queue a
    /// frame nor want an earlier tick. Frames for which this is not known do not pass.
    fn silent_filters(&self) -> Vec<Filter> {
        Vec::new()
    }

    /// Handles a frame that the bus delivered.
    fn on_frame(&mut self, now: Duration, frame: &CanFrame);

    /// Handles the events that are due at `now`.
    fn on_tick(&mut self, now: Duration);

    /// Asks the node for its safe state: no current in the wire, nothing left running. It may take frames and ticks until
    /// [`Node::progress`] returns [`Progress::Stopped`].
    fn on_stop(&mut self, now: Duration);

    /// Returns the next frame to send, oldest first.
    fn next_frame(&mut self) -> Option<CanFrame>;

    /// Returns the time at which the node wants its next tick; `None` if only a frame can wake it. A new node wants a tick at
    /// once.
    fn next_deadline(&self) -> Option<Duration>;

    /// Returns the progress of the node.
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
