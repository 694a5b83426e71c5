//! Errors of a coordinator.

use std::io;
use std::time::Duration;

use super::step::StepError;
use crate::seat::Misread;

/// Reason why the coordinator got no answer.
#[derive(Debug, thiserror::Error)]
pub enum LockstepError {
    /// The process did not answer in time.
    #[error("{name} gave no answer within {} s; see the end of its log", patience.as_secs())]
    NoAnswer {
        /// The participant.
        name: String,
        /// Time that it waited.
        patience: Duration,
    },
    /// The process closed its side channel.
    #[error("{name} ended before it answered; see the end of its log")]
    Ended {
        /// The participant.
        name: String,
    },
    /// The process sent a packet that breaks the protocol.
    #[error("{name} answered with what is no answer: {source}")]
    Protocol {
        /// The participant.
        name: String,
        /// Error in the packet.
        source: Misread,
    },
    /// The step was not possible.
    #[error("{name} could not be stepped: {source}")]
    Step {
        /// The participant.
        name: String,
        /// Error of the step.
        source: StepError,
    },
    /// The channel failed.
    #[error("the channel to {name} failed: {source}")]
    Channel {
        /// The participant.
        name: String,
        /// The system's error.
        source: io::Error,
    },
}

impl LockstepError {
    /// Returns the participant's name.
    pub fn name(&self) -> &str {
        match self {
            Self::NoAnswer { name, .. }
            | Self::Ended { name }
            | Self::Protocol { name, .. }
            | Self::Step { name, .. }
            | Self::Channel { name, .. } => name,
        }
    }
}
