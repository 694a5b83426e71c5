//! Decides the outcome of a run by its metrics and by the quality of its recording.

use recording::events::{Level, TimelineEvent};
use recording::timeline::Timeline;
use recording::unrecorded::Unrecorded;
use rig::setup::Setup;
use scenario::Scenario;

use crate::evidence::Evidence;
use crate::metric::{Metric, not_judged};
use crate::metrics::metrics;
use crate::quality::{incomplete_recording, second_master, undecided};
use crate::verdict::{Outcome, Verdict};

/// Losses that a verdict lists at most.
const LOSSES_MAX: usize = 20;

/// The metric that decides before all others: on an overloaded bus nothing else means anything.
const BUS_LOAD: &str = "bus_load_percent";
/// The metrics of the traffic, which a run that broke off has too.
const TRAFFIC_METRICS: [&str; 3] = [
    BUS_LOAD,
    "sync_interval_milliseconds_max",
    "missed_cycles_percent",
];

/// More than any bus carries: 100 %, and some room for the stamps of short recordings.
const LOAD_PERCENT_MAX: f64 = 101.0;

/// Judges a run.
#[must_use]
pub fn judge(timeline: &Timeline, setup: &Setup, unrecorded: &Unrecorded) -> Verdict {
    let scenario = &setup.scenario;
    let evidence = Evidence::new(timeline, setup);
    let metrics = metrics(&evidence);
    let (outcome, reason) = outcome(timeline, scenario, &metrics, unrecorded);
    Verdict {
        outcome,
        reason,
        frames_lost: unrecorded.frames_lost,
        fd_frames: unrecorded.fd_frames,
        metrics,
        losses: fd_frames(unrecorded)
            .into_iter()
            .chain(losses(&evidence))
            .collect(),
        ..Verdict::incomplete_of(setup, "")
    }
}

/// Judges a run that broke off. Only what the traffic shows is reported, and what went wrong until then; a bus that is
/// loaded beyond its limit is a failed limit, with what came of it as the reason.
#[must_use]
pub fn judge_broken(timeline: &Timeline, setup: &Setup, error: &str) -> Verdict {
    let evidence = Evidence::new(timeline, setup);
    let mut metrics = metrics(&evidence);
    metrics
        .retain(|metric| TRAFFIC_METRICS.contains(&metric.name.as_str()) && metric.value.is_some());
    let mut verdict = Verdict::incomplete_of(setup, error);
    if let Some(reason) = overload(&metrics) {
        verdict.outcome = Outcome::Fail;
        verdict.reason = Some(format!("{reason}; {error}"));
    }
    verdict.metrics = metrics;
    verdict.losses = losses(&evidence);
    verdict
}

fn outcome(
    timeline: &Timeline,
    scenario: &Scenario,
    metrics: &[Metric],
    unrecorded: &Unrecorded,
) -> (Outcome, Option<String>) {
    if let Some(reason) = overload(metrics) {
        return (Outcome::Fail, Some(reason));
    }
    let doubt = incomplete_recording(unrecorded).or_else(|| second_master(timeline));
    if let Some(reason) = doubt {
        return (Outcome::Inconclusive, Some(reason));
    }
    if let Some((outcome, reason)) = undecided(timeline, scenario) {
        return (outcome, Some(reason));
    }
    if metrics.iter().any(|metric| metric.passed == Some(false)) {
        return (Outcome::Fail, None);
    }
    match not_judged(metrics).or_else(|| unknown_load(metrics, unrecorded)) {
        None => (Outcome::Pass, None),
        reason => (Outcome::Inconclusive, reason),
    }
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
