//! The seam between the coordinator and a node, wherever the node is.

use std::time::Duration;

use canopen::{CanFrame, Filter};

use super::answer::Answer;
use super::audience::Audience;
use super::error::LockstepError;

/// A node as the coordinator sees it.
///
/// Answers are written over the one before, whose memory they use: a participant is asked thousands of times a second.
pub trait Participant {
    /// The name for messages, such as "controller".
    fn name(&self) -> &str;

    /// The identifiers that the node listens to.
    fn filters(&self) -> &[Filter];

    /// The frames that the node takes without saying anything, see [`canopen::Node::silent_filters`].
    fn silent_filters(&self) -> &[Filter];

    /// Informs the participant who listens to it; before the first step. Until then it takes every frame for answered.
    fn meet(&mut self, audience: &Audience);

    /// When the node wants its next tick, as of the last answer; a new node wants one at once.
    fn next_deadline(&self) -> Option<Duration>;

    /// Steps up to and including `to` with the frames delivered on the way, in order of time, each not later than `to`;
    /// then on to `until`, as long as no frame is queued that somebody may answer. No frame may be delivered later that is
    /// not after `until`, unless it answers one of the node's own.
    ///
    /// # Errors
    /// When the node's process is gone, silent for 10 s of wall time, or breaks the protocol; when the step itself was
    /// impossible.
    fn advance(
        &mut self,
        to: Duration,
        until: Duration,
        frames: &[(Duration, CanFrame)],
        answer: &mut Answer,
    ) -> Result<(), LockstepError>;

    /// Asks the node for its safe state at `at`, which is not before its current time.
    ///
    /// # Errors
    /// As [`Participant::advance`].
    fn stop(&mut self, at: Duration, answer: &mut Answer) -> Result<(), LockstepError>;
}
