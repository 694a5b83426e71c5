//! What the run did about its faults, from the recording alone.

use canopen::cia402::State;
use scenario::Scenario;
use scenario::events::Window;
use scenario::expect::{Emergency, Limit};

use super::metrics::{Run, Value, largest, recovery};
use crate::verdict::Metric;
use recording::timeline::{Column, Timeline};
use recording::truth::PlantTruth;

/// Without current for so long counts as current 0: a law may command no current for some cycles.
const WITHOUT_CURRENT_SECONDS: f64 = 0.1;
/// What is looked at to tell the state at the end.
const END_SECONDS: f64 = 0.1;

const STATUSWORD: &str = "statusword_state";
/// How the signals are called that tell how warm the current makes a plant.
const TEMPERATURE: &str = "_temperature_celsius";
const ESTIMATED: &str = "estimated_";

/// The metrics of faults: all in a scenario with faults, only what is limited in others.
pub(super) fn metrics(run: &Run<'_>) -> Vec<Metric> {
    let expect = &run.scenario.expect;
    let mut metrics = Vec::new();
    if expect.temperature_celsius.is_some() || !run.scenario.fault.is_empty() {
        let name = "temperature_celsius";
        let limit = expect.temperature_celsius;
        metrics.push(match temperature_max(run.timeline) {
            Ok(temperature) => Metric::new(name, Ok(temperature), limit),
            Err(_) => untold(name, limit),
        });
    }
    if !expect.no_event.is_empty() {
        let unwanted = unwanted_events(run);
        let value = match unwanted.first() {
            None => Ok(0.0),
            Some(text) => Err(format!("there is \"{text}\"")),
        };
        metrics.push(Metric::new("no_event", value, exactly(0.0)));
    }
    if !run.scenario.fault.is_empty() {
        metrics.extend(of_faults(run));
    }
    metrics
}

/// What only the emulated plant tells, where there is none.
pub(super) fn untold(name: impl Into<String>, limit: Option<Limit>) -> Metric {
    let reason = "not available: only the emulated plant tells it".to_owned();
    Metric::not_judged(name, reason, limit)
}

fn of_faults(run: &Run<'_>) -> Vec<Metric> {
    let expect = &run.scenario.expect;
    let mut metrics = Vec::new();
    let within = |max: f64| Limit {
        min: None,
        max: Some(max),
    };
    let of_truth = |name, value: Value, limit| match run.timeline.truth.is_empty() {
        false => Metric::new(name, value, limit),
        true => untold(name, limit),
    };
    metrics.push(of_truth(
        "current_zero_within_milliseconds",
        current_zero(run).map(|seconds| seconds * 1e3),
        expect.current_zero_within_milliseconds.map(within),
    ));
    if !run.scenario.reference.is_empty() {
        metrics.push(Metric::new(
            "recovers_within_seconds",
            recovery_from_faults(run),
            expect.recovers_within_seconds.map(within),
        ));
    }
    let state = if is_safe_at_end(run) { 1.0 } else { 0.0 };
    let wanted = expect.safe_state.map(|safe| if safe { 1.0 } else { 0.0 });
    metrics.push(of_truth("safe_state", Ok(state), wanted.and_then(exactly)));
    if !expect.emcy.is_empty() {
        let missing = missing_emergencies(run);
        let value = match missing.as_slice() {
            [] => Ok(0.0),
            missing => Err(format!("{} was not told", missing.join(", "))),
        };
        metrics.push(Metric::new("emcy", value, exactly(0.0)));
    }
    metrics
}

fn exactly(value: f64) -> Option<Limit> {
    Some(Limit {
        min: Some(value),
        max: Some(value),
    })
}

/// The plant's own peaks, and the drive's view of the truth where the plant is silent.
fn temperature_max(timeline: &Timeline) -> Value {
    let peaks = timeline.truth.iter();
    let peaks = peaks.map(|truth| truth.peak_temperature_celsius);
    let is_true = |column: &&Column| {
        column.name.ends_with(TEMPERATURE) && !column.name.starts_with(ESTIMATED)
    };
    let columns = timeline.columns.iter().filter(is_true);
    let sampled = columns.flat_map(|column| column.values.iter());
    let temperatures = peaks.chain(sampled.copied());
    largest(temperatures.filter(|temperature| !temperature.is_nan()))
        .map_err(|_| "no temperature in the recording".to_owned())
}

/// When the first fault begins; those of the boot do at the start of the recording.
fn first_fault_seconds(scenario: &Scenario) -> f64 {
    let windows = scenario.fault.windows();
    let starts = windows.iter().map(|fault| fault.from_seconds);
    starts
        .map(|start| start.unwrap_or(f64::NEG_INFINITY))
        .fold(f64::INFINITY, f64::min)
}

/// From the first fault to the start of the first stretch without current.
fn current_zero(run: &Run<'_>) -> Value {
    let truth = &run.timeline.truth;
    let Some(first) = truth.first() else {
        return Err("the plant tells no truth".to_owned());
    };
    let fault = first_fault_seconds(run.scenario).max(first.time_seconds);
    let mut zero_since = None;
    for pair in truth.windows(2) {
        let (from, until) = (pair[0].time_seconds.max(fault), pair[1].time_seconds);
        if until <= from {
            continue;
        }
        if is_heated(&pair[0]) {
            zero_since = None;
            continue;
        }
        let since = *zero_since.get_or_insert(from);
        if until - since >= WITHOUT_CURRENT_SECONDS {
            return Ok(since - fault);
        }
    }
    Err("current flows on".to_owned())
}

fn is_heated(truth: &PlantTruth) -> bool {
    truth.current_amperes != 0.0
}

fn recovery_from_faults(run: &Run<'_>) -> Value {
    let windows = run.scenario.fault.windows();
    let ends = windows.iter().map(|fault| match fault.from_seconds {
        // Booting is over when the scenario begins.
        None => Some(0.0),
        Some(_) => fault.until_seconds,
    });
    let Some(ends) = ends.collect::<Option<Vec<f64>>>() else {
        return Err("a fault lasts to the end".to_owned());
    };
    let from_seconds = ends.into_iter().fold(0.0, f64::max);
    let until_seconds = run.scenario.duration_seconds;
    if from_seconds >= until_seconds || run.timeline.end_seconds() + END_SECONDS < until_seconds {
        return Err("not recovered".to_owned());
    }
    let window = Window {
        from_seconds,
        until_seconds,
    };
    recovery(run, window)
}

/// No current in the wire at the end, and a drive that is not enabled, or silent.
fn is_safe_at_end(run: &Run<'_>) -> bool {
    let timeline = run.timeline;
    let end = if timeline.zero_seconds.is_some() {
        run.scenario.duration_seconds
    } else {
        f64::INFINITY
    };
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

fn missing_emergencies(run: &Run<'_>) -> Vec<String> {
    let is_told = |wanted: &Emergency| {
        let mut told = run.timeline.emergencies.iter();
        told.any(|told| told.emergency == *wanted && told.time_seconds <= end_seconds(run))
    };
    let wanted = run.scenario.expect.emcy.iter();
    let missing = wanted.filter(|text| !text.parse().is_ok_and(|wanted| is_told(&wanted)));
    missing.cloned().collect()
}

fn unwanted_events<'a>(run: &Run<'a>) -> Vec<&'a str> {
    let unwanted = &run.scenario.expect.no_event;
    let events = run.timeline.events.iter();
    let events = events.filter(|event| event.time_seconds <= end_seconds(run));
    let texts = events.map(|event| event.text.as_str());
    texts
        .filter(|text| unwanted.iter().any(|part| text.contains(part.as_str())))
        .collect()
}

/// The end of the scenario; of the recording, if it never began.
fn end_seconds(run: &Run<'_>) -> f64 {
    match run.timeline.zero_seconds {
        Some(_) => run.scenario.duration_seconds,
        None => f64::INFINITY,
    }
}
