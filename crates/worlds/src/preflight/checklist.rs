//! What was checked, and what came of it.

use std::fmt;

/// What came of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckOutcome {
    /// All is well.
    Passed,
    /// It is not.
    Failed,
    /// Nobody reports it, or it was not asked for.
    Open,
}

/// One line of the checklist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// What came of it.
    pub outcome: CheckOutcome,
    /// What was found and, where it is wrong, what to do.
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

    fn new(name: &'static str, outcome: CheckOutcome, found: String) -> Self {
        Self {
            name,
            outcome,
            found,
        }
    }
}

/// `✓ bit rate       1000 kbit/s`
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
