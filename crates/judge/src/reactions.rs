//! What the run did about its faults, from the recording alone. Without faults most of it means nothing.

use canopen::cia402::State;
use recording::timeline::{Column, Timeline};
use recording::truth::PlantTruth;
use scenario::Scenario;
use scenario::events::Window;
use scenario::expect::Emergency;

use crate::disturbances::recovery;
use crate::evidence::{Evidence, Measurement, MetricValue, largest};

/// Without current for so long counts as current 0: a law may command no current for some cycles.
const WITHOUT_CURRENT_SECONDS: f64 = 0.1;
/// The state at the end is that of this time before it.
const END_SECONDS: f64 = 0.1;

const STATUSWORD: &str = "statusword_state";
/// How the names of signals end that report how warm the current makes a plant.
const TEMPERATURE: &str = "_temperature_celsius";
const ESTIMATED: &str = "estimated_";

/// The highest temperature: in a scenario with faults always, in others where it is limited.
pub(crate) fn temperature_max(evidence: &Evidence<'_>) -> Measurement {
    let scenario = evidence.scenario;
    if scenario.expect.temperature_celsius.is_none() && scenario.fault.is_empty() {
        return Measurement::NotAsked;
    }
    let mut temperatures = temperatures(evidence.timeline).peekable();
    match temperatures.peek() {
        Some(_) => Measurement::Measured(largest(temperatures)),
        None => Measurement::only_emulated(),
    }
}

/// The plant's own peaks, and the drive's view of the truth where the plant is silent.
fn temperatures(timeline: &Timeline) -> impl Iterator<Item = f64> {
    let peaks = timeline.truth.iter();
    let peaks = peaks.map(|truth| truth.peak_temperature_celsius);
    let is_true = |column: &&Column| {
        column.name.ends_with(TEMPERATURE) && !column.name.starts_with(ESTIMATED)
    };
    let columns = timeline.columns.iter().filter(is_true);
    let sampled = columns.flat_map(|column| column.values.iter());
    let temperatures = peaks.chain(sampled.copied());
    temperatures.filter(|temperature| !temperature.is_nan())
}

/// 0 where no event has a text that none may have.
pub(crate) fn unwanted_events(evidence: &Evidence<'_>) -> Measurement {
    let unwanted = &evidence.scenario.expect.no_event;
    if unwanted.is_empty() {
        return Measurement::NotAsked;
    }
    let is_unwanted = |text: &str| unwanted.iter().any(|part| text.contains(part.as_str()));
    let mut events = evidence.timeline.events.iter();
    let found = events
        .find(|event| event.time_seconds <= evidence.end_seconds() && is_unwanted(&event.text));
    Measurement::Measured(match found {
        None => Ok(0.0),
        Some(event) => Err(format!("there is \"{}\"", event.text)),
    })
}

/// Milliseconds from the first fault to the start of the first stretch without current.
pub(crate) fn current_zero(evidence: &Evidence<'_>) -> Measurement {
    if evidence.scenario.fault.is_empty() {
        return Measurement::NotAsked;
    }
    let truth = &evidence.timeline.truth;
    let Some(first) = truth.first() else {
        return Measurement::only_emulated();
    };
    let fault = first_fault_seconds(evidence.scenario).max(first.time_seconds);
    let zero = zero_since(truth, fault).map(|since| 1e3 * (since - fault));
    Measurement::Measured(zero.ok_or_else(|| "current flows on".to_owned()))
}

/// When the first fault begins; those of the boot do at the start of the recording.
fn first_fault_seconds(scenario: &Scenario) -> f64 {
    let windows = scenario.fault.windows();
    let starts = windows.iter().map(|fault| fault.from_seconds);
    starts
        .map(|start| start.unwrap_or(f64::NEG_INFINITY))
        .fold(f64::INFINITY, f64::min)
}

/// The start of the first stretch without current after a fault.
fn zero_since(truth: &[PlantTruth], fault_seconds: f64) -> Option<f64> {
    let mut zero_since = None;
    for pair in truth.windows(2) {
        let (from, until) = (
            pair[0].time_seconds.max(fault_seconds),
            pair[1].time_seconds,
        );
        if until <= from {
            continue;
        }
        if is_heated(&pair[0]) {
            zero_since = None;
            continue;
        }
        let since = *zero_since.get_or_insert(from);
        if until - since >= WITHOUT_CURRENT_SECONDS {
            return Some(since);
        }
    }
    None
}

fn is_heated(truth: &PlantTruth) -> bool {
    truth.current_amperes != 0.0
}

/// From the end of the last fault until the deviation stays small.
pub(crate) fn recovery_from_faults(evidence: &Evidence<'_>) -> Measurement {
    let scenario = evidence.scenario;
    if scenario.fault.is_empty() || scenario.reference.is_empty() {
        return Measurement::NotAsked;
    }
    Measurement::Measured(recovery_after(evidence, last_fault_end_seconds(scenario)))
}

/// None where a fault lasts to the end.
fn last_fault_end_seconds(scenario: &Scenario) -> Option<f64> {
    let windows = scenario.fault.windows();
    let ends = windows.iter().map(|fault| match fault.from_seconds {
        // Booting is over when the scenario begins.
        None => Some(0.0),
        Some(_) => fault.until_seconds,
    });
    let ends = ends.collect::<Option<Vec<f64>>>()?;
    Some(ends.into_iter().fold(0.0, f64::max))
}

fn recovery_after(evidence: &Evidence<'_>, fault_end_seconds: Option<f64>) -> MetricValue {
    let from_seconds = fault_end_seconds.ok_or("a fault lasts to the end")?;
    let until_seconds = evidence.scenario.duration_seconds;
    let is_cut = evidence.timeline.end_seconds() + END_SECONDS < until_seconds;
    if from_seconds >= until_seconds || is_cut {
        return Err("not recovered".to_owned());
    }
    let window = Window {
        from_seconds,
        until_seconds,
    };
    recovery(evidence, window)
}

/// 1 where the bench is safe at the end, else 0.
pub(crate) fn safe_state(evidence: &Evidence<'_>) -> Measurement {
    if evidence.scenario.fault.is_empty() {
        return Measurement::NotAsked;
    }
    if evidence.timeline.truth.is_empty() {
        return Measurement::only_emulated();
    }
    let is_safe = is_safe_at_end(evidence);
    Measurement::Measured(Ok(if is_safe { 1.0 } else { 0.0 }))
}

/// No current in the wire at the end, and a drive that is not enabled, or silent.
fn is_safe_at_end(evidence: &Evidence<'_>) -> bool {
    let (timeline, end) = (evidence.timeline, evidence.end_seconds());
    let before_end = timeline.truth.iter();
    let before_end = before_end.filter(|truth| truth.time_seconds <= end);
    let Some(last) = before_end.clone().next_back() else {
        return false;
    };
    let from = last.time_seconds - END_SECONDS;
    let mut lately = before_end.filter(|truth| truth.time_seconds >= from);
    !lately.any(is_heated) && !is_enabled_since(timeline, end.min(last.time_seconds) - END_SECONDS)
}

/// Whether the drive reports Operation enabled in its last message after a time.
fn is_enabled_since(timeline: &Timeline, from_seconds: f64) -> bool {
    let Some(column) = timeline.column(STATUSWORD) else {
        return false;
    };
    let mut rows = timeline.time_seconds.iter().zip(&column.values);
    let last = rows.rfind(|(time, value)| **time >= from_seconds && !value.is_nan());
    last.is_some_and(|(_, value)| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a signal of 7 bits"
        )]
        let statusword = *value as u16;
        State::from_statusword(statusword) == Some(State::OperationEnabled)
    })
}

/// 0 where all emergencies that are demanded came.
pub(crate) fn missing_emergencies(evidence: &Evidence<'_>) -> Measurement {
    let demanded = &evidence.scenario.expect.emcy;
    if evidence.scenario.fault.is_empty() || demanded.is_empty() {
        return Measurement::NotAsked;
    }
    let came = |wanted: &Emergency| {
        let mut emergencies = evidence.timeline.emergencies.iter();
        emergencies
            .any(|one| one.emergency == *wanted && one.time_seconds <= evidence.end_seconds())
    };
    let is_missing = |text: &&String| !text.parse().is_ok_and(|wanted| came(&wanted));
    let missing: Vec<&str> = demanded
        .iter()
        .filter(is_missing)
        .map(String::as_str)
        .collect();
    Measurement::Measured(match missing.as_slice() {
        [] => Ok(0.0),
        missing => Err(format!("{} was not sent", missing.join(", "))),
    })
}
