//! How far a run is, for those who watch it.

use std::time::Duration;

use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};
use dbc::{SignalHandle, SignalMissing};
use plan::ControlLoop;
use scenario::port::Measurand;
use scenario::reference::Trajectory;

use crate::log::Stamped;

/// The state of a run, as far as it is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunProgress {
    /// Scenario time; zero before it begins.
    pub time: Duration,
    /// What the loop measures.
    pub measurand: Measurand,
    pub position: Option<f64>,
    /// Set-point minus position, where the scenario has a set-point.
    pub error: Option<f64>,
    /// By how much the latest SYNCs came behind their times at most.
    pub lateness: Option<Duration>,
}

/// Reads the state of a run from its frames.
#[derive(Debug)]
pub struct ProgressReader {
    position: SignalHandle,
    measurand: Measurand,
    set_point: Option<Trajectory>,
    period: Duration,
}

impl ProgressReader {
    /// # Errors
    /// The database lacks the position.
    pub fn new(one: &ControlLoop) -> Result<Self, SignalMissing> {
        let scenario = &one.trial;
        let has_set_point = !scenario.reference.is_empty();
        Ok(Self {
            position: one.position()?,
            measurand: scenario.wiring.feedback.measurand.clone(),
            set_point: has_set_point.then(|| scenario.reference.trajectory()),
            period: Duration::from_secs_f64(scenario.run.bus.sync_period_milliseconds / 1e3),
        })
    }

    /// The state after these frames, the latest of the run; `None` before scenario time 0 or without frames.
    #[must_use]
    pub fn read(&self, frames: &[Stamped], clock: &ScenarioClock) -> Option<RunProgress> {
        let time = clock.scenario_time(frames.last()?.time)?;
        let position = frames
            .iter()
            .rev()
            .find_map(|stamped| self.position.decode(&stamped.frame));
        let set_point = self
            .set_point
            .as_ref()
            .map(|curve| curve.at(time.as_secs_f64()).position);
        let syncs = frames
            .iter()
            .filter(|stamped| stamped.frame.standard_id() == Some(SYNC_COB_ID));
        let lateness =
            syncs.filter_map(|sync| Some(self.lateness(clock.scenario_time(sync.time)?)));
        Some(RunProgress {
            time,
            measurand: self.measurand.clone(),
            position,
            error: set_point
                .zip(position)
                .map(|(set_point, position)| set_point - position),
            lateness: lateness.max(),
        })
    }

    /// By how much a SYNC came after the nearest whole cycle; zero when it came before.
    fn lateness(&self, time: Duration) -> Duration {
        let half = self.period / 2;
        let since = time.saturating_add(half).as_nanos() % self.period.as_nanos().max(1);
        Duration::from_nanos_u128(since).saturating_sub(half)
    }
}

#[cfg(test)]
mod tests {
    use canopen::CanFrame;
    use dbc::Database;
    use plan::Plan;
    use plan::catalogue::Catalogue;
    use scenario::Trial;

    use super::*;

    #[test]
    fn position_error_and_the_worst_lateness_are_read() {
        let database = Database::shipped();
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"progress\"\nduration_seconds = 1.0\n\n[controller.sliding_mode]\n\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        let scenario = Trial::parse(text, "progress.toml", |_| unreachable!("no table")).unwrap();
        let plan = Plan::new(scenario, &Catalogue::shipped());
        let reader = ProgressReader::new(plan.leading()).unwrap();
        let mut clock = plan.scenario_clock().unwrap();
        let drive = |position: f64| {
            let mut builder = database.builder("drive_tpdo1").unwrap();
            for (name, value) in [
                ("statusword_state", 55.0),
                ("position_millimetres", position),
            ] {
                let signal = database.signal(&format!("drive_tpdo1.{name}")).unwrap();
                builder.set(&signal, value);
            }
            builder.frame()
        };
        let sync = || CanFrame::new(SYNC_COB_ID, &[]);
        let frames = [
            (500, drive(9.0)),
            (1000, sync()),
            (2300, sync()),
            (2900, drive(9.5)),
            (2990, sync()),
            (4100, sync()),
        ];
        let stamped = |(micros, frame)| Stamped::new(Duration::from_micros(micros), frame);
        let frames = frames.map(stamped);
        assert_eq!(reader.read(&frames[..1], &clock), None);
        for stamped in &frames {
            clock.on_frame(stamped.time, &stamped.frame);
        }
        let progress = reader.read(&frames, &clock).unwrap();
        assert_eq!(progress.time, Duration::from_micros(3100));
        assert_eq!(progress.lateness, Some(Duration::from_micros(300)));
        let position = progress.position.unwrap();
        assert!((position - 9.5).abs() < 0.01, "{position}");
        let error = progress.error.unwrap();
        assert!((error - (10.0 - position)).abs() < 1e-9, "{error}");
    }
}
