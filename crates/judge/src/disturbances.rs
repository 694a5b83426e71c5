//! How far a disturbance moves the position, and how long until it is back.

use scenario::events::Window;

use crate::evidence::{CycleSample, Evidence, Measurement, MetricValue, largest, worst};

/// A deviation within this counts as recovered from a disturbance: four steps of a 10-bit converter over 60 mm.
const RECOVERY_BAND_MILLIMETRES: f64 = 0.25;
/// A disturbance is watched this long after its end.
const AFTER_DISTURBANCE_SECONDS: f64 = 3.0;

/// The largest deviation during a disturbance.
pub(crate) fn maximum_deviation(evidence: &Evidence<'_>) -> Measurement {
    worst_disturbance(evidence, deviation)
}

/// The longest recovery from a disturbance.
pub(crate) fn recovery_time(evidence: &Evidence<'_>) -> Measurement {
    worst_disturbance(evidence, recovery)
}

/// The largest value over all disturbances. Without a fan and load module on the bus there was none.
fn worst_disturbance(
    evidence: &Evidence<'_>,
    metric: fn(&Evidence<'_>, Window) -> MetricValue,
) -> Measurement {
    let windows = evidence.scenario.disturbance_windows();
    let values = windows.iter().map(|disturbance| {
        let mut window = disturbance.window;
        window.until_seconds += AFTER_DISTURBANCE_SECONDS;
        metric(evidence, window)
    });
    match worst(values) {
        None => Measurement::Missing("no disturbance in the scenario".to_owned()),
        Some(Ok(_)) if !evidence.timeline.has_fan => {
            Measurement::Unavailable("not available: no fan on the bus".to_owned())
        }
        Some(value) => value.into(),
    }
}

fn deviation(evidence: &Evidence<'_>, window: Window) -> MetricValue {
    let samples = evidence.samples(window);
    largest(samples.map(|sample| sample.deviation_millimetres()))
}

/// From the start of a window until the deviation stays small.
pub(crate) fn recovery(evidence: &Evidence<'_>, window: Window) -> MetricValue {
    let is_outside =
        |sample: &CycleSample| sample.deviation_millimetres() > RECOVERY_BAND_MILLIMETRES;
    let Some(last_outside) = evidence.samples(window).filter(is_outside).last() else {
        return deviation(evidence, window).map(|_| 0.0);
    };
    let (time, timeline) = (last_outside.time_seconds, evidence.timeline);
    let end = window.until_seconds.min(timeline.end_seconds());
    if time + 1.5 * timeline.period_seconds >= end {
        Err("not recovered".to_owned())
    } else {
        Ok(time + timeline.period_seconds - window.from_seconds)
    }
}
