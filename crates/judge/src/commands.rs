//! The commands that the controller left out: a cycle with a position is answered before the next position.

use std::iter::Peekable;

use recording::timeline::Timeline;
use rig::external::ExternalNode;

use crate::evidence::{Evidence, Measurement};
use crate::excuse::MISSED_COMMANDS;
use crate::misses::Totals;

/// With more cycles without a command than this, a controller that is somebody else's fails without a limit of its own, and limits on
/// the time to the command are not met.
pub(crate) const MISSED_COMMANDS_PERCENT_MAX: f64 = 1.0;

/// Share of the cycles in which a command was due and did not come. Reported where it is limited, where the controller is under test, or
/// where a controller left out too many and no fault may be why.
pub(crate) fn missed_commands(evidence: &Evidence<'_>) -> Measurement {
    let is_watched =
        is_under_test(evidence) || evidence.scenario.expect.of(MISSED_COMMANDS).is_some();
    let is_sound = evidence.own.faults().next().is_none();
    if !is_watched && (!is_sound || evidence.timeline.uncommanded.is_empty()) {
        return Measurement::NotAsked;
    }
    let missed = missed(evidence);
    if !is_watched && missed.percent_by_nodes() <= MISSED_COMMANDS_PERCENT_MAX {
        return Measurement::NotAsked;
    }
    let seen = evidence.seen(evidence.whole());
    seen.map(|_| missed.percent()).into()
}

/// Why a run fails whose controller left out too many commands: more than its limit says, or, where it has none and the controller is
/// under test, than can be.
pub(crate) fn missed_by_controller(evidence: &Evidence<'_>) -> Option<String> {
    let limit = evidence.scenario.expect.limit(MISSED_COMMANDS);
    if evidence.timeline.uncommanded.is_empty() || limit.is_none() && !is_under_test(evidence) {
        return None;
    }
    let percent_max = limit.and_then(|limit| limit.max);
    let percent_max = percent_max.unwrap_or(MISSED_COMMANDS_PERCENT_MAX);
    let lost = evidence.circumstances.unrecorded.frames_lost;
    let missed = missed(evidence);
    missed.too_many_by_nodes(percent_max, lost).or_else(|| {
        // The command of the last cycle may have been due after the end.
        let last_due = due(evidence).last()?.saturating_sub(1);
        missed.silent_at_end(last_due, evidence.timeline.period_seconds, lost)
    })
}

fn is_under_test(evidence: &Evidence<'_>) -> bool {
    evidence.own.external.has(ExternalNode::Controller)
}

/// All commands that were missed, of those that were due.
pub(crate) fn missed(evidence: &Evidence<'_>) -> Totals {
    let mut uncommanded = evidence.timeline.uncommanded.iter().copied().peekable();
    let missed = due(evidence).filter(|cycle| has_next(&mut uncommanded, *cycle));
    evidence
        .misses()
        .of_commands(due(evidence).count() as u64, missed)
}

/// The cycles in which a command was due: all positions that a law may read came.
fn due(evidence: &Evidence<'_>) -> impl Iterator<Item = u64> {
    let all = evidence.misses().due;
    let loops = evidence.loops.iter();
    let mut others = Vec::from_iter(loops.map(|(_, timeline)| served(timeline).peekable()));
    let own = served(evidence.timeline).take_while(move |cycle| *cycle < all);
    own.filter(move |cycle| others.iter_mut().all(|other| has_next(other, *cycle)))
}

/// The cycles with a position.
fn served(timeline: &Timeline) -> impl Iterator<Item = u64> {
    let rows = timeline.cycle.iter().zip(timeline.position());
    rows.filter_map(|(cycle, position)| (!position.is_nan()).then_some(*cycle))
}

/// Whether a cycle is among those that come, all of them in their order.
fn has_next(cycles: &mut Peekable<impl Iterator<Item = u64>>, wanted: u64) -> bool {
    while cycles.next_if(|cycle| *cycle < wanted).is_some() {}
    cycles.peek() == Some(&wanted)
}
