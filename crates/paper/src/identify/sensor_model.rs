//! Model of the position sensor's mean reading.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use scenario::rig::nodes::Sensor;

/// A converter that clips at both ends of its span, with normal noise before it.
#[derive(Clone, Copy, Debug)]
pub struct SensorModel {
    upper_metres: f64,
    noise_metres_rms: f64,
}

impl SensorModel {
    /// Returns the model of a sensor.
    pub fn new(sensor: &Sensor) -> Self {
        let counts = f64::from(1_u32 << sensor.resolution_bits().clamp(1, 24));
        let span = sensor.span() * 1e-3;
        Self {
            upper_metres: span * (counts - 1.0) / counts,
            noise_metres_rms: sensor.noise_rms() * 1e-3,
        }
    }

    /// Returns the mean reading for a true position. At an end of the span noise is cut off on one side, so the mean
    /// lies inside: on the stop, noise of one step reads as 0.4 steps.
    pub fn expected_metres(&self, position_metres: f64) -> f64 {
        let sigma = self.noise_metres_rms;
        if sigma <= 0.0 {
            return position_metres.clamp(0.0, self.upper_metres);
        }
        // E max(x + n, 0) = excess(x), and E min(x + n, u) = x − excess(x − u).
        excess(position_metres, sigma) - excess(position_metres - self.upper_metres, sigma)
    }
}

/// Returns `E max(x + n, 0)` for normal `n` of standard deviation `sigma`: `x Φ(x/σ) + σ φ(x/σ)`.
fn excess(x: f64, sigma: f64) -> f64 {
    let ratio = x / sigma;
    let distribution = 0.5 * libm::erfc(-ratio * FRAC_1_SQRT_2);
    let density = libm::exp(-0.5 * ratio * ratio) / libm::sqrt(TAU);
    x * distribution + sigma * density
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant_emulator::sensor::PositionSensor;

    #[test]
    fn the_mean_is_the_emulated_sensors() {
        let sensor = Sensor {
            noise_rms: Some(60.0 / 1024.0),
            ..Sensor::default()
        };
        let model = SensorModel::new(&sensor);
        for position in [0.0, 0.00005, 0.02, 0.0599, 0.06] {
            let mut emulated = PositionSensor::new(&sensor, 1e-3, 1);
            let mut shown = || {
                let counts = emulated.sample(position);
                emulated.position(counts)
            };
            let mean = (0..20_000).map(|_| shown()).sum::<f64>() / 20_000.0;
            let expected = model.expected_metres(position);
            assert!(
                (mean - expected).abs() < 2e-6,
                "{position}: {mean} {expected}"
            );
        }
    }

    #[test]
    fn without_noise_it_only_clips() {
        let model = SensorModel::new(&Sensor::default());
        assert_eq!(model.expected_metres(0.01), 0.01);
        assert_eq!(model.expected_metres(-1.0), 0.0);
        assert!((model.expected_metres(1.0) - 0.06 * 1023.0 / 1024.0).abs() < 1e-12);
    }
}
