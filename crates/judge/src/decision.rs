//! Decides the outcome of a run by its metrics, by whose doing its missed cycles were, and by who ended it.

use recording::ending::{EarlyEnd, EndedBy};
use recording::events::{Level, TimelineEvent};
use recording::timeline::Timeline;
use rig::setup::Setup;

use crate::circumstances::Circumstances;
use crate::evidence::Evidence;
use crate::excuse::{Excuse, MISSED_CYCLES, leave_open};
use crate::metric::{Metric, not_judged};
use crate::metrics::metrics;
use crate::misses::excuse_of_end;
use crate::quality::{cut_short, lost_frames};
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
/// The metrics of the traffic, which a run that broke off has too.
const TRAFFIC_METRICS: [&str; 3] = [BUS_LOAD, "sync_interval_milliseconds_max", MISSED_CYCLES];

/// Judges a run.
#[must_use]
pub fn judge(timeline: &Timeline, setup: &Setup, circumstances: &Circumstances) -> Verdict {
    let evidence = Evidence::new(timeline, setup, circumstances);
    let mut metrics = metrics(&evidence);
    let (outcome, reason) = match &circumstances.ended_early {
        None => decide(&evidence, &mut metrics),
        Some(end) => {
            // What a node kept from being seen is missed; of what the bench broke off only the traffic says something.
            let is_kept = |metric: &Metric| {
                end.by == EndedBy::Node
                    || TRAFFIC_METRICS.contains(&metric.name.as_str()) && metric.value.is_some()
            };
            metrics.retain(is_kept);
            decide_broken(&evidence, end, &mut metrics)
        }
    };
    Verdict {
        outcome,
        reason,
        frames_lost: circumstances.frames_lost,
        ended_early: circumstances.ended_early.clone(),
        metrics,
        losses: losses(&evidence),
        ..Verdict::incomplete_of(setup, "")
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
    if let Some(reason) = missed_by_nodes(evidence) {
        return (Outcome::Fail, Some(reason));
    }
    let lost = evidence.circumstances.frames_lost;
    if lost > 0 {
        return (Outcome::Inconclusive, Some(lost_frames(lost)));
    }
    let excuse = Excuse::of(evidence, MISSED_CYCLES_PERCENT_MAX);
    let excused = match &excuse {
        Some(excuse) => excuse.open_limits(evidence, metrics),
        None => None,
    };
    let is_failed = |metric: &Metric| metric.passed == Some(false);
    if let Some(reason) = cut_short(evidence.timeline, evidence.scenario) {
        (Outcome::Incomplete, Some(reason))
    } else if metrics.iter().any(is_failed) {
        (Outcome::Fail, None)
    } else if excused.is_some() {
        (Outcome::Inconclusive, excused)
    } else {
        match not_judged(metrics) {
            None => (Outcome::Pass, None),
            reason => (Outcome::Inconclusive, reason),
        }
    }
}

/// Why a run fails whose nodes left out too many cycles: more than its limit says, or than can be where it has none.
fn missed_by_nodes(evidence: &Evidence<'_>) -> Option<String> {
    let limit = evidence.scenario.expect.missed_cycles_percent;
    let limit = limit.and_then(|limit| limit.max);
    let limit = limit.unwrap_or(MISSED_CYCLES_PERCENT_MAX);
    let misses = evidence.misses();
    let reason = misses.too_many_by_nodes(limit, evidence.circumstances.frames_lost)?;
    let load = evidence.timeline.bus_load_percent;
    Some(match load > BUSY_BUS_PERCENT {
        true => format!("{reason}; the bus is nearly full (load {load:.1} %)"),
        false => reason,
    })
}

/// The reason of a verdict on a bus that is loaded beyond its limit.
fn overload(metrics: &[Metric]) -> Option<String> {
    let load = metrics.iter().find(|metric| metric.name == BUS_LOAD)?;
    (load.passed == Some(false)).then(|| {
        let percent = load.value.unwrap_or(f64::NAN);
        format!("the bus is overloaded ({percent:.1} %), so frames come late")
    })
}

/// The errors among the events, with their times, for people.
fn losses(evidence: &Evidence<'_>) -> Vec<String> {
    let end_seconds = evidence.end_seconds();
    let is_error =
        |event: &&TimelineEvent| event.level == Level::Error && event.time_seconds <= end_seconds;
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
