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

/// Reason why a DBC file was refused.
#[derive(Clone, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
pub enum DbcError {
    /// The text is larger than [`crate::Database::TEXT_BYTES_MAX`].
    #[error("DBC text has {bytes} bytes (limit {limit})")]
    TextTooLong { bytes: usize, limit: usize },
    /// The text does not follow the DBC grammar.
    #[error("DBC syntax: {0}")]
    Syntax(String),
    /// A standard identifier is above 0x7FF.
    #[error("message {message}: identifier {id:#x} exceeds 11 bits")]
    Identifier { message: String, id: u32 },
    /// A message is longer than in classical CAN, the only kind that is supported.
    #[error("message {message} has {bytes} bytes (classical CAN carries 8)")]
    MessageTooLong { message: String, bytes: u64 },
    /// Two messages have the same name or identifier.
    #[error("messages {first} and {second} have the same name or identifier")]
    DuplicateMessage { first: String, second: String },
    /// Two signals of a message have the same name.
    #[error("message {message} has two signals {signal}")]
    DuplicateSignal { message: String, signal: String },
    /// Two signals share bits.
    #[error("message {message}: signals {first} and {second} overlap")]
    Overlap {
        message: String,
        first: String,
        second: String,
    },
    /// A signal cannot be coded.
    #[error("signal {message}.{signal}: {reason}")]
    Signal {
        message: String,
        signal: String,
        reason: &'static str,
    },
}
