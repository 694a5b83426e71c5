//! Response of the position to the steps of the set-point.

use recording::timeline::TIME_TOLERANCE_SECONDS;
use scenario::events::{JudgedStep, Window};
use scenario::expect::rounded;

use crate::evidence::{
    Absence, EDGE, Evidence, Measurement, MetricValue, SAME_MAX, STAY_SECONDS, worst,
};

/// Half the width of the settling band, relative to the height of the step (PAPER, "Definitions").
pub const SETTLING_BAND: f64 = 0.05;

/// Measures the longest settling time.
pub(crate) fn settling_time(evidence: &Evidence<'_>) -> Measurement {
    worst_step(evidence, true, step_settling_time)
}

/// Measures the largest overshoot.
pub(crate) fn overshoot(evidence: &Evidence<'_>) -> Measurement {
    worst_step(evidence, false, step_overshoot)
}

fn worst_step(
    evidence: &Evidence<'_>,
    is_time: bool,
    metric: fn(&Evidence<'_>, &JudgedStep) -> MetricValue,
) -> Measurement {
    let steps = evidence.trial.judged_steps();
    let values = steps.iter().map(|step| {
        evidence.of_event(step.window, is_time, |evidence, window| {
            let judged = JudgedStep { window, ..*step };
            metric(evidence, &judged).map_err(|absence| match steps.len() {
                1 => absence,
                _ => absence.of(&format!("step at {} s", window.from_seconds)),
            })
        })
    });
    worst(values)
}

/// Returns the time from the step to the first sample of the uninterrupted stay within the band. A silence interrupts a stay.
fn step_settling_time(evidence: &Evidence<'_>, step: &JudgedStep) -> MetricValue {
    let band = SETTLING_BAND * (step.to - step.from).abs();
    let until_seconds = step.window.until_seconds;
    let (mut settled_at, mut latest) = (None, None);
    for sample in evidence.samples(step.window) {
        let time = sample.time_seconds;
        let is_outside = (sample.position - step.to).abs() > EDGE * band;
        let was_silent = latest.is_some_and(|latest| evidence.is_silence(latest, time));
        if is_outside || was_silent {
            settled_at = None;
        }
        if !is_outside {
            settled_at.get_or_insert(time);
        }
        latest = Some(time);
    }
    let latest = latest.ok_or_else(|| evidence.no_position(step.window))?;
    if evidence.is_silence(latest, until_seconds) {
        return Err(Absence::silent(Window::new(latest, until_seconds)));
    }
    let settled_at = settled_at.ok_or("never settled")?;
    let stay_seconds = until_seconds - settled_at;
    if stay_seconds < STAY_SECONDS - TIME_TOLERANCE_SECONDS {
        let stay_seconds = rounded(stay_seconds);
        return Err(Absence::from(format!(
            "the window ends {stay_seconds} s after the position entered the band; {STAY_SECONDS} s are needed"
        )));
    }
    Ok(settled_at - step.window.from_seconds)
}

/// Returns the distance of the position beyond the set-point in the direction of the step, relative to its height.
fn step_overshoot(evidence: &Evidence<'_>, step: &JudgedStep) -> MetricValue {
    let height = step.to - step.from;
    if height.abs() <= SAME_MAX {
        return Err("a step without height".into());
    }
    let samples = evidence.seen(step.window)?;
    let beyond = samples.map(|sample| (sample.position - step.to) / height);
    Ok(100.0 * beyond.fold(0.0, f64::max))
}
