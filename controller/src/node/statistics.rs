//! Counters of the node.

use std::fmt;

/// Counts since the start of the scenario.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// SYNCs sent.
    pub cycles: u64,
    /// Cycles without a position from the drive.
    pub missing_positions: u64,
    /// SYNCs that were not sent because their time had passed.
    pub sync_overruns: u64,
}

/// The text is one line.
impl fmt::Display for Statistics {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            cycles,
            missing_positions,
            sync_overruns,
        } = self;
        write!(
            formatter,
            "{cycles} cycles, {missing_positions} without a position, {sync_overruns} SYNCs skipped"
        )
    }
}
