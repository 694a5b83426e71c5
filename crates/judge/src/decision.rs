//! Decides the outcome of a run by its metrics, by whose doing its missed cycles were, and by who ended it.

use recording::ending::{EarlyEnd, EndedBy};
use recording::events::{Event, Level};
use recording::occurrences::Occurrence;
use recording::timeline::Timeline;
use recording::unrecorded::Unrecorded;
use recording::work::Way;
use rig::plan::Plan;
use scenario::metrics::is_of_traffic;

use crate::circumstances::Circumstances;
use crate::commands::missed_by_controller;
use crate::evidence::Evidence;
use crate::excuse::{Excuse, MISSED_CYCLES, open_commands};
use crate::loops::whole;
use crate::metric::{Metric, leave_open, not_judged};
use crate::metrics::metrics;
use crate::misses::excuse_of_end;
use crate::quality::{cut_short, incomplete_recording, second_master};
use crate::verdict::{Outcome, Verdict};

/// Losses that a verdict lists at most.
const LOSSES_MAX: usize = 20;
/// With more cycles missed than this by the nodes, a run without a limit of its own fails; by the bench, control metrics
/// decide nothing.
const MISSED_CYCLES_PERCENT_MAX: f64 = 1.0;
/// From this load on, a cycle that carries more than the others does not end in its time.
const BUSY_BUS_PERCENT: f64 = 70.0;

/// The metric that decides before all others: on an overloaded bus nothing else means anything.
const BUS_LOAD: &str = "bus_load_percent";

/// More than any bus carries: 100 %, and some room for the stamps of short recordings.
const LOAD_PERCENT_MAX: f64 = 101.0;

/// Judges a run by the timelines of its loops. It takes as long as a way through the frames.
#[must_use]
pub fn judge(plan: &Plan, timelines: &[Timeline], circumstances: &Circumstances) -> Verdict {
    let loops = Vec::from_iter(plan.loops.iter().zip(timelines));
    let mut way = Way::new(loops.len() as u64);
    let verdicts = loops.iter().map(|(own, timeline)| {
        let evidence = Evidence::new(timeline, own, circumstances);
        let verdict = judge_loop(plan, &evidence.among(&plan.shared.contours, &loops));
        way.go(1);
        verdict
    });
    whole(plan, verdicts.collect())
}

/// The verdict of one loop. The contours are among the rows of their first loop.
fn judge_loop(plan: &Plan, evidence: &Evidence<'_>) -> Verdict {
    let circumstances = evidence.circumstances;
    let mut metrics = metrics(evidence);
    let (outcome, reason) = match &circumstances.ended_early {
        None => decide(evidence, &mut metrics),
        Some(end) => {
            // What a node kept from being seen is missed; of what the bench broke off only the traffic says something.
            let is_kept = |metric: &Metric| {
                end.by == EndedBy::Node || is_of_traffic(&metric.name) && metric.value.is_some()
            };
            metrics.retain(is_kept);
            decide_broken(evidence, end, &mut metrics)
        }
    };
    let unrecorded = &circumstances.unrecorded;
    Verdict {
        outcome,
        reason,
        frames_lost: unrecorded.frames_lost,
        fd_frames: unrecorded.fd_frames,
        ended_early: circumstances.ended_early.clone(),
        metrics,
        losses: fd_frames(unrecorded)
            .into_iter()
            .chain(losses(evidence))
            .collect(),
        ..Verdict::incomplete_of(plan, "")
    }
}

/// A run that broke off: what its traffic shows is reported, and what went wrong until then. A node's end is a failure, unless
/// the machine stood still while the node was amiss; a bus that is loaded beyond its limit is a failed limit, with what came of
/// it as the reason.
fn decide_broken(
    evidence: &Evidence<'_>,
    end: &EarlyEnd,
    metrics: &mut [Metric],
) -> (Outcome, Option<String>) {
    if let Some(reason) = overload(metrics) {
        return (Outcome::Fail, Some(format!("{reason}; {end}")));
    }
    if end.by != EndedBy::Node {
        return (Outcome::Incomplete, Some(end.to_string()));
    }
    match excuse_of_end(evidence.timeline, &evidence.circumstances.stalls, end) {
        None => (Outcome::Fail, Some(end.to_string())),
        Some(stall) => {
            metrics.iter_mut().for_each(leave_open);
            let stall = stall.words();
            let reason = format!(
                "{stall}, so the end of the run proves nothing ({end}); run it again or use --clock lockstep"
            );
            (Outcome::Inconclusive, Some(reason))
        }
    }
}

/// A run that was played to its end, or a recording that ends somewhere. Opens the limits that the bench's misses explain.
fn decide(evidence: &Evidence<'_>, metrics: &mut [Metric]) -> (Outcome, Option<String>) {
    if let Some(reason) = overload(metrics) {
        return (Outcome::Fail, Some(reason));
    }
    // Of what somebody else led, nothing says anything of the nodes under test.
    if let Some(reason) = second_master(evidence.timeline) {
        return (Outcome::Inconclusive, Some(reason));
    }
    let unrecorded = &evidence.circumstances.unrecorded;
    // What is missing in the log was not missing on the bus.
    let is_log_whole = unrecorded.strange_lines.is_none();
    if let Some(reason) = missed_by_nodes(evidence).filter(|_| is_log_whole) {
        return (Outcome::Fail, Some(reason));
    }
    if let Some(reason) = incomplete_recording(unrecorded) {
        return (Outcome::Inconclusive, Some(reason));
    }
    let of_commands = open_commands(evidence, metrics);
    let excuse = Excuse::find(evidence, MISSED_CYCLES_PERCENT_MAX);
    let excused = excuse.and_then(|excuse| excuse.open_limits(evidence, metrics));
    let excused = excused.or(of_commands);
    let is_failed = |metric: &Metric| metric.passed == Some(false);
    if let Some(reason) = cut_short(evidence.timeline, evidence.own) {
        (Outcome::Incomplete, Some(reason))
    } else if metrics.iter().any(is_failed) {
        (Outcome::Fail, None)
    } else if excused.is_some() {
        (Outcome::Inconclusive, excused)
    } else {
        match not_judged(metrics).or_else(|| unknown_load(metrics, unrecorded)) {
            None => (Outcome::Pass, None),
            reason => (Outcome::Inconclusive, reason),
        }
    }
}

/// Why a run fails whose nodes left out too many cycles, or commands in them: more than the limit says, or than can be where it has
/// none; or all from some time on to the end.
fn missed_by_nodes(evidence: &Evidence<'_>) -> Option<String> {
    let limit = (evidence.scenario.expect.limit(MISSED_CYCLES))
        .and_then(|limit| limit.max)
        .unwrap_or(MISSED_CYCLES_PERCENT_MAX);
    let misses = evidence.misses();
    let lost = evidence.circumstances.unrecorded.frames_lost;
    let period_seconds = evidence.timeline.period_seconds;
    let totals = misses.totals();
    let reason = totals
        .too_many_by_nodes(limit, lost)
        .or_else(|| totals.silent_at_end(misses.due.saturating_sub(1), period_seconds, lost))
        .or_else(|| missed_by_controller(evidence))?;
    let load = evidence.timeline.bus_load_percent;
    Some(match load > BUSY_BUS_PERCENT {
        true => format!("{reason}; the bus is nearly full (load {load:.1} %)"),
        false => reason,
    })
}

/// The reason of a verdict on a bus that is loaded beyond its limit, or beyond what any bus carries.
fn overload(metrics: &[Metric]) -> Option<String> {
    let load = metrics.iter().find(|metric| metric.name == BUS_LOAD)?;
    let percent = load.value.unwrap_or(f64::NAN);
    if percent > LOAD_PERCENT_MAX {
        return Some(format!(
            "the bus load is {percent:.1} %: no bus carries that at this bit rate, only a virtual one; send less, or raise [bus] bitrate_kilobits_per_second"
        ));
    }
    (load.passed == Some(false))
        .then(|| format!("the bus is overloaded ({percent:.1} %), so frames come late"))
}

/// Why a limit on the bus load is not met for certain.
fn unknown_load(metrics: &[Metric], unrecorded: &Unrecorded) -> Option<String> {
    let is_limited = |metric: &Metric| metric.name == BUS_LOAD && metric.limit.is_some();
    let fd_frames = fd_frames(unrecorded)?;
    metrics
        .iter()
        .any(is_limited)
        .then(|| format!("the bus load is not known: {fd_frames}"))
}

/// CAN FD frames that were on the bus, for people.
fn fd_frames(unrecorded: &Unrecorded) -> Option<String> {
    let frames = unrecorded.fd_frames;
    (frames > 0).then(|| {
        let noun = if frames == 1 { "frame" } else { "frames" };
        format!("{frames} CAN FD {noun} on the bus, not recorded: canrig reads classic CAN")
    })
}

/// The errors among the events, with their times, for people.
fn losses(evidence: &Evidence<'_>) -> Vec<String> {
    let end_seconds = evidence.end_seconds();
    let is_error = |event: &Occurrence<'_, Event>| {
        event.level == Level::Error && event.time_seconds <= end_seconds
    };
    let errors = evidence
        .timeline
        .events
        .iter()
        .filter(is_error)
        .take(LOSSES_MAX);
    errors
        .map(|event| format!("{:.3} s {}", event.time_seconds, event.text))
        .collect()
}
