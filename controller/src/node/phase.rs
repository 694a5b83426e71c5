//! Where the controller is on its way from the search for the drive to its stop.

use std::time::Duration;

/// What the controller is about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Not booted.
    Off,
    /// Looks for the drive.
    Searching {
        until: Duration,
        next_question: Duration,
    },
    /// The drive was up already and has been ordered to reset its communication; its boot-up is awaited.
    Resetting { until: Duration },
    /// Configures the drive by SDO.
    Configuring { until: Duration },
    /// Leads the drive to Operation enabled.
    Enabling { until: Duration },
    /// Operation enabled was seen; the next SYNC is scenario time 0.
    Ready,
    /// Runs the law.
    Running(Cycle),
    /// Sends the command 0 and quick stop until the drive has surely taken it.
    Stopping { until: Duration, syncs_left: u8 },
    /// The drive is stopped; nothing more to say.
    Ended,
}

/// The present cycle of the law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cycle {
    /// Periods since scenario time 0.
    pub(super) number: u64,
    /// The drive's position has come.
    pub(super) has_position: bool,
    /// Cycles without a position in a row.
    pub(super) missing: u64,
    /// SYNC overruns up to here.
    pub(super) overruns: u64,
}
