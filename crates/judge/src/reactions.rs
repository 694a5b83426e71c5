//! The reactions of a run to its faults, from the recording alone. Without faults the plant does not report itself, so most
//! metrics have no value.

use canopen::cia402::State;
use dbc::{Signal, names};
use recording::events::word;
use recording::timeline::{Series, TIME_TOLERANCE_SECONDS};
use recording::truth::{PlantTruth, is_temperature};
use scenario::events::Window;
use scenario::expect::Emergency;

use crate::attribution::hits::span;
use crate::disturbances::recovery;
use crate::evidence::{Absence, Evidence, Known, Measurement, drive_silence_seconds_max, largest};

/// Time without current that counts as current 0: a law may command no current for some cycles.
const WITHOUT_CURRENT_SECONDS: f64 = 0.1;
/// Time before the end that shows the state at the end.
const END_SECONDS: f64 = 0.1;

/// Name of an emulated plant's report in messages.
const TRUTH: &str = "truth of the plant";

/// Measures the highest temperature: always in a scenario with faults, in others if it is limited.
pub(crate) fn temperature_max(evidence: &Evidence<'_>) -> Measurement {
    let trial = evidence.trial;
    if trial.expect.of("temperature_celsius").is_none() && !trial.has_loop_faults() {
        return Err(Absence::not_asked());
    }
    if !evidence.has_all() && temperatures(evidence).next().is_none() {
        return Err(Absence::left_out());
    }
    let mut temperatures = temperatures(evidence).peekable();
    if temperatures.peek().is_none() {
        let is_ours = evidence.control_loop.drive().is_ours();
        let reason = is_ours.then_some("not available: no temperature of the plant is known");
        return Err(reason.map_or_else(Absence::only_emulated, Absence::unavailable));
    }
    if let Some(reason) = unseen_temperature(evidence) {
        return Err(Absence::unavailable(reason));
    }
    if evidence.timeline.truth.is_empty() {
        evidence.seen(evidence.run()).map(drop)?;
    } else if let Some(silence) = silence_of_truth(evidence) {
        return Err(silence);
    }
    evidence.of_largest(evidence.run(), largest(temperatures))
}

/// Returns the reason if the drive sent no temperature for too long, and the plant does not report it by itself.
fn unseen_temperature(evidence: &Evidence<'_>) -> Option<String> {
    let timeline = evidence.timeline;
    let (from, until) = timeline
        .temperature_silence
        .filter(|_| timeline.truth.is_empty())?;
    let is_seen_otherwise =
        evidence.leaves_out(from, until) || evidence.seen(evidence.run()).is_err();
    (!is_seen_otherwise).then(|| format!("no temperature {}", Window::new(from, until)))
}

/// Returns the first silence between the plant's first message and the end.
fn silence_of_truth(evidence: &Evidence<'_>) -> Option<Absence> {
    let (timeline, truth) = (evidence.timeline, &evidence.timeline.truth);
    let first_seconds = truth.first()?.time_seconds;
    let window = match timeline.zero_seconds {
        Some(_) => Window {
            from_seconds: first_seconds.min(0.0),
            ..evidence.run()
        },
        None => Window::new(
            first_seconds,
            timeline.last_frame_seconds.max(first_seconds),
        ),
    };
    let times = truth
        .iter()
        .map(|truth| truth.time_seconds)
        .filter(|time| *time < window.until_seconds);
    let seconds_max = silence_of_truth_seconds_max(evidence);
    let silence = evidence.first_silence(times, window, seconds_max);
    silence.map(truth_silence)
}

fn silence_of_truth_seconds_max(evidence: &Evidence<'_>) -> f64 {
    drive_silence_seconds_max((evidence.database, evidence.control_loop), names::TRUTH)
}

fn truth_silence(silence: Window) -> Absence {
    Absence::unseen(format!("no {TRUTH} {silence}"), silence)
}

/// Returns the plant's own peaks, and the drive's view of the truth while the plant is silent.
fn temperatures(evidence: &Evidence<'_>) -> impl Iterator<Item = f64> {
    let timeline = evidence.timeline;
    let counts = |time: &f64| !evidence.leaves_out(*time, *time);
    let peaks = timeline
        .truth
        .iter()
        .filter(move |truth| counts(&truth.time_seconds))
        .map(|truth| truth.peak_temperature_celsius);
    let outputs = evidence.control_loop.plant_signals(evidence.database);
    let is_heated = |output: &&Signal| {
        is_temperature(output) && evidence.trial.wiring.is_of_plant(&output.name)
    };
    let heated = outputs.filter(is_heated);
    let columns = heated.filter_map(|output| timeline.column(&output.name));
    let sampled = columns.flat_map(move |column| {
        let rows = timeline.time_seconds.iter().zip(&column.values);
        rows.filter(move |(time, _)| counts(time))
            .map(|(_, value)| value)
    });
    let temperatures = peaks.chain(sampled);
    temperatures.filter(|temperature| !temperature.is_nan())
}

/// Measures unwanted events: 0 if no event has a text that is ruled out.
pub(crate) fn unwanted_events(evidence: &Evidence<'_>) -> Measurement {
    let unwanted = evidence.trial.expect.listed("no_event");
    if unwanted.is_empty() {
        return Err(Absence::not_asked());
    }
    let is_unwanted = |text: &str| unwanted.iter().any(|part| text.contains(part.as_str()));
    let mut events = evidence.timeline.events.iter();
    let found = events.find(|event| {
        event.time_seconds <= evidence.end_seconds()
            && is_unwanted(&event.text)
            && !evidence.leaves_out(event.time_seconds, event.time_seconds)
    });
    match found {
        Some(event) => Err(format!("there is \"{}\"", event.text).into()),
        None if evidence.is_cut_before(evidence.trial.run.duration_seconds) => {
            Err(Absence::unavailable("none until the recording ends"))
        }
        None => Ok(0.0.into()),
    }
}

/// Measures the time from the first fault to the start of the first stretch without current, in milliseconds.
pub(crate) fn current_zero(evidence: &Evidence<'_>) -> Measurement {
    let trial = evidence.trial;
    if !trial.has_loop_faults() {
        return without_faults(evidence, "{command}_zero_within_milliseconds");
    }
    let truth = &evidence.timeline.truth;
    let Some(first) = truth.first() else {
        return Err(Absence::only_emulated());
    };
    let faults = trial.loop_faults().map(|fault| span(fault).0);
    let fault = faults.fold(f64::INFINITY, f64::min).max(first.time_seconds);
    let silence_max = silence_of_truth_seconds_max(evidence);
    let window = Window::new(fault, f64::INFINITY);
    let value = |evidence: &Evidence<'_>, window: Window| {
        let seen = truth.partition_point(|one| one.time_seconds < window.until_seconds);
        let by_io = |from, until| io_node_drives_current(evidence, from, until);
        let zero = zero_since(&truth.part(0..seen), fault, silence_max, by_io);
        let zero = zero.map(|since| since - fault);
        let goes_on = || match evidence.command_name().as_str() {
            "current" => "current flows on".into(),
            command => format!("{command} stays on").into(),
        };
        zero.ok_or_else(|| silence_of_truth(evidence).unwrap_or_else(goes_on))
    };
    let zero = evidence.of_event(window, true, value)?;
    Ok(Known {
        value: 1e3 * zero.value,
        ..zero
    })
}

/// Returns the measurement of a value that the plant reports only if something can fail. A limit on it is not judged for a
/// recording without faults.
fn without_faults(evidence: &Evidence<'_>, metric: &str) -> Measurement {
    Err(if evidence.trial.expect.of(metric).is_some() {
        Absence::unavailable(format!("not available: without faults there is no {TRUTH}"))
    } else {
        Absence::not_asked()
    })
}

/// Returns the start of the first stretch without current after a fault. The current during a silence is unknown.
fn zero_since(
    truth: &Series<PlantTruth>,
    fault_seconds: f64,
    silence_seconds_max: f64,
    is_driven_by_io: impl Fn(f64, f64) -> bool,
) -> Option<f64> {
    let mut zero_since = None;
    for (one, next) in truth.pairs() {
        let (from, until) = (one.time_seconds.max(fault_seconds), next.time_seconds);
        if until <= from {
            continue;
        }
        if is_heated(&one)
            || is_driven_by_io(from, until)
            || until - one.time_seconds > silence_seconds_max + TIME_TOLERANCE_SECONDS
        {
            zero_since = None;
            continue;
        }
        let since = *zero_since.get_or_insert(from);
        if until - since >= WITHOUT_CURRENT_SECONDS - TIME_TOLERANCE_SECONDS {
            return Some(since);
        }
    }
    None
}

fn is_heated(truth: &PlantTruth) -> bool {
    truth.output != 0.0
}

/// Measures the time from the end of the last fault until the deviation stays small.
pub(crate) fn recovery_from_faults(evidence: &Evidence<'_>) -> Measurement {
    // Infinite if a fault lasts to the end.
    let ends = evidence.trial.position_faults().map(|fault| span(fault).1);
    let Some(from_seconds) = ends.reduce(f64::max) else {
        return Err(Absence::meaningless("no fault in the scenario"));
    };
    if from_seconds.is_infinite() {
        return Err(Absence::from("a fault lasts to the end"));
    }
    let window = Window {
        from_seconds,
        ..evidence.run()
    };
    let value = |evidence: &Evidence<'_>, window: Window| {
        if window.from_seconds >= window.until_seconds {
            return Err("not recovered".into());
        }
        recovery(evidence, window)
    };
    evidence.of_event(window, true, value)
}

/// Measures safety: 1 if the bench is safe at the end, else 0.
pub(crate) fn safe_state(evidence: &Evidence<'_>) -> Measurement {
    let trial = evidence.trial;
    if !trial.has_loop_faults() {
        return without_faults(evidence, "safe_state");
    }
    if evidence.timeline.truth.is_empty() {
        return Err(Absence::only_emulated());
    }
    let end = evidence.trial.run.duration_seconds;
    if evidence.leaves_out(end - END_SECONDS, end) {
        return Err(Absence::left_out());
    }
    if let Some(silence) = silence_at_end(evidence) {
        return Err(truth_silence(silence));
    }
    Ok(f64::from(is_safe_at_end(evidence)).into())
}

/// Returns the silence of the plant in which the scenario ended.
fn silence_at_end(evidence: &Evidence<'_>) -> Option<Window> {
    evidence.timeline.zero_seconds?;
    let end_seconds = evidence.trial.run.duration_seconds;
    let truth = evidence.timeline.truth.iter();
    let times = truth.map(|truth| truth.time_seconds);
    let latest = times
        .filter(|time| *time <= end_seconds)
        .fold(0.0, f64::max);
    let window = Window::new(latest, end_seconds);
    let seconds_max = silence_of_truth_seconds_max(evidence);
    evidence.first_silence([].into_iter(), window, seconds_max)
}

/// Returns whether no current flows at the end, and the drive is not enabled, or silent.
fn is_safe_at_end(evidence: &Evidence<'_>) -> bool {
    let (timeline, end) = (evidence.timeline, evidence.end_seconds());
    let truth = timeline.truth.iter();
    let before_end = truth.filter(|truth| truth.time_seconds <= end);
    let Some(last) = before_end.clone().last() else {
        return false;
    };
    let from = last.time_seconds - END_SECONDS;
    let mut lately = before_end.filter(|truth| truth.time_seconds >= from);
    !lately.any(|truth| is_heated(&truth))
        && !is_enabled_since(evidence, end.min(last.time_seconds) - END_SECONDS)
        && !io_node_drives_current(evidence, end - TIME_TOLERANCE_SECONDS, end)
}

/// Returns whether an io node lets a current flow through a plant of the loop, or of no loop, in a
/// span of time.
fn io_node_drives_current(evidence: &Evidence<'_>, from_seconds: f64, until_seconds: f64) -> bool {
    let mut spans = evidence.timeline.io_currents_seconds.iter();
    spans.any(|(from, until)| *from < until_seconds && *until > from_seconds)
}

/// Returns whether the drive reports Operation enabled in its last message after a time.
fn is_enabled_since(evidence: &Evidence<'_>, from_seconds: f64) -> bool {
    let column = evidence.timeline.column(names::STATUSWORD);
    let since = Window::new(from_seconds, f64::INFINITY);
    let last = column.and_then(|column| evidence.values(&column.values, since).last());
    last.is_some_and(|(_, word)| state(word) == Some(State::OperationEnabled))
}

/// Returns the state of a statusword.
pub(crate) fn state(statusword: f64) -> Option<State> {
    State::from_statusword(word(statusword))
}

/// Measures missing emergencies: 0 if all demanded ones came.
pub(crate) fn missing_emergencies(evidence: &Evidence<'_>) -> Measurement {
    let demanded = evidence.trial.expect.listed("emcy");
    if demanded.is_empty() {
        return Err(Absence::not_asked());
    }
    let came = |wanted: &Emergency| {
        let mut events = evidence.timeline.events.iter();
        events.any(|event| {
            event.emergency.as_ref() == Some(wanted) && event.time_seconds <= evidence.end_seconds()
        })
    };
    let is_missing = |text: &&String| !text.parse().is_ok_and(|wanted| came(&wanted));
    let silent = demanded.iter().filter(is_missing);
    let missing = Vec::from_iter(silent.map(String::as_str));
    if missing.is_empty() {
        return Ok(0.0.into());
    }
    let reason = format!("{} was not sent", missing.join(", "));
    Err(Absence::unseen(reason, evidence.run()))
}
