//! Facts about a run in addition to its frames.

use recording::ending::EarlyEnd;
use recording::latency::NodeReport;
use recording::sources::Sent;
use recording::stalls::Stall;
use recording::unrecorded::Unrecorded;
use scenario::node::Part;

/// Facts about a run in addition to its frames. The default is that of virtual time, and of a foreign recording.
#[derive(Clone, Debug, Default)]
pub struct Circumstances {
    /// Traffic on the bus that is not among the frames.
    pub unrecorded: Unrecorded,
    /// End of the run before its scenario's end; `None` if it was played to its end.
    pub ended_early: Option<EarlyEnd>,
    /// Stalls of the processes that canrig started; empty in virtual time.
    pub stalls: Vec<Stall>,
    /// Frames that canrig's nodes sent in real time.
    pub sent: Sent,
    /// Reports of canrig's nodes in real time: of the controller, and of all emulators together.
    pub reports: [Option<NodeReport>; 2],
}

impl Circumstances {
    /// Returns whether one of canrig's nodes completed each of its cycles in real time before the next one, without waiting for a
    /// law.
    pub(crate) fn is_punctual(&self, node: Part) -> bool {
        let report = match node {
            Part::Controller => &self.reports[0],
            _ => &self.reports[1],
        };
        let is_punctual = |report: &NodeReport| {
            report.ticks > 0 && report.overruns == 0 && report.late_answers == 0
        };
        report.as_ref().is_some_and(is_punctual)
    }
}
