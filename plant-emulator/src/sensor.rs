//! The position sensor: a potentiometer on the pulley, read by an analogue-to-digital converter.

use faults::Stream;
use scenario::rig::nodes::Sensor;

/// Largest resolution that the converter emulates.
pub const RESOLUTION_BITS_MAX: u32 = 24;

/// Output of the converter: 0 to `2^bits − 1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Counts(u32);

impl Counts {
    /// Returns the number.
    pub fn value(self) -> u32 {
        self.0
    }

    /// Returns the number with the bits of a mask cleared.
    #[must_use]
    pub fn without(self, mask: u32) -> Self {
        Self(self.0 & !mask)
    }
}

/// The sensor.
#[derive(Clone, Debug)]
pub struct PositionSensor {
    /// Position at no counts.
    zero: f64,
    /// Size of one count.
    count: f64,
    /// Largest count.
    counts_max: u32,
    /// Standard deviation before the conversion; 0 draws no numbers.
    noise_rms: f64,
    stream: Stream,
}

impl PositionSensor {
    /// Makes a sensor whose noise follows from `seed` alone. A resolution above [`RESOLUTION_BITS_MAX`] or below 1 is
    /// limited to these. Samples are in the unit of the plant's output; `unit` is one unit of `config` in that.
    pub fn new(config: &Sensor, unit: f64, seed: u64) -> Self {
        let counts = 1_u32 << config.resolution_bits().clamp(1, RESOLUTION_BITS_MAX);
        Self {
            zero: 0.0,
            count: config.span() * unit / f64::from(counts),
            counts_max: counts - 1,
            noise_rms: config.noise_rms() * unit,
            stream: Stream::new(seed),
        }
    }

    /// Returns the sensor with a span that begins at another position than 0, in the unit of the samples.
    #[must_use]
    pub fn from(self, zero: f64) -> Self {
        Self { zero, ..self }
    }

    /// Takes a sample: noise, then the nearest count (transitions lie half-way between two), clipped to the span.
    pub fn sample(&mut self, true_position: f64) -> Counts {
        let mut position = true_position;
        if self.noise_rms > 0.0 {
            position += self.noise_rms * self.stream.normal();
        }
        let counts = ((position - self.zero) / self.count).round();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the range of the converter; the cast makes 0 of NaN"
        )]
        let counts = counts.clamp(0.0, f64::from(self.counts_max)) as u32;
        Counts(counts)
    }

    /// Returns the position of a number of counts.
    pub fn position(&self, counts: Counts) -> f64 {
        f64::from(counts.0) * self.count + self.zero
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor(noise_rms: f64, seed: u64) -> PositionSensor {
        let config = Sensor {
            noise_rms: Some(noise_rms),
            ..Sensor::default()
        };
        PositionSensor::new(&config, 1e-3, seed)
    }

    #[test]
    fn one_count_is_58_6_micrometres_and_the_error_half_of_it() {
        let mut sensor = sensor(0.0, 0);
        for tenth_millimetre in 0..599 {
            let position = f64::from(tenth_millimetre) * 1e-4;
            let counts = sensor.sample(position);
            let error = sensor.position(counts) - position;
            assert!(error.abs() <= 0.5 * 0.06 / 1024.0 + 1e-12, "{error}");
        }
        assert!((sensor.position(Counts(1)) - 58.593_75e-6).abs() < 1e-12);
    }

    #[test]
    fn the_span_clips() {
        let mut sensor = sensor(0.0, 0);
        assert_eq!(sensor.sample(-1.0).value(), 0);
        assert_eq!(sensor.sample(0.2).value(), 1023);
        assert_eq!(sensor.sample(f64::NAN).value(), 0);
    }

    #[test]
    fn noise_is_normal_and_follows_from_the_seed() {
        let config = Sensor {
            resolution_bits: Some(24),
            noise_rms: Some(0.1),
            ..Sensor::default()
        };
        let draw = |seed| -> Vec<f64> {
            let mut sensor = PositionSensor::new(&config, 1e-3, seed);
            let sample = |_| {
                let counts = sensor.sample(0.03);
                (sensor.position(counts) - 0.03) / 1e-4
            };
            (0..20_000).map(sample).collect()
        };
        let values = draw(42);
        assert_eq!(values, draw(42));
        assert_ne!(values, draw(43));
        let mean = values.iter().sum::<f64>() / 20_000.0;
        let variance = values.iter().map(|value| value * value).sum::<f64>() / 20_000.0;
        let outside = values.iter().filter(|value| value.abs() > 1.96).count();
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
        assert!((850..1150).contains(&outside), "{outside}");
    }
}
