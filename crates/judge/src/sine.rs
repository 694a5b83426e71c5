//! Gain, phase and offset of the position against the set-point of a sine, over its judged periods.

use crate::evidence::{CycleSample, Evidence, MetricValue, checked, no_samples};
use crate::harmonic::Harmonic;

pub(crate) fn gain(evidence: &Evidence<'_>) -> MetricValue {
    let (wanted, measured) = fits(evidence)?;
    checked(measured.amplitude() / wanted.amplitude())
}

/// From -270 to 90: a position that follows late has a negative phase.
pub(crate) fn phase_degrees(evidence: &Evidence<'_>) -> MetricValue {
    let (wanted, measured) = fits(evidence)?;
    let phase = measured.phase_degrees() - wanted.phase_degrees();
    let turns = libm::floor((phase + 270.0) / 360.0);
    checked(phase - 360.0 * turns)
}

pub(crate) fn offset_millimetres(evidence: &Evidence<'_>) -> MetricValue {
    let (wanted, measured) = fits(evidence)?;
    checked(measured.mean - wanted.mean)
}

/// Set-point and position.
fn fits(evidence: &Evidence<'_>) -> Result<(Harmonic, Harmonic), String> {
    let sine = evidence.scenario.reference.sine.last();
    let (window, sine) = (evidence.scenario.judged_sine().zip(sine))
        .ok_or("no sine of at least four periods in the scenario")?;
    let fit = |value: fn(&CycleSample) -> f64| {
        let samples = evidence.samples(window);
        let samples = samples.map(|sample| (sample.time_seconds, value(&sample)));
        Harmonic::fit(samples, sine.period_seconds).ok_or_else(no_samples)
    };
    Ok((
        fit(|sample| sample.set_point_millimetres)?,
        fit(|sample| sample.position_millimetres)?,
    ))
}
