//! What is known of a run besides its frames.

use recording::ending::EarlyEnd;
use recording::latency::NodeReport;
use recording::sources::Sent;
use recording::stalls::Stall;
use recording::unrecorded::Unrecorded;
use scenario::node::Part;

/// What is known of a run besides its frames; the default is that of virtual time, and of somebody else's recording.
#[derive(Clone, Debug, Default)]
pub struct Circumstances {
    /// What was on the bus and is not among the frames.
    pub unrecorded: Unrecorded,
    /// Who ended the run before its scenario's end; none if it was played to its end.
    pub ended_early: Option<EarlyEnd>,
    /// Where the machine held up what canrig started; nothing in virtual time.
    pub stalls: Vec<Stall>,
    /// The frames that canrig's nodes sent in real time.
    pub sent: Sent,
    /// The reports of canrig's nodes in real time: of the controller, and of the emulators together.
    pub reports: [Option<NodeReport>; 2],
}

impl Circumstances {
    /// Whether a node of canrig's was done with each of its cycles in real time before the next one, and no law kept it waiting.
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
