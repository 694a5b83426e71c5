//! Gain, phase and offset of the position against the set-point of each sine, over its judged periods.

use scenario::events::JudgedSine;

use crate::evidence::{Absence, CycleSample, Evidence, Known, Measurement, MetricValue, checked};
use crate::harmonic::Harmonic;

/// Function of the harmonics of the set-point and of the position.
type OfSine = fn(&Harmonic, &Harmonic) -> f64;

pub(crate) fn gain(evidence: &Evidence<'_>) -> Measurement {
    worst(evidence, "sine_gain", 1.0, |wanted, measured| {
        measured.amplitude() / wanted.amplitude()
    })
}

/// Measures the phase from −270 to 90 degrees; it is negative for a position that follows late.
pub(crate) fn phase_degrees(evidence: &Evidence<'_>) -> Measurement {
    worst(evidence, "sine_phase_degrees", 0.0, |wanted, measured| {
        phase_between(wanted.phase_degrees(), measured.phase_degrees())
    })
}

/// Returns the difference of two phases, from −270 to 90 degrees.
pub(crate) fn phase_between(wanted_degrees: f64, measured_degrees: f64) -> f64 {
    let phase = measured_degrees - wanted_degrees;
    let turns = libm::floor((phase + 270.0) / 360.0);
    phase - 360.0 * turns
}

pub(crate) fn offset(evidence: &Evidence<'_>) -> Measurement {
    worst(evidence, "sine_offset_{unit}", 0.0, |wanted, measured| {
        measured.mean - wanted.mean
    })
}

/// Returns the value of the sine that is nearest to the metric's limit or farthest beyond it, or without a limit farthest from
/// the value of a position without error; the first of several. The time of the value names the sine.
fn worst(evidence: &Evidence<'_>, metric: &str, ideal: f64, value: OfSine) -> Measurement {
    let sines = evidence.trial.judged_sines();
    let limit = evidence.trial.expect.limit(metric);
    let goodness = |value: f64| match limit {
        Some(limit) => limit.margin(value),
        None => -(value - ideal).abs(),
    };
    let mut worst: Option<(f64, f64)> = None;
    for sine in &sines {
        let value = of_sine(evidence, sine, value)?;
        if worst.is_none_or(|(worst, _)| goodness(value) < goodness(worst)) {
            worst = Some((value, sine.window.from_seconds));
        }
    }
    let (value, from) = worst.ok_or_else(Absence::nothing)?;
    Ok(Known {
        at_seconds: (sines.len() > 1).then_some(from),
        ..value.into()
    })
}

fn of_sine(evidence: &Evidence<'_>, sine: &JudgedSine, value: OfSine) -> MetricValue {
    let fit = |value: fn(&CycleSample) -> f64| {
        let samples = evidence
            .seen(sine.window)?
            .map(|sample| (sample.time_seconds, value(&sample)));
        Harmonic::fit(samples, sine.period_seconds)
            .ok_or_else(|| Absence::from("too few positions for a sine"))
    };
    let wanted = fit(|sample| sample.set_point)?;
    let position = fit(|sample| sample.position)?;
    checked(value(&wanted, &position))
}
