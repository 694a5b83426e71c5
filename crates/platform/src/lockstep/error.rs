//! Errors of a coordinator.

use std::io;
use std::time::Duration;

use super::step::StepError;
use crate::seat::Misread;

/// Error of a participant.
#[derive(Debug, thiserror::Error)]
#[error("{name} {failure}")]
pub struct LockstepError {
    /// The participant.
    pub name: String,
    /// Reason why the coordinator got no answer.
    pub failure: Failure,
}

/// Reason why the coordinator got no answer.
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
    /// The channel failed.
    #[error("cannot be reached: {0}")]
    Channel(io::Error),
}
