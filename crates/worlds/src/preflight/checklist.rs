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
    pub(super) fn new(name: &'static str, (outcome, found): Found) -> Self {
        Self {
            name,
            outcome,
            found,
        }
    }
}

/// Outcome of a check with its finding.
pub(super) type Found = (CheckOutcome, String);

pub(super) fn passed(found: impl Into<String>) -> Found {
    (CheckOutcome::Passed, found.into())
}

pub(super) fn failed(found: impl Into<String>) -> Found {
    (CheckOutcome::Failed, found.into())
}

pub(super) fn open(found: impl Into<String>) -> Found {
    (CheckOutcome::Open, found.into())
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
