//! Failures of participants.

use std::io;
use std::time::Duration;

use super::step::StepError;
use crate::seat::Misread;

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
