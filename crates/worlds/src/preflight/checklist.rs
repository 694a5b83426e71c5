//! What was checked, and what came of it.

use std::fmt;

/// What came of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All is well.
    Passed,
    /// It is not.
    Failed,
    /// Nobody tells, or it was not asked for.
    Open,
}

/// One line of the checklist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// What came of it.
    pub outcome: Outcome,
    /// What was found and, where it is wrong, what to do.
    pub found: String,
}

impl Check {
    pub(super) fn passed(name: &'static str, found: impl Into<String>) -> Self {
        Self::new(name, Outcome::Passed, found.into())
    }

    pub(super) fn failed(name: &'static str, found: impl Into<String>) -> Self {
        Self::new(name, Outcome::Failed, found.into())
    }

    pub(super) fn open(name: &'static str, found: impl Into<String>) -> Self {
        Self::new(name, Outcome::Open, found.into())
    }

    fn new(name: &'static str, outcome: Outcome, found: String) -> Self {
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
            Outcome::Passed => '✓',
            Outcome::Failed => '✗',
            Outcome::Open => '·',
        };
        write!(formatter, "{mark} {:13} {}", self.name, self.found)
    }
}
