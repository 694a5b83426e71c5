//! Faults of sensor, amplifier and plant, by the scenario's `[fault]`.
//!
//! They act on the rig itself, in any state of the drive's node, and begin with scenario time.

mod amplifier;
mod sensor;

use std::time::Duration;

use scenario::Trial;
use scenario::fault::{Fault, Faults, Group};

use crate::sensor::Counts;
pub(crate) use sensor::SensorFaults;

/// Faults of a rig.
#[derive(Clone, Debug)]
pub(crate) struct RigFaults {
    /// Faults of the drive and of its plant.
    faults: Faults,
    sensor: SensorFaults,
    /// Scenario times at which a fault begins or ends, in order.
    changes: Vec<Duration>,
    /// Start of scenario time.
    pub(crate) zero: Option<Duration>,
}

impl RigFaults {
    /// Makes the faults of a drive, before their beginning.
    pub(crate) fn new(trial: &Trial, sensor_unit: f64, seed: u64) -> Self {
        let faults = trial.drive_faults();
        let is_in_rig = |fault: &&Fault| !matches!(fault.kind.group, Group::Bus | Group::Node);
        let in_rig = faults.iter().filter(is_in_rig);
        let times = in_rig.flat_map(|fault| [fault.from_seconds, fault.until_seconds]);
        let mut changes: Vec<_> = times.flatten().map(Duration::from_secs_f64).collect();
        changes.sort_unstable();
        changes.dedup();
        Self {
            sensor: SensorFaults::new(&faults, sensor_unit, seed),
            faults,
            changes,
            zero: None,
        }
    }

    /// Returns the next change after `now`.
    pub(crate) fn next_change(&self, now: Duration) -> Option<Duration> {
        let zero = self.zero?;
        let changes = self.changes.iter().map(|change| zero + *change);
        changes.into_iter().find(|change| *change > now)
    }

    /// Returns the output of the faulty sensor's converter; `convert` is the sound converter.
    pub(crate) fn sense(
        &mut self,
        now: Duration,
        position: f64,
        convert: impl FnOnce(f64) -> Counts,
    ) -> Counts {
        let Some(time_seconds) = self.time_seconds(now) else {
            return convert(position);
        };
        self.sensor.sense(time_seconds, position, convert)
    }

    /// Returns what the amplifier gives for a command, if the plant conducts.
    pub(crate) fn output(&self, now: Duration, commanded: f64) -> f64 {
        match self.time_seconds(now) {
            Some(time) => amplifier::output(&self.faults, time, commanded),
            None => commanded,
        }
    }

    /// Returns the faults of the plant and the scenario time; `None` before the start, and without faults.
    pub(crate) fn plant_faults(&self, now: Duration) -> Option<(&Faults, f64)> {
        Some((&self.faults, self.time_seconds(now)?))
    }

    /// Returns the scenario time; `None` before the start, and without faults.
    fn time_seconds(&self, now: Duration) -> Option<f64> {
        if self.changes.is_empty() {
            return None;
        }
        Some(now.checked_sub(self.zero?)?.as_secs_f64())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns the faults of these tables.
    pub(crate) fn faults(tables: &str) -> Faults {
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n{tables}"
        );
        testing::part(&text, "drive").run.faults.clone()
    }
}
