//! Facts about a run in addition to its frames.

use recording::ending::EarlyEnd;
use recording::latency::{Host, NodeReport};
use recording::unrecorded::Unrecorded;

/// Facts about a run in addition to its frames. The default is that of virtual time, and of a foreign recording.
#[derive(Clone, Debug, Default)]
pub struct Circumstances {
    /// Traffic on the bus that is not among the frames.
    pub unrecorded: Unrecorded,
    /// End of the run before its scenario's end; `None` if it was played to its end.
    pub ended_early: Option<EarlyEnd>,
    /// Knowledge of the host in real time; empty in virtual time.
    pub host: Host,
}

impl Circumstances {
    /// Returns whether canrig's controller, or else its emulator, completed each of its cycles in real time before the next one,
    /// without waiting for a law.
    pub(crate) fn is_punctual(&self, is_controller: bool) -> bool {
        let report = if is_controller {
            &self.host.controller
        } else {
            &self.host.plant_emulator
        };
        let is_punctual = |report: &NodeReport| {
            report.ticks > 0 && report.overruns == 0 && report.late_answers == 0
        };
        report.as_ref().is_some_and(is_punctual)
    }
}
