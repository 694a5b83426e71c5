//! Deviation of the position by a disturbance, and time to recover.

use recording::timeline::TIME_TOLERANCE_SECONDS;
use scenario::events::Window;

use crate::evidence::{Absence, EDGE, Evidence, Measurement, MetricValue, checked, largest, worst};

/// Time for which a disturbance is watched at least after its end; it is watched further until something else moves the loop.
const AFTER_DISTURBANCE_SECONDS: f64 = 3.0;

/// Returns the largest deviation during a disturbance.
pub(crate) fn maximum_deviation(evidence: &Evidence<'_>) -> Measurement {
    worst_disturbance(evidence, false, deviation)
}

/// Returns the longest recovery from a disturbance.
pub(crate) fn recovery_time(evidence: &Evidence<'_>) -> Measurement {
    worst_disturbance(evidence, true, recovery)
}

/// Returns the largest value over all disturbances. Without the io nodes on the bus there were none.
fn worst_disturbance(
    evidence: &Evidence<'_>,
    is_time: bool,
    metric: fn(&Evidence<'_>, Window) -> MetricValue,
) -> Measurement {
    if !evidence.timeline.is_disturbed {
        let reason = "not available: an io node is missing on the bus";
        return Err(Absence::unavailable(reason));
    }
    let windows = evidence.trial.judged_disturbances();
    let end_seconds = evidence.trial.judged_end_seconds();
    let windows = windows.iter().map(|disturbance| disturbance.window);
    let judged = windows.filter(|window| window.from_seconds < end_seconds);
    let values = judged.map(|window| {
        let least = window.until_seconds + AFTER_DISTURBANCE_SECONDS;
        let until_seconds = least.max(calm_until(evidence, window.until_seconds));
        let watched = Window {
            until_seconds: until_seconds.min(end_seconds),
            ..window
        };
        evidence.of_event(watched, is_time, metric)
    });
    worst(values)
}

/// Returns the first time after another at which the set-point changes, or a disturbance or a fault begins or ends.
fn calm_until(evidence: &Evidence<'_>, from_seconds: f64) -> f64 {
    let edges = evidence.trial.edges_seconds().into_iter();
    let changes = edges.chain(evidence.set_point_changes());
    let later = changes.filter(|time| *time > from_seconds + TIME_TOLERANCE_SECONDS);
    later.fold(f64::INFINITY, f64::min)
}

fn deviation(evidence: &Evidence<'_>, window: Window) -> MetricValue {
    let samples = evidence.seen(window)?;
    largest(samples.map(|sample| sample.deviation()))
}

/// Returns the time from the start of a window until the deviation stays small. The deviation in a silence is unknown.
pub(crate) fn recovery(evidence: &Evidence<'_>, window: Window) -> MetricValue {
    let period_seconds = evidence.timeline.period_seconds;
    let band = evidence.trial.recovery_band();
    let mut latest = window.from_seconds;
    let (mut recovered_at, mut is_outside) = (None, false);
    let mut samples = evidence.samples(window).peekable();
    let first = samples
        .peek()
        .copied()
        .ok_or_else(|| evidence.no_position(window))?;
    checked(first.deviation())?;
    for sample in samples {
        let time = sample.time_seconds;
        if evidence.is_silence(latest, time) {
            recovered_at = Some(time);
        }
        is_outside = sample.deviation() > EDGE * band;
        if is_outside {
            recovered_at = Some(time + period_seconds);
        }
        latest = time;
    }
    if evidence.is_silence(latest, window.until_seconds) {
        return Err(Absence::silent(Window::new(latest, window.until_seconds)));
    }
    let recovered_at = recovered_at.unwrap_or(window.from_seconds);
    if is_outside || recovered_at + 0.5 * period_seconds >= window.until_seconds {
        return Err("not recovered".into());
    }
    Ok(recovered_at - window.from_seconds)
}
