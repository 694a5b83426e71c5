//! Checks whether a recording is good enough to decide anything.

use dbc::Database;
use plan::{ControlLoop, each_once};
use recording::foreign::Foreign;
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
    if let Some(foreign) = &circumstances.unrecorded.foreign {
        return by_foreign_sender(foreign, evidence.database);
    }
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

/// Returns the reason for frames of which the bus knows that no node of the run sent them.
fn by_foreign_sender(foreign: &Foreign, database: &Database) -> Option<NamedCause> {
    let first = foreign.iter().next()?;
    let identifiers = each_once(foreign.iter().map(|frames| frames.identifier));
    let sources = identifiers.into_iter().map(|identifier| {
        let mut at_seconds = None;
        let mut frames = 0;
        for one in foreign.iter().filter(|one| one.identifier == identifier) {
            at_seconds = at_seconds.or(Some(one.at_seconds));
            frames += one.frames;
        }
        let (noun, at) = (
            if frames == 1 { "frame" } else { "frames" },
            at_seconds.unwrap_or_default(),
        );
        let purpose = database.purpose(identifier);
        format!(
            "0x{identifier:03X} ({purpose}), {frames} {noun} of another client, from {at:.3} s on"
        )
    });
    let sources = Vec::from_iter(sources).join("; ");
    Some(NamedCause {
        node: FOREIGN.to_owned(),
        duty: foreign_duty(first.identifier).to_owned(),
        at_seconds: Some(rounded(first.at_seconds)),
        description: format!("a second master: {sources}"),
    })
}

/// Kind of the frames with an identifier of the predefined connection set (CiA 301, 7.3.5).
fn foreign_duty(identifier: u16) -> &'static str {
    match identifier {
        0x000 => "nmt",
        0x080 => "sync",
        0x081..=0x0FF => "emergency",
        0x180..=0x1FF => "position",
        0x580..=0x67F => "sdo",
        0x700..=0x77F => "heartbeat",
        _ => "command",
    }
}

/// The reason of a verdict on a recording with missing frames.
pub fn lost_frames(lost: u64) -> String {
    format!("the recorder lost {lost} frames")
}
