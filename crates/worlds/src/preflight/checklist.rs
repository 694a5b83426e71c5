//! Checks with what they found.

use std::fmt;

/// Finding of a check and, after a failure, a remedy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// The check passed.
    Passed(String),
    /// The check failed.
    Failed(String),
    /// No value is reported, or the check was not asked for.
    Open(String),
}

/// Line of the checklist: the name of a check, and what it found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Check(pub(super) &'static str, pub(super) Found);

/// Writes a line such as `✓ bit rate       1000 kbit/s`.
impl fmt::Display for Check {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(name, found) = self;
        let (mark, text) = match found {
            Found::Passed(text) => ('✓', text),
            Found::Failed(text) => ('✗', text),
            Found::Open(text) => ('·', text),
        };
        write!(formatter, "{mark} {name:13} {text}")
    }
}
