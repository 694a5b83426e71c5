//! Progress of a run, for its observers.

use std::time::Duration;

use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};
use dbc::{Database, Quantities, SignalHandle, SignalMissing};
use plan::{ControlLoop, Plan};
use scenario::reference::Trajectory;

use crate::log::Stamped;

/// State of a run, as far as it is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunProgress {
    /// Scenario time; zero before it begins.
    pub time: Duration,
    /// Its loops in their order; empty before it begins.
    pub loops: Vec<LoopProgress>,
    /// Largest lateness of the latest SYNCs.
    pub lateness: Option<Duration>,
}

/// State of a loop, as far as it is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoopProgress {
    /// Name, if there are several loops.
    pub name: Option<String>,
    /// Quantities of the loop's feedback and command.
    pub quantities: Quantities,
    pub position: Option<f64>,
    /// Set-point minus position, if the loop has a set-point.
    pub error: Option<f64>,
}

/// Reader of the state of a run from its frames.
#[derive(Debug)]
pub struct ProgressReader {
    loops: Vec<LoopReader>,
    period: Duration,
}

#[derive(Debug)]
struct LoopReader {
    name: Option<String>,
    position: SignalHandle,
    quantities: Quantities,
    set_point: Option<Trajectory>,
}

impl LoopReader {
    fn new(database: &Database, one: &ControlLoop) -> Result<Self, SignalMissing> {
        let scenario = &one.trial;
        let has_set_point = !scenario.reference.is_empty();
        Ok(Self {
            name: one.loop_name().map(str::to_owned),
            position: one.position(database)?,
            quantities: scenario.wiring.quantities.clone(),
            set_point: has_set_point.then(|| scenario.reference.trajectory()),
        })
    }

    fn read(&self, frames: &[Stamped], time: Duration) -> LoopProgress {
        let mut latest = frames.iter().rev();
        let position = latest.find_map(|stamped| self.position.decode(&stamped.frame));
        let curve = self.set_point.as_ref();
        let set_point = curve.map(|curve| curve.at(time.as_secs_f64()).position);
        LoopProgress {
            name: self.name.clone(),
            quantities: self.quantities.clone(),
            position,
            error: set_point
                .zip(position)
                .map(|(wanted, position)| wanted - position),
        }
    }
}

impl ProgressReader {
    /// # Errors
    /// If the database lacks the position of a loop.
    pub fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        let loops = plan.loops.iter();
        let loops = loops.map(|one| LoopReader::new(plan.database(), one));
        Ok(Self {
            loops: loops.collect::<Result<_, _>>()?,
            period: plan.sync_period(),
        })
    }

    /// Returns the state after these frames, the latest of the run; `None` before scenario time 0 or without frames.
    pub fn read(&self, frames: &[Stamped], clock: &ScenarioClock) -> Option<RunProgress> {
        let time = clock.scenario_time(frames.last()?.time)?;
        let syncs = frames
            .iter()
            .filter(|stamped| stamped.frame.standard_id() == Some(SYNC_COB_ID));
        let lateness =
            syncs.filter_map(|sync| Some(self.lateness(clock.scenario_time(sync.time)?)));
        let loops = self.loops.iter().map(|one| one.read(frames, time));
        Some(RunProgress {
            time,
            loops: loops.collect(),
            lateness: lateness.max(),
        })
    }

    /// Returns the lateness of a SYNC after the nearest whole cycle; zero if it came before.
    fn lateness(&self, time: Duration) -> Duration {
        let half = self.period / 2;
        let since = time.saturating_add(half).as_nanos() % self.period.as_nanos().max(1);
        Duration::from_nanos_u128(since).saturating_sub(half)
    }
}

#[cfg(test)]
mod tests {
    use can::CanFrame;
    use dbc::Database;

    use super::*;

    #[test]
    fn position_error_and_the_worst_lateness_are_read() {
        let database = Database::shipped();
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"progress\"\nduration_seconds = 1.0\n\n[controller.sliding_mode]\n\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        let plan = testing::plan(text);
        let reader = ProgressReader::new(&plan).unwrap();
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
        let [only] = &progress.loops[..] else {
            panic!("{progress:?}")
        };
        let position = only.position.unwrap();
        assert!((position - 9.5).abs() < 0.01, "{position}");
        let error = only.error.unwrap();
        assert!((error - (10.0 - position)).abs() < 1e-9, "{error}");
    }
}
