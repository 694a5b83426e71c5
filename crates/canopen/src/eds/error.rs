//! Errors of an EDS.

use std::fmt;

/// Error of an EDS, with its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EdsError {
    /// Line, from 1; 0 if the text as a whole is refused.
    pub line: usize,
    /// Section, without brackets; empty if the error is in none.
    pub section: String,
    /// Key; empty if the error concerns no single key.
    pub key: String,
    /// Text of the value.
    pub value: String,
    /// Reason of the error.
    pub reason: String,
}

impl EdsError {
    /// Makes an error about a line that belongs to no section.
    pub(super) fn at_line(line: usize, reason: impl Into<String>) -> Self {
        Self {
            line,
            section: String::new(),
            key: String::new(),
            value: String::new(),
            reason: reason.into(),
        }
    }
}

impl fmt::Display for EdsError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.line > 0 {
            write!(formatter, "line {}: ", self.line)?;
        }
        if !self.section.is_empty() {
            write!(formatter, "[{}] ", self.section)?;
        }
        if !self.key.is_empty() {
            write!(formatter, "{}={}: ", self.key, self.value)?;
        }
        formatter.write_str(&self.reason)
    }
}

impl std::error::Error for EdsError {}
