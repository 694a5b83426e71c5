//! Where the controller is on its way from the search for its drives to its stop.

use std::time::Duration;

/// What the controller is about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Not booted.
    Off,
    /// Leads its drives to Operation enabled, each at its own pace; the first SYNC at which all are there is scenario time 0.
    BringUp,
    /// Runs the laws.
    Running(Cycle),
    /// Sends the command 0 and quick stop until the drives have surely taken it.
    Stopping { until: Duration, syncs_left: u8 },
    /// The drives are stopped; nothing more to say.
    Ended,
}

/// How far a drive is in the bring-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum DrivePhase {
    /// Looked for.
    Searching {
        until: Duration,
        next_question: Duration,
    },
    /// It was up already and has been ordered to reset its communication; its boot-up is awaited.
    Resetting { until: Duration },
    /// Configured by SDO.
    Configuring { until: Duration },
    /// Waits until the others are configured too.
    Configured { until: Duration },
    /// Led to Operation enabled, and there according to its latest statusword or not.
    Enabling { until: Duration, is_enabled: bool },
}

/// The present cycle of the laws.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cycle {
    /// Periods since scenario time 0.
    pub(super) number: u64,
    /// SYNC overruns up to here.
    pub(super) overruns: u64,
}
