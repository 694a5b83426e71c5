//! The position sensor's faults.

use faults::Stream;
use scenario::fault::sensor::{self, Noise, Spikes};
use scenario::fault::{Lasting, Place};

use crate::sensor::Counts;

const METRES_PER_MILLIMETRE: f64 = 1e-3;

/// What goes wrong with the sensor, with the random numbers of each fault.
#[derive(Clone, Debug)]
pub(crate) struct SensorFaults {
    faults: sensor::SensorFaults,
    noise: Vec<(Noise, Stream)>,
    spikes: Vec<(Spikes, Stream)>,
    /// What a stuck converter puts out.
    stuck_at: Option<Counts>,
}

impl SensorFaults {
    pub(super) fn new(faults: &sensor::SensorFaults, seed: u64) -> Self {
        let stream = |kind, index| {
            let group = "sensor";
            Stream::for_fault(seed, &Place { group, kind, index })
        };
        let noise = faults.noise.iter().cloned().enumerate();
        let spikes = faults.spikes.iter().cloned().enumerate();
        Self {
            noise: noise
                .map(|(index, fault)| (fault, stream("noise", index)))
                .collect(),
            spikes: spikes
                .map(|(index, fault)| (fault, stream("spikes", index)))
                .collect(),
            faults: faults.clone(),
            stuck_at: None,
        }
    }

    /// Samples through the sound converter: faults of the analogue side before it, of the digital side after it.
    pub(super) fn sense(
        &mut self,
        time_seconds: f64,
        position_metres: f64,
        convert: impl FnOnce(f64) -> Counts,
    ) -> Counts {
        let error_millimetres = self.error_millimetres(time_seconds);
        let sound = convert(position_metres + error_millimetres * METRES_PER_MILLIMETRE);
        let lost_bits = self
            .faults
            .lost_bits
            .iter()
            .filter(|fault| fault.acts_at(time_seconds));
        let counts = sound.without(lost_bits.fold(0, |mask, fault| mask | fault.mask));
        let is_stuck = self
            .faults
            .stuck
            .iter()
            .any(|fault| fault.acts_at(time_seconds));
        if !is_stuck {
            self.stuck_at = None;
            return counts;
        }
        *self.stuck_at.get_or_insert(counts)
    }

    fn error_millimetres(&mut self, time_seconds: f64) -> f64 {
        let mut error = 0.0;
        for fault in self
            .faults
            .offset
            .iter()
            .filter(|fault| fault.acts_at(time_seconds))
        {
            error += fault.offset_millimetres;
        }
        for fault in self
            .faults
            .drift
            .iter()
            .filter(|fault| fault.acts_at(time_seconds))
        {
            error += fault.rate_millimetres_per_second * (time_seconds - fault.from_seconds);
        }
        for (fault, stream) in &mut self.noise {
            if fault.acts_at(time_seconds) {
                error += fault.noise_millimetres_rms * stream.normal();
            }
        }
        for (fault, stream) in &mut self.spikes {
            if fault.acts_at(time_seconds) && stream.happens(fault.probability) {
                let sign = if stream.happens(0.5) { 1.0 } else { -1.0 };
                error += sign * fault.height_millimetres;
            }
        }
        error
    }
}

#[cfg(test)]
mod tests {
    use scenario::fault::sensor::{Drift, LostBits, Offset, Stuck};
    use scenario::plant;

    use super::*;
    use crate::sensor::PositionSensor;

    fn sense(faults: &sensor::SensorFaults, samples: &[(f64, f64)]) -> Vec<f64> {
        let mut sensor = PositionSensor::new(&plant::Sensor::default(), 0);
        let mut faults = SensorFaults::new(faults, 1);
        let sense = |(time, millimetres): &(f64, f64)| {
            let counts = faults.sense(*time, millimetres * 1e-3, |position| {
                sensor.sample(position)
            });
            sensor.position_metres(counts) * 1e3
        };
        samples.iter().map(sense).collect()
    }

    #[test]
    fn offset_and_drift_add_up_and_end() {
        let faults = sensor::SensorFaults {
            offset: vec![Offset {
                from_seconds: 1.0,
                until_seconds: Some(3.0),
                offset_millimetres: 5.0,
            }],
            drift: vec![Drift {
                from_seconds: 2.0,
                until_seconds: Some(4.0),
                rate_millimetres_per_second: -2.0,
            }],
            ..sensor::SensorFaults::default()
        };
        let sensed = sense(
            &faults,
            &[
                (0.0, 20.0),
                (1.0, 20.0),
                (2.5, 20.0),
                (3.5, 20.0),
                (4.0, 20.0),
            ],
        );
        for (sensed, expected) in sensed.iter().zip([20.0, 25.0, 24.0, 17.0, 20.0]) {
            assert!((sensed - expected).abs() < 0.06, "{sensed} {expected}");
        }
    }

    #[test]
    fn a_stuck_converter_keeps_its_first_number_and_lost_bits_read_zero() {
        let stuck = sensor::SensorFaults {
            stuck: vec![Stuck {
                from_seconds: 1.0,
                until_seconds: Some(2.0),
            }],
            ..sensor::SensorFaults::default()
        };
        let sensed = sense(
            &stuck,
            &[(0.5, 10.0), (1.0, 20.0), (1.5, 30.0), (2.0, 30.0)],
        );
        assert!(sensed[1] == sensed[2] && sensed[3] > sensed[2] && sensed[0] < sensed[1]);
        let lost = sensor::SensorFaults {
            lost_bits: vec![LostBits {
                from_seconds: 0.0,
                until_seconds: None,
                mask: 0x3FF,
            }],
            ..sensor::SensorFaults::default()
        };
        assert_eq!(sense(&lost, &[(0.0, 30.0)]), [0.0]);
    }

    #[test]
    fn spikes_are_as_rare_as_asked_for() {
        let faults = sensor::SensorFaults {
            spikes: vec![Spikes {
                from_seconds: 0.0,
                until_seconds: None,
                height_millimetres: 10.0,
                probability: 0.1,
            }],
            ..sensor::SensorFaults::default()
        };
        let sensed = sense(&faults, &[(1.0, 30.0); 10_000]);
        let high = sensed.iter().filter(|sensed| **sensed > 39.0).count();
        let low = sensed.iter().filter(|sensed| **sensed < 21.0).count();
        assert!(
            (400..600).contains(&high) && (400..600).contains(&low),
            "{high} {low}"
        );
    }
}
