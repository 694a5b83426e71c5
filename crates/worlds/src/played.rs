//! How a world ended that did not fail.

use recording::ending::EarlyEnd;
use recording::latency::Host;

/// How a run ended in which neither the bench nor the bus failed.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The scenario was played to its end.
    Completed,
    /// The user stopped it.
    Interrupted,
    /// A node under test ended it: it was silent, gave up or crashed, or violated a limit of the rig.
    ByNode(EarlyEnd),
}

/// What a world came to that did not fail.
pub struct Played {
    /// Whether it came to the scenario's end.
    pub end: End,
    /// What the host knows of the timing; none in virtual time.
    pub host: Option<Host>,
}

impl Played {
    /// In virtual time there is no timing.
    #[must_use]
    pub fn in_virtual_time(end: End) -> Self {
        Self { end, host: None }
    }
}
