//! Gain, phase and offset of the position against the set-point of each sine, over its judged periods.

use scenario::events::JudgedSine;

use crate::evidence::{Absence, CycleSample, Evidence, Measurement, MetricValue, checked, margin};
use crate::harmonic::Harmonic;

/// Property of a sine that is measured.
struct OfSine {
    value: fn(&Harmonic, &Harmonic) -> f64,
    /// Value of a position without error.
    ideal: f64,
    /// Metric whose limit decides which of several sines is the worst.
    metric: &'static str,
}

pub(crate) fn gain(evidence: &Evidence<'_>) -> Measurement {
    let gain = OfSine {
        value: |wanted, measured| measured.amplitude() / wanted.amplitude(),
        ideal: 1.0,
        metric: "sine_gain",
    };
    gain.worst(evidence)
}

/// Measures the phase from −270 to 90 degrees; it is negative for a position that follows late.
pub(crate) fn phase_degrees(evidence: &Evidence<'_>) -> Measurement {
    let phase = OfSine {
        value: |wanted, measured| phase_between(wanted.phase_degrees(), measured.phase_degrees()),
        ideal: 0.0,
        metric: "sine_phase_degrees",
    };
    phase.worst(evidence)
}

/// Returns the difference of two phases, from −270 to 90 degrees.
pub(crate) fn phase_between(wanted_degrees: f64, measured_degrees: f64) -> f64 {
    let phase = measured_degrees - wanted_degrees;
    let turns = libm::floor((phase + 270.0) / 360.0);
    phase - 360.0 * turns
}

pub(crate) fn offset(evidence: &Evidence<'_>) -> Measurement {
    let offset = OfSine {
        value: |wanted, measured| measured.mean - wanted.mean,
        ideal: 0.0,
        metric: "sine_offset_{unit}",
    };
    offset.worst(evidence)
}

impl OfSine {
    /// Returns the value of the sine that is nearest to the limit or farthest beyond it, or without a limit farthest from the
    /// ideal; the first of several. The time of the value names the sine.
    fn worst(&self, evidence: &Evidence<'_>) -> Measurement {
        let sines = evidence.trial.judged_sines();
        let limit = evidence.trial.expect.limit(self.metric);
        let goodness = |value: f64| match limit {
            Some(limit) => margin(value, limit),
            None => -(value - self.ideal).abs(),
        };
        let mut worst: Option<(f64, f64)> = None;
        for sine in &sines {
            let (value, from) = match self.of(evidence, sine) {
                Ok(value) => (value, sine.window.from_seconds),
                Err(absence) => return Err(absence).into(),
            };
            if worst.is_none_or(|(worst, _)| goodness(value) < goodness(worst)) {
                worst = Some((value, from));
            }
        }
        match worst {
            None => Absence::nothing().into(),
            Some((value, _)) if sines.len() == 1 => Ok(value).into(),
            Some((value, from)) => Measurement::at(Ok(value), from),
        }
    }

    fn of(&self, evidence: &Evidence<'_>, sine: &JudgedSine) -> MetricValue {
        let fit = |value: fn(&CycleSample) -> f64| {
            let samples = evidence
                .seen(sine.window)?
                .map(|sample| (sample.time_seconds, value(&sample)));
            Harmonic::fit(samples, sine.period_seconds)
                .ok_or_else(|| Absence::from("too few positions for a sine"))
        };
        let wanted = fit(|sample| sample.set_point)?;
        let position = fit(|sample| sample.position)?;
        checked((self.value)(&wanted, &position))
    }
}
