//! Counters of the node.

/// Counts since the start of the scenario.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Statistics {
    /// SYNCs sent.
    pub(super) cycles: u64,
    /// Cycles without a position from the drive.
    pub(super) missing_positions: u64,
    /// SYNCs that were not sent because their time had passed.
    pub(super) sync_overruns: u64,
}
