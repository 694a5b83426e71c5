//! Phases of the controller, from the search for its drives to their stop.

use std::time::Duration;

/// Phase of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Not booted.
    Off,
    /// Leads its drives to Operation enabled, each at its own pace. The first SYNC with all drives enabled is scenario
    /// time 0.
    BringUp,
    /// Runs the laws.
    Running(Cycle),
    /// Sends the command 0 and quick stop until the drives have certainly received it.
    Stopping { until: Duration, syncs_left: u8 },
    /// The drives are stopped. The controller has finished.
    Ended,
}

/// Phase of a drive in the bring-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum DrivePhase {
    /// The drive is sought.
    Searching { next_question: Duration },
    /// The drive was up already. It was ordered to reset its communication, and its boot-up is awaited.
    Resetting,
    /// The drive is configured by SDO.
    Configuring,
    /// The drive waits until the others are configured too.
    Configured,
    /// The drive is led to Operation enabled; `is_enabled` is by its latest statusword.
    Enabling { is_enabled: bool },
}

/// The present cycle of the laws.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cycle {
    /// Periods since scenario time 0.
    pub(super) number: u64,
    /// Number of SYNC overruns so far.
    pub(super) overruns: u64,
}
