//! Result of a run that did not fail.

use recording::ending::EarlyEnd;
use recording::latency::Host;

/// End of a run in which neither the bench nor the bus failed.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The scenario was played to its end.
    Completed,
    /// The user stopped it.
    Interrupted,
    /// A node under test ended it: it was silent, gave up or crashed, or violated a limit of the rig.
    ByNode(EarlyEnd),
}

/// Result of a run that did not fail.
pub struct Played {
    /// End of the run.
    pub end: End,
    /// Timing as the host knows it; `None` in virtual time.
    pub host: Option<Host>,
}

impl Played {
    /// Makes the result of a run in virtual time, which has no timing.
    pub fn in_virtual_time(end: End) -> Self {
        Self { end, host: None }
    }
}
