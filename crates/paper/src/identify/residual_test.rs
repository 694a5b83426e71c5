//! Test of whether the sensor alone explains the residual.
//!
//! A wrong model shows in the residual's size, or in neighbours that deviate together. The test therefore averages the
//! residual over spans of several lengths, and compares each average's size with those that the sensor leaves in
//! emulated measurements of the fitted motion. If the model is right, the measurement is one more of them. The
//! probability that it exceeds all `n` others at one length is `1 / (n + 1)`.

use serde::Serialize;

use super::data::IdentificationData;
use super::fit::rms;

/// Spans over which the residual is averaged; the first is shorter than the distance of two positions.
const SPANS_SECONDS: [f64; 3] = [0.0, 0.25, 1.0];

/// RMS of the averages of a residual over each span.
pub type Sizes = [f64; SPANS_SECONDS.len()];

/// Returns the sizes of a residual of all recordings, one after the other.
pub fn sizes_of(measurements: &[IdentificationData], residual: &[f64]) -> Sizes {
    let times = measurements.iter().map(|one| &one.times_seconds[..]);
    let times = Vec::from_iter(times);
    SPANS_SECONDS.map(|seconds| rms(&averages(&times, residual, seconds)))
}

/// Size of the residual at one length of averages, and that of the sensor alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ResidualTest {
    /// Length of the averages; 0 for single positions.
    pub averaged_seconds: f64,
    /// RMS of the averages of the residual.
    pub residual_metres_rms: f64,
    /// Largest RMS that the sensor alone left.
    pub sensor_metres_rms_max: f64,
}

impl ResidualTest {
    /// Compares the sizes of the residual with the largest ones that the sensor alone leaves.
    pub fn all(residual: Sizes, sensor_max: Sizes) -> Vec<Self> {
        let test = |place: usize| Self {
            averaged_seconds: SPANS_SECONDS[place],
            residual_metres_rms: residual[place],
            sensor_metres_rms_max: sensor_max[place],
        };
        (0..SPANS_SECONDS.len()).map(test).collect()
    }

    /// Returns the ratio of the residual to the sensor's largest.
    pub fn excess(&self) -> f64 {
        self.residual_metres_rms / self.sensor_metres_rms_max
    }
}

/// Returns means over spans that begin with each recording. `times` has the times of the values, recording by
/// recording.
fn averages(times: &[&[f64]], values: &[f64], span_seconds: f64) -> Vec<f64> {
    let mut rest = values;
    let mut averages = Vec::new();
    for times in times {
        let (mut left, after) = rest.split_at(times.len());
        rest = after;
        let mut times = *times;
        while let Some(start) = times.first() {
            let count = times
                .partition_point(|time| *time < start + span_seconds)
                .max(1);
            let (mean, later) = left.split_at(count);
            averages.push(mean.iter().sum::<f64>() / count as f64);
            (left, times) = (later, &times[count..]);
        }
    }
    averages
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_ends_with_its_recording() {
        let (first, second): (&[f64], &[f64]) = (&[0.0, 0.1, 0.2], &[5.0, 5.1]);
        let values = [1.0, 3.0, 5.0, 7.0, 9.0];
        assert_eq!(averages(&[first, second], &values, 0.0), values);
        assert_eq!(averages(&[first, second], &values, 0.15), [2.0, 5.0, 8.0]);
        assert_eq!(averages(&[first, second], &values, 1.0), [3.0, 8.0]);
    }
}
