//! Timing of a run in real time: latencies between frames, and the counters of the nodes' loops.
//!
//! Latencies are differences of the receive stamps of one recorder; wake-up lateness comes from the nodes' loops.

use std::time::Duration;

use dbc::SignalMissing;
use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};
use hdrhistogram::Histogram;
use plan::{ControlLoop, Plan, each_once};
use serde::{Deserialize, Serialize};

use crate::log::Stamped;
use crate::sources::Sent;
use crate::stalls::Stall;

/// Largest latency that is counted; a larger one counts as this.
const LATENCY_MICROSECONDS_MAX: u64 = 10_000_000;

/// Names of the quantiles.
const QUANTILES: [&str; 4] = ["median", "p99", "p99_9", "max"];

/// Median and tail of a distribution, in microseconds.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct Quantiles {
    /// Half of the values are not above it.
    pub median: f64,
    /// 99 % of the values are not above it.
    pub p99: f64,
    /// 99.9 % of the values are not above it.
    pub p99_9: f64,
    /// The largest value.
    pub max: f64,
}

impl Quantiles {
    /// Returns the quantiles of a histogram with `per_microsecond` units in a microsecond.
    pub fn new(histogram: &Histogram<u64>, per_microsecond: u32) -> Self {
        let at =
            |quantile| histogram.value_at_quantile(quantile) as f64 / f64::from(per_microsecond);
        Self {
            median: at(0.5),
            p99: at(0.99),
            p99_9: at(0.999),
            max: at(1.0),
        }
    }

    /// Returns the values, from the median to the largest.
    pub fn values(&self) -> [f64; 4] {
        [self.median, self.p99, self.p99_9, self.max]
    }

    /// Returns the quantile of this name.
    pub fn named(&self, name: &str) -> Option<f64> {
        let place = QUANTILES.iter().position(|known| *known == name)?;
        Some(self.values()[place])
    }

    /// Returns the larger of each quantile.
    #[must_use]
    pub fn worst(self, other: Self) -> Self {
        Self {
            median: self.median.max(other.median),
            p99: self.p99.max(other.p99),
            p99_9: self.p99_9.max(other.p99_9),
            max: self.max.max(other.max),
        }
    }
}

/// Counters of a node's loop, as its process reports them at its end.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct NodeReport {
    pub ticks: u64,
    /// Number of deadlines that had passed before the tick before them was done.
    pub overruns: u64,
    /// Lateness of the ticks.
    pub wake_up_lateness_microseconds: Quantiles,
    /// Number of frames that were lost before the node could take them.
    pub frames_dropped: u64,
    /// Number of frames that waited for room in the full queue of the bus (ENOBUFS) before they were sent.
    #[serde(default)]
    pub frames_delayed: u64,
    /// Number of cycles in which the process of a law did not answer in time.
    #[serde(default, skip_serializing_if = "is_none")]
    pub late_answers: u64,
    /// Refusals of the system: priority, locked memory.
    pub refused: Vec<String>,
    /// Number of frames that the node sent, by identifier. The world moves them to the run's own list.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sent: Vec<(u16, u64)>,
    /// Deadlines before which the loop waited and was woken late, with the times of the wake-ups, in nanoseconds of the monotonic
    /// clock. The world moves them to the run's stalls.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub late: Vec<[u64; 2]>,
}

fn is_none(number: &u64) -> bool {
    *number == 0
}

impl NodeReport {
    /// Merges the reports of two nodes: the sums of their counts, and the worse lateness.
    #[must_use]
    pub fn beside(self, other: Self) -> Self {
        let lateness = self.wake_up_lateness_microseconds;
        Self {
            ticks: self.ticks + other.ticks,
            overruns: self.overruns + other.overruns,
            wake_up_lateness_microseconds: lateness.worst(other.wake_up_lateness_microseconds),
            frames_dropped: self.frames_dropped + other.frames_dropped,
            frames_delayed: self.frames_delayed + other.frames_delayed,
            late_answers: self.late_answers + other.late_answers,
            refused: each_once(self.refused.into_iter().chain(other.refused)),
            sent: self.sent.into_iter().chain(other.sent).collect(),
            late: self.late.into_iter().chain(other.late).collect(),
        }
    }
}

/// Knowledge of a world in real time apart from the frames.
#[derive(Clone, Debug, Default)]
pub struct Host {
    /// Report of the controller's loop; `None` for an external controller.
    pub controller: Option<NodeReport>,
    /// Merged report of the emulators' loops; `None` with external drives only.
    pub plant_emulator: Option<NodeReport>,
    /// Step of the wall clock in the run.
    pub wall_clock_step: Duration,
    /// Names of the nodes that canrig did not start, on a bus of this machine: they stand still
    /// with it.
    pub on_this_machine: Vec<String>,
    /// Stalls by which the machine held the nodes up, in the order of time.
    pub stalls: Vec<Stall>,
    /// Frames that canrig's nodes sent.
    pub sent: Sent,
}

/// Measures the latencies of all cycles of a recording, from scenario time 0 to its end, in microseconds: from the SYNC to the
/// drive's position, from there to the command that follows from it, and from the SYNC to the command.
///
/// # Errors
/// If the database lacks a signal.
pub fn latencies(
    frames: impl IntoIterator<Item = Stamped>,
    plan: &Plan,
    one: &ControlLoop,
) -> Result<[Histogram<u64>; 3], SignalMissing> {
    let mut latencies = [(); 3].map(|()| {
        Histogram::new_with_max(LATENCY_MICROSECONDS_MAX, 3)
            .expect("constant bounds that the histogram takes")
    });
    let [sync_to_position, position_to_command, round_trip] = &mut latencies;
    let mut cycle = CycleReader::new(plan, one)?;
    let end = Duration::from_secs_f64(one.trial.run.duration_seconds);
    for stamped in frames {
        let time = cycle.on_frame(&stamped).filter(|time| *time < end);
        match time.and_then(|_| cycle.stage(&stamped)) {
            Some(CycleStage::Position { after_sync }) => record(sync_to_position, after_sync),
            Some(CycleStage::Command {
                after_position,
                after_sync,
            }) => {
                record(position_to_command, after_position);
                record(round_trip, after_sync);
            }
            Some(CycleStage::Sync) | None => {}
        }
    }
    Ok(latencies)
}

/// Stage of a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CycleStage {
    /// The cycle began.
    Sync,
    /// The drive sent its position.
    Position {
        /// Time since the SYNC.
        after_sync: Duration,
    },
    /// The controller sent the command that follows from a position.
    Command {
        /// Time since the position in this cycle that its law follows.
        after_position: Duration,
        /// Time since the SYNC.
        after_sync: Duration,
    },
}

/// Reader that follows each cycle from its SYNC over the position to the command.
pub struct CycleReader {
    clock: ScenarioClock,
    position_id: u32,
    /// Position that the law of the drive follows: for a further drive that of another one.
    followed_id: u32,
    command_id: u32,
    sync: Option<Duration>,
    has_position: bool,
    followed: Option<Duration>,
    has_command: bool,
}

impl CycleReader {
    /// # Errors
    /// If the database lacks a signal.
    pub fn new(plan: &Plan, one: &ControlLoop) -> Result<Self, SignalMissing> {
        let database = plan.database();
        Ok(Self {
            clock: plan.scenario_clock()?,
            position_id: one.position(database)?.raw_id(),
            followed_id: one.commanding_position(database)?.raw_id(),
            command_id: one.target(database)?.raw_id(),
            sync: None,
            has_position: false,
            followed: None,
            has_command: false,
        })
    }

    /// Takes every frame of the bus in order; returns its scenario time, `None` before the scenario began.
    #[inline]
    pub fn on_frame(&mut self, stamped: &Stamped) -> Option<Duration> {
        self.clock.on_frame(stamped.time, &stamped.frame);
        self.clock.scenario_time(stamped.time)
    }

    /// Returns the stage of a frame in its cycle, after [`CycleReader::on_frame`].
    #[inline]
    pub fn stage(&mut self, stamped: &Stamped) -> Option<CycleStage> {
        let since = |before: Duration| stamped.time.saturating_sub(before);
        let id = stamped.frame.raw_id();
        if id == u32::from(SYNC_COB_ID) {
            (self.sync, self.followed) = (Some(stamped.time), None);
            (self.has_position, self.has_command) = (false, false);
            return Some(CycleStage::Sync);
        }
        let after_sync = since(self.sync?);
        if id == self.followed_id && self.followed.is_none() {
            self.followed = Some(stamped.time);
        }
        if id == self.position_id && !std::mem::replace(&mut self.has_position, true) {
            return Some(CycleStage::Position { after_sync });
        }
        let followed = self.followed.filter(|_| id == self.command_id)?;
        let is_first = !std::mem::replace(&mut self.has_command, true);
        is_first.then(|| CycleStage::Command {
            after_position: since(followed),
            after_sync,
        })
    }
}

fn record(histogram: &mut Histogram<u64>, latency: Duration) {
    histogram.saturating_record(u64::try_from(latency.as_micros()).unwrap_or(u64::MAX));
}

#[cfg(test)]
mod tests {
    use super::*;

    use can::CanFrame;
    use plan::Plan;
    use plan::catalogue::Catalogue;
    use scenario::Beside;
    use std::path::Path;

    fn plan() -> Plan {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        testing::plan(text)
    }

    fn stamped(micros: u64, id: u16, data: &[u8]) -> Stamped {
        Stamped::new(Duration::from_micros(micros), CanFrame::new(id, data))
    }

    #[test]
    fn latencies_are_differences_of_stamps_within_a_cycle() {
        let plan = plan();
        let enabled = [0x37, 0x02, 0, 0, 0, 0, 0, 0];
        let frames = [
            (0, 0x190),
            (1000, 0x080),
            (1150, 0x190),
            (1400, 0x210),
            (2000, 0x080),
            (2250, 0x190),
            (2300, 0x190),
            (3000, 0x080),
            (3100, 0x210),
        ]
        .map(|(micros, id)| stamped(micros, id, &enabled));
        let latencies = latencies(frames, &plan, plan.only_loop().unwrap()).unwrap();
        let counts = latencies.each_ref().map(Histogram::len);
        let [sync_to_position, position_to_command, round_trip] =
            latencies.map(|histogram| Quantiles::new(&histogram, 1));
        assert_eq!(counts, [2, 1, 1]);
        assert_eq!(sync_to_position.max, 250.0);
        assert_eq!(position_to_command.median, 250.0);
        assert_eq!(round_trip.max, 400.0);
    }

    /// The command to a further drive follows from the position of the first one, and may come before its own.
    #[test]
    fn the_command_to_a_further_drive_is_timed_from_the_position_that_its_law_follows() {
        let text = "schema = 1\nrig = \"sma_pair\"\nname = \"t\"\nduration_seconds = 1.0\n\
            [controller.pid_pair]\n[[reference.hold]]\nat_seconds = 0.0\nposition_degrees = 5.0\n";
        let (beside, read) = (Beside::new(Path::new("t.toml")), |_: &str| unreachable!());
        let plan = Plan::parse(&beside, text.to_owned(), read, &Catalogue::shipped()).unwrap();
        let drive = |one: &&ControlLoop| one.drive().name == "extensor";
        let extensor = plan.loops.iter().find(drive).unwrap();
        let enabled = [0x37, 0x02, 0, 0, 0, 0, 0, 0];
        let frames = [
            (0, 0x190),
            (0, 0x192),
            (1000, 0x080),
            (1200, 0x190),
            (1450, 0x212),
            (1600, 0x192),
            (1700, 0x212),
            (2000, 0x080),
            (2100, 0x192),
            (2200, 0x212),
        ]
        .map(|(micros, id)| stamped(micros, id, &enabled));
        let latencies = latencies(frames, &plan, extensor).unwrap();
        let found = latencies.map(|histogram| (histogram.len(), histogram.max()));
        assert_eq!(found, [(2, 600), (1, 250), (1, 450)]);
    }

    #[test]
    fn quantiles_are_ranks_and_the_worst_of_two_is_that_of_each() {
        let mut histogram = Histogram::new_with_max(10_000, 5).unwrap();
        (1..=1000).for_each(|value| histogram.saturating_record(2 * value));
        let quantiles = Quantiles::new(&histogram, 2);
        let expected = Quantiles {
            median: 500.0,
            p99: 990.0,
            p99_9: 999.0,
            max: 1000.0,
        };
        assert_eq!(quantiles, expected);
        let other = Quantiles {
            median: 501.0,
            p99: 989.0,
            p99_9: 1001.0,
            max: 999.0,
        };
        let worst = Quantiles {
            median: 501.0,
            p99_9: 1001.0,
            ..expected
        };
        assert_eq!(
            (expected.worst(other), other.worst(expected)),
            (worst, worst)
        );
    }
}
