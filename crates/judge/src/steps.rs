//! How the position follows the steps of the set-point.

use scenario::events::JudgedStep;

use crate::evidence::{Evidence, MetricValue, worst};

/// Half the width of the settling band, by the height of the step (PAPER, "Definitions").
pub const SETTLING_BAND: f64 = 0.05;

/// The longest settling time.
pub(crate) fn settling_time(evidence: &Evidence<'_>) -> MetricValue {
    worst_step(evidence, settling_time_of)
}

/// The largest overshoot.
pub(crate) fn overshoot(evidence: &Evidence<'_>) -> MetricValue {
    worst_step(evidence, overshoot_of)
}

fn worst_step(
    evidence: &Evidence<'_>,
    metric: fn(&Evidence<'_>, &JudgedStep) -> MetricValue,
) -> MetricValue {
    let steps = evidence.scenario.judged_steps();
    let values = steps.iter().map(|step| metric(evidence, step));
    worst(values).unwrap_or_else(|| Err("no step in the scenario".to_owned()))
}

/// First sample of the uninterrupted stay within the band, less the time of the step.
fn settling_time_of(evidence: &Evidence<'_>, step: &JudgedStep) -> MetricValue {
    let band = SETTLING_BAND * (step.to_millimetres - step.from_millimetres).abs();
    let mut settled_at = None;
    for sample in evidence.samples(step.window) {
        if (sample.position_millimetres - step.to_millimetres).abs() > band {
            settled_at = None;
        } else if settled_at.is_none() {
            settled_at = Some(sample.time_seconds);
        }
    }
    settled_at
        .map(|time| time - step.window.from_seconds)
        .ok_or_else(|| "never settled".to_owned())
}

/// How far the position goes beyond the set-point in the direction of the step, by its height.
fn overshoot_of(evidence: &Evidence<'_>, step: &JudgedStep) -> MetricValue {
    let height = step.to_millimetres - step.from_millimetres;
    if height == 0.0 {
        return Err("a step without height".to_owned());
    }
    let samples = evidence.samples(step.window);
    let beyond = samples.map(|sample| (sample.position_millimetres - step.to_millimetres) / height);
    Ok(100.0 * beyond.fold(0.0, f64::max))
}
