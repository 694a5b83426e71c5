//! What can be wrong with an EDS.

use std::fmt;

/// What is wrong with an EDS, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EdsError {
    /// Line, from 1; 0 when the text as a whole is refused.
    pub line: usize,
    /// Section, without brackets; empty when the error is in none.
    pub section: String,
    /// Key; empty when the error concerns no single key.
    pub key: String,
    /// The text of the value.
    pub value: String,
    /// What is wrong.
    pub reason: String,
}

impl EdsError {
    /// An error about a line that belongs to no section.
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
