//! Why a DBC file was refused.

use thiserror::Error;

/// A database lacks a signal or message that somebody needs.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("the DBC has no signal {path}")]
pub struct SignalMissing {
    path: String,
}

impl SignalMissing {
    /// The error for what is not there.
    #[must_use]
    pub fn new(path: &str) -> Self {
        Self {
            path: path.to_owned(),
        }
    }
}

/// Why a DBC file was refused.
#[derive(Clone, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
pub enum DbcError {
    /// Larger than [`crate::Database::TEXT_BYTES_MAX`].
    #[error("DBC text has {bytes} bytes (limit {limit})")]
    TextTooLong { bytes: usize, limit: usize },
    /// Not the DBC grammar.
    #[error("DBC syntax: {0}")]
    Syntax(String),
    /// A standard identifier above 0x7FF.
    #[error("message {message}: identifier {id:#x} exceeds 11 bits")]
    Identifier { message: String, id: u32 },
    /// Only classical CAN is supported.
    #[error("message {message} has {bytes} bytes (classical CAN carries 8)")]
    MessageTooLong { message: String, bytes: u64 },
    /// Two messages of one name or identifier.
    #[error("messages {first} and {second} have the same name or identifier")]
    DuplicateMessage { first: String, second: String },
    /// Two signals of one name.
    #[error("message {message} has two signals {signal}")]
    DuplicateSignal { message: String, signal: String },
    /// Two signals share bits.
    #[error("message {message}: signals {first} and {second} overlap")]
    Overlap {
        message: String,
        first: String,
        second: String,
    },
    /// One signal cannot be coded.
    #[error("signal {message}.{signal}: {reason}")]
    Signal {
        message: String,
        signal: String,
        reason: &'static str,
    },
}
