//! Checks whether a recording is good enough to decide anything.

use plan::ControlLoop;
use recording::timeline::Timeline;
use recording::unrecorded::Unrecorded;
use scenario::expect::rounded;

use crate::attribution::cause::NamedCause;
use crate::attribution::{FAULTY_END_SECONDS, is_recorded_to_its_end};
use crate::evidence::Evidence;

/// Node of a cause that is a foreign source of frames.
pub(crate) const FOREIGN: &str = "foreign";

/// Returns the reason why a recording that ends before its scenario leaves the outcome open.
pub(crate) fn cut_short(timeline: &Timeline, one: &ControlLoop) -> Option<String> {
    let never_began = timeline.zero_seconds.is_none();
    // With a fault of the boot the scenario need not begin.
    let mut faults = one.faults();
    let may_not_begin = faults.any(|fault| fault.from_seconds.is_none());
    let is_whole = is_recorded_to_its_end(timeline, one) || never_began && may_not_begin;
    (!is_whole).then(|| {
        let reached = if never_began {
            0.0
        } else {
            timeline.last_frame_seconds
        };
        let planned = one.trial.run.duration_seconds;
        format!("the recording ends after {reached:.3} s of {planned} s")
    })
}

/// Returns whether the recording reaches a scenario time: frames that are missing before it were not sent. Only its nodes can
/// keep a scenario from beginning.
pub(crate) fn reaches(timeline: &Timeline, seconds: f64) -> bool {
    timeline.zero_seconds.is_none() || timeline.last_frame_seconds + FAULTY_END_SECONDS >= seconds
}

/// Returns the reason why the outcome is open if the recording lacks frames that were on the bus.
pub(crate) fn incomplete_recording(unrecorded: &Unrecorded) -> Option<String> {
    let lost = unrecorded.frames_lost;
    let lost = (lost > 0).then(|| lost_frames(lost));
    lost.or_else(|| unrecorded.unreadable_lines.clone())
}

/// Returns the reason why the outcome is open if a foreign source sent frames of the run's nodes.
pub(crate) fn two_sources(evidence: &Evidence<'_>) -> Option<NamedCause> {
    let circumstances = evidence.circumstances;
    let found = evidence.timeline.sources.found(&circumstances.host.sent);
    let first = found.first()?;
    let sources = Vec::from_iter(found.iter().map(ToString::to_string)).join("; ");
    Some(NamedCause {
        node: FOREIGN.to_owned(),
        duty: first.duty.to_owned(),
        at_seconds: Some(rounded(first.first_seconds)),
        description: format!("a second master: {sources}"),
    })
}

/// The reason of a verdict on a recording with missing frames.
pub fn lost_frames(lost: u64) -> String {
    format!("the recorder lost {lost} frames")
}
