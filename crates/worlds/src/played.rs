//! How a world ended that did not fail.

use recording::latency::Host;

/// How a run ended that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The scenario was played to its end.
    Completed,
    /// The user stopped it.
    Interrupted,
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
