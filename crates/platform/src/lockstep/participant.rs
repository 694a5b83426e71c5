//! Interface between the coordinator and a node in any process.

use std::io;
use std::time::Duration;

use can::{CanFrame, Progress};

use super::audience::Audience;
use super::protocol::Hello;
use super::step::StepError;
use crate::seat::Misread;

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

/// Reason why a participant does not continue, as a text that follows its name.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The process did not answer within this time.
    #[error("gave no answer within {} s; see the end of its log", .0.as_secs())]
    NoAnswer(Duration),
    /// The process closed its side channel.
    #[error("ended before it answered; see the end of its log")]
    Ended,
    /// The process sent a packet that breaks the protocol.
    #[error("answered with what is no answer: {0}")]
    Protocol(#[from] Misread),
    /// The step was not possible.
    #[error("could not be stepped: {0}")]
    Step(#[from] StepError),
    /// The process did not answer, and the user asked the run to end.
    #[error("was not waited for any longer")]
    Interrupted,
    /// No node has an event left, and this one owes the next.
    #[error("waits for ever, as all nodes do: none has a frame to send or a timer left")]
    Waits,
    /// The channel failed.
    #[error("cannot be reached: {0}")]
    Channel(io::Error),
    /// The node gave up, with this reason.
    #[error("failed: {0}")]
    GaveUp(String),
    /// The node sends more than the bus carries: more than this number of its frames wait.
    #[error("has more than {0} frames waiting: the bus cannot carry what it sends")]
    Overloaded(usize),
}

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
    /// If the node's process is gone, silent for 10 s of wall time or when the user asks the run to end, or breaks the
    /// protocol, or if the step itself was impossible.
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
