//! Virtual time: a coordinator says how far time goes and which frames the bus delivers, each participant answers with
//! the frames that it queued and with its next deadline.
//!
//! [`Participant`] is the coordinator's view of a node. [`Local`] is a node in this process, [`Remote`] one in another
//! process that runs [`follow`]; both step the node with the same code, so the answers are the same.
//!
//! The rules of a step from the participant's current time to `to`:
//! - a deadline earlier than the next frame ticks first, at the deadline;
//! - at equal times the frames come first, then the tick;
//! - a deadline at `to` itself ticks in this step;
//! - after `to` the node may go on by its own deadlines until a later time, which the coordinator has found safe; it
//!   ends early with the instant in which it queues a frame that somebody may answer;
//! - frames that the node queues carry the time at which it queued them;
//! - the step ends early when the node has stopped or failed.

mod audience;
mod follow;
mod local;
mod protocol;
mod remote;
mod step;
#[cfg(test)]
mod tests;

use std::io;
use std::time::Duration;

use canopen::{CanFrame, Filter, Progress};

pub use audience::Audience;
pub use follow::{FollowError, WIRE_PATIENCE, follow};
pub use local::Local;
pub use protocol::{FRAMES_MAX, ProtocolError};
pub use remote::{ANSWER_PATIENCE, Remote, channel};
pub use step::StepError;

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

    /// Tells the participant who listens to it; before the first step. Until then it takes every frame for answered.
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

/// Why the coordinator got no answer.
#[derive(Debug, thiserror::Error)]
pub enum LockstepError {
    /// The process did not answer in time.
    #[error("{name} gave no answer within {} s; see the end of its log", patience.as_secs())]
    NoAnswer {
        /// The participant.
        name: String,
        /// How long was waited.
        patience: Duration,
    },
    /// The process closed its side channel.
    #[error("{name} ended before it answered; see the end of its log")]
    Ended {
        /// The participant.
        name: String,
    },
    /// The process sent something that is not the protocol.
    #[error("{name} broke the lock-step protocol: {source}")]
    Protocol {
        /// The participant.
        name: String,
        /// What was wrong.
        source: ProtocolError,
    },
    /// The step was not possible.
    #[error("{name} could not be stepped: {source}")]
    Step {
        /// The participant.
        name: String,
        /// What was wrong.
        source: StepError,
    },
    /// The side channel failed.
    #[error("the side channel to {name} failed: {source}")]
    Channel {
        /// The participant.
        name: String,
        /// The system's error.
        source: io::Error,
    },
}
