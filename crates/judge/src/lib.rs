//! From a timeline to a verdict. Nothing but the recording counts.

mod harmonic;
mod metrics;
mod reactions;
mod sequences;
mod signals;
pub mod timing;
pub mod verdict;

use scenario::Scenario;
use scenario::expect::Expect;

use crate::timing::Timing;
use crate::verdict::{Metric, Outcome, Verdict};
use metrics::Run;
use recording::events::{Level, TimelineEvent};
use recording::timeline::Timeline;
use rig::setup::Setup;

pub use metrics::SETTLING_BAND;

/// With more missed cycles than this, control metrics decide nothing.
const MISSED_CYCLES_PERCENT_MAX: f64 = 1.0;
/// From this load on, a cycle that carries more than the others does not end in its time.
const BUSY_BUS_PERCENT: f64 = 70.0;
/// With faults the plant tells the truth every 10 ms at least.
const FAULTY_END_SECONDS: f64 = 0.05;

/// Losses that a verdict tells at most.
const LOSSES_MAX: usize = 20;

/// The metric that decides before all others: on an overloaded bus nothing else means anything.
const BUS_LOAD: &str = "bus_load_percent";

/// Metrics that a busy host makes worse.
const HOST_METRICS: [&str; 2] = ["missed_cycles_percent", "sync_interval_milliseconds_max"];

/// Judges a run that broke off. Only what the traffic tells is reported, and what went wrong until then; a bus that is
/// loaded beyond its limit is a failed limit, with what came of it as the reason.
#[must_use]
pub fn judge_broken(timeline: &Timeline, setup: &Setup, error: &str) -> Verdict {
    let run = Run::new(timeline, setup);
    let mut metrics = run.metrics();
    metrics.retain(|metric| {
        matches!(
            metric.name.as_str(),
            BUS_LOAD | "sync_interval_milliseconds_max" | "missed_cycles_percent"
        ) && metric.value.is_some()
    });
    let mut verdict = Verdict::incomplete_of(setup, error);
    if let Some(reason) = overload(&metrics) {
        verdict.outcome = Outcome::Fail;
        verdict.reason = Some(format!("{reason}; {error}"));
    }
    verdict.metrics = metrics;
    verdict.losses = losses(timeline, &setup.scenario);
    verdict
}

/// Adds the timing of a run in real time and judges its limits. Where the timing is not trusted they are neither met nor
/// missed, and the run cannot pass.
pub fn judge_timing(verdict: &mut Verdict, timing: Timing, expect: &Expect) {
    let untold = not_judged(&verdict.metrics);
    let mut metrics = timing.metrics(&expect.timing);
    for metric in &mut metrics {
        let own = expect.requirements.get(&metric.name);
        metric.requirements = own.cloned().unwrap_or_default();
    }
    if !timing.distrust.is_empty() {
        metrics.iter_mut().for_each(|metric| metric.passed = None);
        // These are met by luck at worst, but missed by the machine.
        let late = verdict.metrics.iter_mut().filter(|metric| {
            HOST_METRICS.contains(&metric.name.as_str()) && metric.passed == Some(false)
        });
        late.for_each(|metric| metric.passed = None);
    }
    verdict.metrics.extend(metrics);
    let is_open = match verdict.outcome {
        Outcome::Pass | Outcome::Fail => true,
        // Only for what nobody tells; what the timing adds may fail still.
        Outcome::Inconclusive => untold.is_some() && verdict.reason == untold,
        Outcome::Incomplete => false,
    };
    if is_open {
        let limited = verdict
            .metrics
            .iter()
            .filter(|metric| metric.limit.is_some());
        let results: Vec<Option<bool>> = limited.map(|metric| metric.passed).collect();
        if results.contains(&Some(false)) {
            (verdict.outcome, verdict.reason) = (Outcome::Fail, None);
        } else if results.contains(&None) {
            let distrust = timing.distrust.join("; ");
            let late = (not_judged(&verdict.metrics) != untold)
                .then(|| format!("the timing cannot be judged: {distrust}"));
            let reasons: Vec<String> = untold.into_iter().chain(late).collect();
            verdict.outcome = Outcome::Inconclusive;
            verdict.reason = Some(reasons.join("; "));
        }
    }
    verdict.timing = Some(timing);
}

/// What to say of a bus load beyond its limit.
fn overload(metrics: &[Metric]) -> Option<String> {
    let load = metrics.iter().find(|metric| metric.name == BUS_LOAD)?;
    (load.passed == Some(false)).then(|| {
        let percent = load.value.unwrap_or(f64::NAN);
        format!("the bus is overloaded ({percent:.1} %), so frames come late")
    })
}

/// Judges a run.
#[must_use]
pub fn judge(timeline: &Timeline, setup: &Setup, frames_lost: u64) -> Verdict {
    let scenario = &setup.scenario;
    let run = Run::new(timeline, setup);
    let metrics = run.metrics();
    let (outcome, reason) = outcome(timeline, scenario, &metrics, frames_lost);
    Verdict {
        schema: 1,
        scenario: scenario.name.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: scenario.seed,
        requirements: scenario.requirements.clone(),
        external: setup.external.clone(),
        outcome,
        reason,
        frames_lost,
        metrics,
        losses: losses(timeline, scenario),
        timing: None,
    }
}

/// The errors among the events, with their times, for people.
fn losses(timeline: &Timeline, scenario: &Scenario) -> Vec<String> {
    let end_seconds = timeline
        .zero_seconds
        .map_or(f64::INFINITY, |_| scenario.duration_seconds);
    let is_error =
        |event: &&TimelineEvent| event.level == Level::Error && event.time_seconds <= end_seconds;
    let errors = timeline.events.iter().filter(is_error).take(LOSSES_MAX);
    errors
        .map(|event| format!("{:.3} s {}", event.time_seconds, event.text))
        .collect()
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
    if let Some(undecided) = undecided(timeline, scenario) {
        return undecided;
    }
    if metrics.iter().any(|metric| metric.passed == Some(false)) {
        return (Outcome::Fail, None);
    }
    match not_judged(metrics) {
        None => (Outcome::Pass, None),
        reason => (Outcome::Inconclusive, reason),
    }
}

/// Says so when a limit is on something that nobody on the bus tells: such a run does not pass.
fn not_judged(metrics: &[Metric]) -> Option<String> {
    let undecided = |metric: &&Metric| metric.limit.is_some() && metric.passed.is_none();
    let names = metrics
        .iter()
        .filter(undecided)
        .map(|metric| metric.name.as_str());
    let names: Vec<&str> = names.collect();
    (!names.is_empty()).then(|| format!("not judged: {}", names.join(", ")))
}

/// Says so when the recording is not good enough. In a scenario with faults, cycles are missed on purpose.
fn undecided(timeline: &Timeline, scenario: &Scenario) -> Option<(Outcome, Option<String>)> {
    let planned = scenario.duration_seconds;
    let is_sound = scenario.fault.is_empty();
    if let Some(reason) = too_many_missed(timeline).filter(|_| is_sound) {
        return Some((Outcome::Inconclusive, Some(reason)));
    }
    if timeline.zero_seconds.is_none() && has_boot_fault(scenario) {
        return None;
    }
    let (reached, tolerance) = if is_sound {
        (timeline.due_seconds(), 1.5 * timeline.period_seconds)
    } else {
        (timeline.last_frame_seconds, FAULTY_END_SECONDS)
    };
    (timeline.zero_seconds.is_none() || reached + tolerance < planned).then(|| {
        let reached = timeline.zero_seconds.map_or(0.0, |_| reached);
        let reason = format!("the recording ends after {reached:.3} s of {planned} s");
        (Outcome::Incomplete, Some(reason))
    })
}

/// A fault with which the scenario need not begin.
fn has_boot_fault(scenario: &Scenario) -> bool {
    let windows = scenario.fault.windows();
    windows.iter().any(|fault| fault.from_seconds.is_none())
}

/// What is said of frames that are missing in a recording.
#[must_use]
pub fn lost_frames(lost: u64) -> String {
    format!("the recorder lost {lost} frames")
}

/// Says so when too many cycles were missed for anything to be decided.
#[must_use]
pub fn too_many_missed(timeline: &Timeline) -> Option<String> {
    let missed = timeline.missed_cycles_percent();
    (missed > MISSED_CYCLES_PERCENT_MAX).then(|| {
        let load = timeline.bus_load_percent;
        let cause = if load > BUSY_BUS_PERCENT {
            format!("the bus is nearly full (load {load:.1} %)")
        } else {
            "the machine was too busy for real time; try --clock lockstep".to_owned()
        };
        format!(
            "{missed:.1} % of the cycles were missed (limit {MISSED_CYCLES_PERCENT_MAX} %): {cause}"
        )
    })
}

#[cfg(test)]
mod tests;
