//! Faults of the position sensor.

use faults::Stream;
use scenario::fault::{Fault, Faults, Group};

use crate::sensor::Counts;

/// Faults of the sensor, with a stream of random numbers for each.
#[derive(Clone, Debug)]
pub(crate) struct SensorFaults {
    faults: Vec<(Fault, Stream)>,
    /// Output of a stuck converter.
    stuck_at: Option<Counts>,
    /// One unit of the scenario's file, in the unit of the samples.
    unit: f64,
}

impl SensorFaults {
    pub(super) fn new(faults: &Faults, unit: f64, seed: u64) -> Self {
        let faults = faults.in_group(Group::Sensor);
        let with_stream = |fault: &Fault| (fault.clone(), Stream::for_fault(seed, fault));
        Self {
            faults: faults.map(with_stream).collect(),
            stuck_at: None,
            unit,
        }
    }

    /// Samples through the sound converter. Faults of the analogue side act before it, those of the digital side after
    /// it.
    pub(super) fn sense(
        &mut self,
        time_seconds: f64,
        position: f64,
        convert: impl FnOnce(f64) -> Counts,
    ) -> Counts {
        let (mut added, mut lost_bits, mut is_stuck) = (0.0, 0, false);
        let acting = self.faults.iter_mut();
        for (fault, stream) in acting.filter(|(fault, _)| fault.acts_at(time_seconds)) {
            match fault.kind.name {
                "lost_bits" => lost_bits |= fault.whole("mask").unwrap_or_default(),
                "stuck" => is_stuck = true,
                _ => added += error(fault, stream, time_seconds),
            }
        }
        let sound = convert(position + added * self.unit);
        let counts = sound.without(lost_bits);
        if !is_stuck {
            self.stuck_at = None;
            return counts;
        }
        *self.stuck_at.get_or_insert(counts)
    }
}

/// Returns the error that a fault adds to the position before its conversion.
fn error(fault: &Fault, stream: &mut Stream, time_seconds: f64) -> f64 {
    match fault.kind.name {
        "offset" => fault.number("offset_{unit}"),
        "drift" => {
            let elapsed = time_seconds - fault.from_seconds.unwrap_or_default();
            fault.number("rate_{unit}_per_second") * elapsed
        }
        "noise" => fault.number("noise_{unit}_rms") * stream.normal(),
        "spikes" if stream.happens(fault.number("probability")) => {
            let sign = if stream.happens(0.5) { 1.0 } else { -1.0 };
            sign * fault.number("height_{unit}")
        }
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use scenario::rig::nodes::Sensor;

    use super::*;
    use crate::faults::tests::faults;
    use crate::sensor::PositionSensor;

    fn sense(tables: &str, samples: &[(f64, f64)]) -> Vec<f64> {
        let mut sensor = PositionSensor::new(&Sensor::default(), 1e-3, 0);
        let mut faults = SensorFaults::new(&faults(tables), 1e-3, 1);
        let sense = |(time, millimetres): &(f64, f64)| {
            let counts = faults.sense(*time, millimetres * 1e-3, |position| {
                sensor.sample(position)
            });
            sensor.position(counts) * 1e3
        };
        samples.iter().map(sense).collect()
    }

    #[test]
    fn offset_and_drift_add_up_and_end() {
        let sensed = sense(
            "[[fault.sensor.offset]]\nfrom_seconds = 1.0\nuntil_seconds = 3.0\noffset_millimetres = 5.0\n\
             [[fault.sensor.drift]]\nfrom_seconds = 2.0\nuntil_seconds = 4.0\nrate_millimetres_per_second = -2.0\n",
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
        let sensed = sense(
            "[[fault.sensor.stuck]]\nfrom_seconds = 1.0\nuntil_seconds = 2.0\n",
            &[(0.5, 10.0), (1.0, 20.0), (1.5, 30.0), (2.0, 30.0)],
        );
        assert!(sensed[1] == sensed[2] && sensed[3] > sensed[2] && sensed[0] < sensed[1]);
        let lost = "[[fault.sensor.lost_bits]]\nfrom_seconds = 0.0\nmask = 0x3FF\n";
        assert_eq!(sense(lost, &[(0.0, 30.0)]), [0.0]);
    }

    #[test]
    fn spikes_are_as_rare_as_asked_for() {
        let spikes = "[[fault.sensor.spikes]]\nfrom_seconds = 0.0\nheight_millimetres = 10.0\nprobability = 0.1\n";
        let sensed = sense(spikes, &[(1.0, 30.0); 10_000]);
        let high = sensed.iter().filter(|sensed| **sensed > 39.0).count();
        let low = sensed.iter().filter(|sensed| **sensed < 21.0).count();
        assert!(
            (400..600).contains(&high) && (400..600).contains(&low),
            "{high} {low}"
        );
    }
}
