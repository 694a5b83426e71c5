//! Checks with their outcomes.

use std::fmt;

/// Outcome of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CheckOutcome {
    /// The check passed.
    Passed,
    /// The check failed.
    Failed,
    /// No value is reported, or the check was not asked for.
    Open,
}

/// Line of the checklist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Check {
    /// Name of the check.
    pub(super) name: &'static str,
    /// Outcome of the check.
    pub(super) outcome: CheckOutcome,
    /// Finding and, after a failure, a remedy.
    pub(super) found: String,
}

impl Check {
    pub(super) fn new(name: &'static str, found: Found) -> Self {
        Self {
            name,
            outcome: found.outcome,
            found: found.text,
        }
    }
}

/// Outcome of a check with its finding.
pub(super) struct Found {
    pub(super) outcome: CheckOutcome,
    text: String,
}

impl Found {
    fn new(outcome: CheckOutcome, text: impl Into<String>) -> Self {
        let text = text.into();
        Self { outcome, text }
    }
}

pub(super) fn passed(found: impl Into<String>) -> Found {
    Found::new(CheckOutcome::Passed, found)
}

pub(super) fn failed(found: impl Into<String>) -> Found {
    Found::new(CheckOutcome::Failed, found)
}

pub(super) fn open(found: impl Into<String>) -> Found {
    Found::new(CheckOutcome::Open, found)
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
