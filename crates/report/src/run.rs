//! What every report is made of.

use judge::verdict::Verdict;
use recording::log::Stamped;
use recording::timeline::Timeline;
use rig::setup::Setup;

/// A judged run: everything that a report is made of.
pub struct Run<'a> {
    /// What was played.
    pub setup: &'a Setup,
    /// What was on the bus.
    pub frames: &'a [Stamped],
    /// The same, decoded.
    pub timeline: &'a Timeline,
    /// What it came to.
    pub verdict: &'a Verdict,
}
