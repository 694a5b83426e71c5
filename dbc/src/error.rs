//! Errors of a DBC file, and of look-ups in a database.

use thiserror::Error;

/// The database lacks a signal or a message that its user needs.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("the DBC has no signal {path}")]
pub struct SignalMissing {
    path: String,
}

impl SignalMissing {
    /// Makes the error for the missing signal or message at a path.
    pub fn new(path: &str) -> Self {
        Self {
            path: path.to_owned(),
        }
    }
}

/// Reason why a DBC file was refused: the message and the signal, and what is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct DbcError(pub(crate) String);
