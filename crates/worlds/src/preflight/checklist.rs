//! Checks with their outcomes.

use std::fmt;

/// Outcome of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckOutcome {
    /// The check passed.
    Passed,
    /// The check failed.
    Failed,
    /// No value is reported, or the check was not asked for.
    Open,
}

/// Line of the checklist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// Outcome of the check.
    pub outcome: CheckOutcome,
    /// Finding and, after a failure, a remedy.
    pub found: String,
}

impl Check {
    pub(super) fn passed(name: &'static str, found: impl Into<String>) -> Self {
        Self::new(name, CheckOutcome::Passed, found.into())
    }

    pub(super) fn failed(name: &'static str, found: impl Into<String>) -> Self {
        Self::new(name, CheckOutcome::Failed, found.into())
    }

    pub(super) fn open(name: &'static str, found: impl Into<String>) -> Self {
        Self::new(name, CheckOutcome::Open, found.into())
    }

    pub(super) fn new(name: &'static str, outcome: CheckOutcome, found: String) -> Self {
        Self {
            name,
            outcome,
            found,
        }
    }
}

/// Writes a line such as `✓ bit rate       1000 kbit/s`.
impl fmt::Display for Check {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = match self.outcome {
            CheckOutcome::Passed => '✓',
            CheckOutcome::Failed => '✗',
            CheckOutcome::Open => '·',
        };
        write!(formatter, "{mark} {:13} {}", self.name, self.found)
    }
}
