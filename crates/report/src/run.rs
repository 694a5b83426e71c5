//! The input of every report.

use judge::verdict::Verdict;
use plan::{ControlLoop, Plan};
use recording::frames::Frames;
use recording::timeline::Timeline;

/// Judged run, with everything that a report needs.
#[derive(Clone, Copy)]
pub struct Run<'a> {
    /// Plan that was played.
    pub plan: &'a Plan,
    /// Frames that were on the bus.
    pub frames: &'a Frames,
    /// The same frames, decoded for each loop.
    pub timelines: &'a [Timeline],
    /// Verdict of the run.
    pub verdict: &'a Verdict,
    /// The values of `--set`.
    pub set: &'a [String],
    /// Date and host of the play; `None` if they are unknown. The page of a run in virtual time does not show them.
    pub played: Option<&'a str>,
    /// Whether the log and the signals are compressed, and the recording for the viewer is thinned.
    pub is_long: bool,
}

/// Loop of a judged run.
#[derive(Clone, Copy)]
pub(crate) struct RunLoop<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) control_loop: &'a ControlLoop,
    pub(crate) timeline: &'a Timeline,
}

impl<'a> Run<'a> {
    /// Returns the loops of the run.
    pub(crate) fn loops(&self) -> impl Iterator<Item = RunLoop<'a>> + use<'a> {
        let plan = self.plan;
        let loops = plan.loops.iter().zip(self.timelines);
        loops.map(move |(control_loop, timeline)| RunLoop {
            plan,
            control_loop,
            timeline,
        })
    }
}
