//! Decides the outcome of a run by its metrics and by the quality of its recording.

use recording::events::{Level, TimelineEvent};
use recording::timeline::Timeline;
use rig::setup::Setup;
use scenario::Scenario;

use crate::evidence::Evidence;
use crate::metric::{Metric, not_judged};
use crate::metrics::metrics;
use crate::quality::{lost_frames, undecided};
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

/// Judges a run.
#[must_use]
pub fn judge(timeline: &Timeline, setup: &Setup, frames_lost: u64) -> Verdict {
    let scenario = &setup.scenario;
    let evidence = Evidence::new(timeline, setup);
    let metrics = metrics(&evidence);
    let (outcome, reason) = outcome(timeline, scenario, &metrics, frames_lost);
    Verdict {
        outcome,
        reason,
        frames_lost,
        metrics,
        losses: losses(&evidence),
        ..Verdict::incomplete_of(setup, "")
    }
}

/// Judges a run that broke off. Only what the traffic shows is reported, and what went wrong until then; a bus that is
/// loaded beyond its limit is a failed limit, with what came of it as the reason.
#[must_use]
pub fn judge_broken(timeline: &Timeline, setup: &Setup, error: &str) -> Verdict {
    let evidence = Evidence::broken(timeline, setup);
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
    lost: u64,
) -> (Outcome, Option<String>) {
    if let Some(reason) = overload(metrics) {
        return (Outcome::Fail, Some(reason));
    }
    if lost > 0 {
        return (Outcome::Inconclusive, Some(lost_frames(lost)));
    }
    if let Some((outcome, reason)) = undecided(timeline, scenario) {
        return (outcome, Some(reason));
    }
    if metrics.iter().any(|metric| metric.passed == Some(false)) {
        return (Outcome::Fail, None);
    }
    match not_judged(metrics) {
        None => (Outcome::Pass, None),
        reason => (Outcome::Inconclusive, reason),
    }
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
