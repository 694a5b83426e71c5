//! Interface between the coordinator and a node in any process.

use std::time::Duration;

use can::CanFrame;

use super::answer::Answer;
use super::audience::Audience;
use super::error::Failure;
use super::protocol::Hello;

/// Node as the coordinator sees it.
///
/// Each answer overwrites the one before and reuses its memory: a participant is asked thousands of times a second.
pub trait Participant {
    /// Returns the name for messages, such as "controller".
    fn name(&self) -> &str;

    /// Returns the properties of the node before its first step.
    fn hello(&self) -> &Hello;

    /// Informs the participant of its listeners, before the first step. Until then it assumes that every frame is answered.
    fn meet(&mut self, audience: &Audience);

    /// Steps up to and including `to` with the frames delivered on the way, in order of time, none later than `to`. Then steps on
    /// to `until`, as long as the node queues no frame that another participant may answer. All frames delivered later must be
    /// after `until`, unless they answer one of the node's own.
    ///
    /// # Errors
    /// If the node's process is gone, silent for 10 s of wall time, or breaks the protocol, or if the step itself was impossible.
    fn advance(
        &mut self,
        to: Duration,
        until: Duration,
        frames: &[(Duration, CanFrame)],
        answer: &mut Answer,
    ) -> Result<(), Failure>;

    /// Asks the node for its safe state at `at`, which is not before its current time.
    ///
    /// # Errors
    /// As [`Participant::advance`].
    fn stop(&mut self, at: Duration, answer: &mut Answer) -> Result<(), Failure>;
}
