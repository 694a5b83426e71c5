//! What every report is made of.

use judge::verdict::Verdict;
use plan::{ControlLoop, Plan};
use recording::frames::Frames;
use recording::timeline::Timeline;

/// A judged run: everything that a report is made of.
#[derive(Clone, Copy)]
pub struct Run<'a> {
    /// What was played.
    pub plan: &'a Plan,
    /// What was on the bus.
    pub frames: &'a Frames,
    /// The same, decoded for each loop.
    pub timelines: &'a [Timeline],
    /// What it came to.
    pub verdict: &'a Verdict,
    /// Whether its log and its signals are compressed, and its recording for the viewer thinned.
    pub is_long: bool,
}

/// One loop of a judged run.
#[derive(Clone, Copy)]
pub(crate) struct RunLoop<'a> {
    pub(crate) own: &'a ControlLoop,
    pub(crate) timeline: &'a Timeline,
}

impl<'a> Run<'a> {
    /// The loops of the run.
    pub(crate) fn loops(&self) -> impl Iterator<Item = RunLoop<'a>> + use<'a> {
        let loops = self.plan.loops.iter().zip(self.timelines);
        loops.map(|(own, timeline)| RunLoop { own, timeline })
    }
}
