//! Faults of sensor, amplifier and plant, as the scenario's `[fault]` says.
//!
//! They act on the rig itself, whatever becomes of the drive's node, and begin with scenario time.

mod amplifier;
mod sensor;

use std::time::Duration;

use scenario::Trial;
use scenario::fault::{Fault, Faults, Group};

use crate::sensor::Counts;
pub(crate) use sensor::SensorFaults;

/// What goes wrong with the rig.
#[derive(Clone, Debug)]
pub(crate) struct RigFaults {
    /// Those of the drive and of its plant.
    faults: Faults,
    sensor: SensorFaults,
    /// Scenario times at which something begins or ends, in order.
    changes: Vec<Duration>,
    /// When the scenario began.
    zero: Option<Duration>,
}

impl RigFaults {
    /// The faults of a drive, which have not begun.
    pub(crate) fn new(trial: &Trial, sensor_unit: f64, seed: u64) -> Self {
        let faults = trial.drive_faults();
        let is_of_rig = |fault: &&Fault| !matches!(fault.kind.group, Group::Bus | Group::Node);
        let of_rig = faults.iter().filter(is_of_rig);
        let times = of_rig.flat_map(|fault| [fault.from_seconds, fault.until_seconds]);
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

    /// Scenario time begins.
    pub(crate) fn begin(&mut self, zero: Duration) {
        self.zero = Some(zero);
    }

    /// The next change after `now`.
    pub(crate) fn next_change(&self, now: Duration) -> Option<Duration> {
        let zero = self.zero?;
        let changes = self.changes.iter().map(|change| zero + *change);
        changes.into_iter().find(|change| *change > now)
    }

    /// What the sensor's converter puts out in place of what it should: `convert` is the sound converter.
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

    /// The current that flows in place of what is commanded, where the plant conducts.
    pub(crate) fn current_amperes(&self, now: Duration, commanded_amperes: f64) -> f64 {
        match self.time_seconds(now) {
            Some(time) => amplifier::current_amperes(&self.faults, time, commanded_amperes),
            None => commanded_amperes,
        }
    }

    /// What goes wrong with the plant, and the scenario time; none before it begins and where nothing will go wrong.
    pub(crate) fn of_plant(&self, now: Duration) -> Option<(&Faults, f64)> {
        Some((&self.faults, self.time_seconds(now)?))
    }

    /// Scenario time; none before it begins and where nothing will go wrong.
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

    /// The faults of these tables.
    pub(crate) fn faults(tables: &str) -> Faults {
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n{tables}"
        );
        let scenario = Trial::parse(&text, "t.toml", |_| unreachable!("no table"));
        scenario.unwrap().run.faults.clone()
    }
}
