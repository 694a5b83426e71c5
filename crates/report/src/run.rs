//! What every report is made of.

use judge::verdict::Verdict;
use recording::frames::Frames;
use recording::timeline::Timeline;
use rig::setup::Setup;

/// A judged run: everything that a report is made of.
pub struct Run<'a> {
    /// What was played.
    pub setup: &'a Setup,
    /// What was on the bus.
    pub frames: &'a Frames,
    /// The same, decoded.
    pub timeline: &'a Timeline,
    /// What it came to.
    pub verdict: &'a Verdict,
    /// Whether its log and its signals are compressed, and its recording for the viewer thinned.
    pub is_long: bool,
}
