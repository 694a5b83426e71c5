//! Counters of the node.

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
