//! Sine of known frequency that fits samples best.

use nalgebra::{Matrix3, Vector3};

/// Sine with an offset: `mean + sine · sin ωt + cosine · cos ωt`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Harmonic {
    pub(crate) mean: f64,
    /// Part in phase with `sin ωt`.
    pub(crate) sine: f64,
    /// Part in phase with `cos ωt`.
    pub(crate) cosine: f64,
}

impl Harmonic {
    /// Fits a sine by least squares to samples `(time, value)`; returns `None` if they do not determine it.
    pub(crate) fn fit(
        samples: impl Iterator<Item = (f64, f64)>,
        period_seconds: f64,
    ) -> Option<Self> {
        let omega = std::f64::consts::TAU / period_seconds;
        Self::fit_phases(samples.map(|(time, value)| (omega * time, value)))
    }

    /// Fits a sine as [`Harmonic::fit`] does, to samples `(phase in radians, value)`.
    pub(crate) fn fit_phases(samples: impl Iterator<Item = (f64, f64)>) -> Option<Self> {
        let (mut normal, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0_u32);
        for (phase, value) in samples {
            count = count.saturating_add(1);
            let row = Vector3::new(1.0, libm::sin(phase), libm::cos(phase));
            normal += row * row.transpose();
            right += row * value;
        }
        // Two samples make the matrix singular, which rounding may hide.
        if count < 3 {
            return None;
        }
        let [mean, sine, cosine] = normal.cholesky()?.solve(&right).into();
        Some(Self { mean, sine, cosine })
    }

    /// Returns half the height.
    pub(crate) fn amplitude(&self) -> f64 {
        libm::hypot(self.sine, self.cosine)
    }

    /// Returns the lead over `sin ωt`, from −180 to 180.
    pub(crate) fn phase_degrees(&self) -> f64 {
        libm::atan2(self.cosine, self.sine).to_degrees()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_frequencies_and_gaps_do_not_count() {
        let value =
            |time: f64| 3.0 + 2.0 * libm::sin(5.0 * time - 0.3) + 0.5 * libm::sin(15.0 * time);
        let period = std::f64::consts::TAU / 5.0;
        let samples = (0..3000).map(|sample| period * f64::from(sample) / 1000.0);
        let fit = Harmonic::fit(samples.map(|time| (time, value(time))), period).unwrap();
        assert!((fit.mean - 3.0).abs() < 1e-9);
        assert!((fit.amplitude() - 2.0).abs() < 1e-9);
        assert!((fit.phase_degrees() + 0.3_f64.to_degrees()).abs() < 1e-9);
        let pure = |time: f64| (time, 1.0 + libm::cos(5.0 * time));
        let gappy = (0..3000)
            .filter(|sample| sample % 7 != 0)
            .map(|sample| pure(period * f64::from(sample) / 1000.0));
        let fit = Harmonic::fit(gappy, period).unwrap();
        assert!((fit.phase_degrees() - 90.0).abs() < 1e-9 && (fit.amplitude() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn too_few_samples_determine_nothing() {
        assert_eq!(Harmonic::fit(std::iter::empty(), 1.0), None);
        assert_eq!(
            Harmonic::fit([(0.0, 1.0), (0.25, 2.0)].into_iter(), 1.0),
            None
        );
    }
}
