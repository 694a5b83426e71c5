//! How well a run in real time kept its deadlines.
//!
//! Latencies are differences of the receive stamps of one recorder; wake-up lateness is what the nodes' loops counted.

use std::ops::Add;
use std::time::Duration;

use dbc::Database;
use hdrhistogram::Histogram;
use scenario::Scenario;
use scenario::expect::Limit;
use scenario::timing::{QuantileLimits, TimingLimits};
use serde::{Deserialize, Serialize};

use crate::recording::Stamped;
use crate::signals::{self, SignalMissing};
use crate::verdict::Metric;
use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};

/// Latencies above this count as this.
const LATENCY_MICROSECONDS_MAX: u64 = 10_000_000;
const NO_LOOP: &str = "not available: all nodes are external";
/// A wall clock that was stepped by more makes the stamps worthless.
const CLOCK_STEP_MAX: Duration = Duration::from_millis(1);

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
    /// The quantiles of a histogram whose unit is so many in a microsecond.
    #[must_use]
    pub fn of(histogram: &Histogram<u64>, per_microsecond: u32) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "values stay far below 2^52")]
        let at =
            |quantile| histogram.value_at_quantile(quantile) as f64 / f64::from(per_microsecond);
        Self {
            median: at(0.5),
            p99: at(0.99),
            p99_9: at(0.999),
            max: at(1.0),
        }
    }

    fn worst(self, other: Self) -> Self {
        Self {
            median: self.median.max(other.median),
            p99: self.p99.max(other.p99),
            p99_9: self.p99_9.max(other.p99_9),
            max: self.max.max(other.max),
        }
    }
}

/// What a node's loop counted, as its process reports it at its end.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct NodeReport {
    /// Ticks of the node.
    pub ticks: u64,
    /// Deadlines that had passed before the tick before them was done.
    pub overruns: u64,
    /// How late the ticks were.
    pub wake_up_lateness_microseconds: Quantiles,
    /// Frames that were lost before the node could take them.
    pub frames_dropped: u64,
    /// Frames that waited for room in the full queue of the bus (ENOBUFS) before they were sent.
    #[serde(default)]
    pub frames_delayed: u64,
    /// What the system refused: priority, locked memory.
    pub refused: Vec<String>,
}

/// What a world in real time knows besides the frames.
#[derive(Clone, Debug, Default)]
pub struct Host {
    /// What the controller's loop counted; none of one that is external.
    pub controller: Option<NodeReport>,
    /// What the emulator's loop counted; none beside an external drive.
    pub plant_emulator: Option<NodeReport>,
    /// By how much the wall clock was stepped in the run.
    pub wall_clock_step: Duration,
    /// Processes that wanted to run at the end, on average over a minute, and the processors there are.
    pub load: Option<(f64, usize)>,
}

/// Timing of a run, as `verdict.json` holds it. Not part of a verdict in virtual time.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Timing {
    /// What the controller's loop counted; none of one that is external.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller: Option<NodeReport>,
    /// What the emulator's loop counted; none beside an external drive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plant_emulator: Option<NodeReport>,
    /// From the SYNC to the drive's position.
    pub sync_to_position_microseconds: Quantiles,
    /// From the drive's position to the command that follows from it.
    pub position_to_command_microseconds: Quantiles,
    /// From the SYNC to the command.
    pub round_trip_microseconds: Quantiles,
    /// Why these numbers say nothing about the software; empty when they do.
    pub distrust: Vec<String>,
}

impl Timing {
    /// The timing of a run from its recording and from what the host knows.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub fn of(
        frames: &[Stamped],
        scenario: &Scenario,
        database: &Database,
        host: Host,
    ) -> Result<Self, SignalMissing> {
        let mut latencies = Latencies::new(database)?;
        let end = Duration::from_secs_f64(scenario.duration_seconds);
        for stamped in frames {
            latencies.take(stamped, end);
        }
        Ok(Self {
            distrust: distrust(&host),
            sync_to_position_microseconds: Quantiles::of(&latencies.sync_to_position, 1),
            position_to_command_microseconds: Quantiles::of(&latencies.position_to_command, 1),
            round_trip_microseconds: Quantiles::of(&latencies.round_trip, 1),
            controller: host.controller,
            plant_emulator: host.plant_emulator,
        })
    }

    /// The timing of the same run, read from its recording again. What only the host knew is kept.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub fn again(
        self,
        frames: &[Stamped],
        scenario: &Scenario,
        database: &Database,
    ) -> Result<Self, SignalMissing> {
        let measured = Self::of(frames, scenario, database, Host::default())?;
        Ok(Self {
            controller: self.controller,
            plant_emulator: self.plant_emulator,
            distrust: self.distrust,
            ..measured
        })
    }

    /// The loops that canrig ran, with their names.
    fn loops(&self) -> impl Iterator<Item = (&'static str, &NodeReport)> {
        let loops = [
            ("controller", &self.controller),
            ("plant emulator", &self.plant_emulator),
        ];
        loops
            .into_iter()
            .filter_map(|(name, report)| Some((name, report.as_ref()?)))
    }

    /// Frames of the loops that waited for room in a full queue; none where all nodes are external.
    fn frames_delayed(&self) -> Option<u64> {
        self.loops()
            .map(|(_, report)| report.frames_delayed)
            .reduce(u64::add)
    }

    /// The worse of the loops; none where all nodes are external.
    fn wake_up_lateness(&self) -> Option<Quantiles> {
        self.loops()
            .map(|(_, report)| report.wake_up_lateness_microseconds)
            .reduce(Quantiles::worst)
    }

    /// The distributions with their names, for people.
    #[must_use]
    pub fn rows(&self) -> Vec<(String, Quantiles)> {
        let lateness = self.loops().map(|(name, report)| {
            let quantiles = report.wake_up_lateness_microseconds;
            (format!("wake-up lateness, {name}"), quantiles)
        });
        let latencies = [
            ("SYNC to position", self.sync_to_position_microseconds),
            ("position to command", self.position_to_command_microseconds),
            ("round trip", self.round_trip_microseconds),
        ];
        let latencies = latencies.map(|(name, quantiles)| (name.to_owned(), quantiles));
        lateness.chain(latencies).collect()
    }

    /// What each loop lost, for people.
    #[must_use]
    pub fn losses(&self) -> String {
        let losses = self.loops().map(|(name, report)| {
            let NodeReport {
                overruns,
                frames_dropped,
                frames_delayed,
                ..
            } = report;
            let delayed = match frames_delayed {
                0 => String::new(),
                frames => format!(", {frames} frames delayed by a full queue of the bus"),
            };
            format!("{name}: {overruns} overruns, {frames_dropped} frames dropped{delayed}")
        });
        losses.collect::<Vec<_>>().join("; ")
    }

    /// The limits that are given, held against their values.
    #[must_use]
    pub fn metrics(&self, limits: &TimingLimits) -> Vec<Metric> {
        let latencies = [
            (
                "wake_up_lateness_microseconds",
                self.wake_up_lateness(),
                limits.wake_up_lateness_microseconds,
            ),
            (
                "sync_to_position_microseconds",
                Some(self.sync_to_position_microseconds),
                limits.sync_to_position_microseconds,
            ),
            (
                "position_to_command_microseconds",
                Some(self.position_to_command_microseconds),
                limits.position_to_command_microseconds,
            ),
            (
                "round_trip_microseconds",
                Some(self.round_trip_microseconds),
                limits.round_trip_microseconds,
            ),
        ];
        let quantiles = latencies
            .into_iter()
            .flat_map(|(latency, values, limits)| quantile_metrics(latency, values, limits));
        #[expect(clippy::cast_precision_loss, reason = "frames of one run")]
        let delayed = self.frames_delayed().map(|frames| frames as f64);
        let delayed = metric("frames_delayed".to_owned(), delayed, limits.frames_delayed);
        quantiles.chain(delayed).collect()
    }
}

/// The limits of one latency that are given, held against its quantiles.
fn quantile_metrics(
    latency: &'static str,
    values: Option<Quantiles>,
    limits: QuantileLimits,
) -> impl Iterator<Item = Metric> {
    let quantiles = [
        ("median", values.map(|values| values.median), limits.median),
        ("p99", values.map(|values| values.p99), limits.p99),
        ("p99_9", values.map(|values| values.p99_9), limits.p99_9),
        ("max", values.map(|values| values.max), limits.max),
    ];
    quantiles
        .into_iter()
        .filter_map(move |(quantile, value, limit)| {
            metric(format!("{latency}_{quantile}"), value, limit)
        })
}

/// A value held against its limit, where one is given. External nodes report no value.
fn metric(name: String, value: Option<f64>, limit: Option<Limit>) -> Option<Metric> {
    limit?;
    Some(match value {
        Some(value) => Metric::new(name, Ok(value), limit),
        None => Metric::not_judged(name, NO_LOOP.to_owned(), limit),
    })
}

/// Why the timing of this host proves nothing.
fn distrust(host: &Host) -> Vec<String> {
    let mut reasons: Vec<String> = Vec::new();
    for report in [&host.controller, &host.plant_emulator]
        .into_iter()
        .flatten()
    {
        for refusal in &report.refused {
            if !reasons.contains(refusal) {
                reasons.push(refusal.clone());
            }
        }
    }
    if host.wall_clock_step > CLOCK_STEP_MAX {
        reasons.push(format!(
            "the wall clock was stepped by {:.1} ms during the run",
            1e3 * host.wall_clock_step.as_secs_f64()
        ));
    }
    if let Some((load, processors)) = host.load {
        #[expect(clippy::cast_precision_loss, reason = "a number of processors")]
        let is_overloaded = load > processors as f64;
        if is_overloaded {
            reasons.push(format!(
                "the machine is overloaded (load {load:.1} on {processors} processors)"
            ));
        }
    }
    reasons
}

/// The latencies of all cycles.
struct Latencies {
    cycle: CycleReader,
    sync_to_position: Histogram<u64>,
    position_to_command: Histogram<u64>,
    round_trip: Histogram<u64>,
}

impl Latencies {
    fn new(database: &Database) -> Result<Self, SignalMissing> {
        let histogram = || {
            Histogram::new_with_max(LATENCY_MICROSECONDS_MAX, 3)
                .expect("constant bounds that the histogram takes")
        };
        Ok(Self {
            cycle: CycleReader::new(database)?,
            sync_to_position: histogram(),
            position_to_command: histogram(),
            round_trip: histogram(),
        })
    }

    fn take(&mut self, stamped: &Stamped, end: Duration) {
        match self.cycle.take(stamped, end) {
            Some(Stage::Position { after_sync }) => record(&mut self.sync_to_position, after_sync),
            Some(Stage::Command {
                after_position,
                after_sync,
            }) => {
                record(&mut self.position_to_command, after_position);
                record(&mut self.round_trip, after_sync);
            }
            Some(Stage::Sync { .. }) | None => {}
        }
    }
}

/// A step of a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    /// It began.
    Sync {
        /// When, in scenario time.
        time: Duration,
    },
    /// The drive told its position.
    Position {
        /// Since the SYNC.
        after_sync: Duration,
    },
    /// The controller sent the command that follows from it.
    Command {
        /// Since the position.
        after_position: Duration,
        /// Since the SYNC.
        after_sync: Duration,
    },
}

/// Follows each cycle from its SYNC over the position to the command.
pub(crate) struct CycleReader {
    clock: ScenarioClock,
    position_id: u32,
    command_id: u32,
    sync: Option<Duration>,
    position: Option<Duration>,
}

impl CycleReader {
    /// A reader that has heard nothing.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub(crate) fn new(database: &Database) -> Result<Self, SignalMissing> {
        Ok(Self {
            clock: ScenarioClock::new(database)?,
            position_id: database.require(signals::POSITION)?.raw_id(),
            command_id: database.require(signals::TARGET_CURRENT)?.raw_id(),
            sync: None,
            position: None,
        })
    }

    /// Takes every frame of the bus in order; what it is to its cycle, from scenario time 0 to `end`.
    pub(crate) fn take(&mut self, stamped: &Stamped, end: Duration) -> Option<Stage> {
        let time = self.hear(stamped).filter(|time| *time < end)?;
        self.stage(stamped, time)
    }

    /// Hears every frame of the bus in order; its scenario time, `None` before the scenario began.
    #[inline]
    pub(crate) fn hear(&mut self, stamped: &Stamped) -> Option<Duration> {
        self.clock.on_frame(stamped.time, &stamped.frame);
        self.clock.scenario_time(stamped.time)
    }

    /// What a frame that was heard is to its cycle.
    #[inline]
    pub(crate) fn stage(&mut self, stamped: &Stamped, time: Duration) -> Option<Stage> {
        let since = |before: Duration| stamped.time.saturating_sub(before);
        let id = stamped.frame.raw_id();
        if id == u32::from(SYNC_COB_ID) {
            self.sync = Some(stamped.time);
            self.position = None;
            Some(Stage::Sync { time })
        } else if id == self.position_id && self.position.is_none() {
            let sync = self.sync?;
            self.position = Some(stamped.time);
            Some(Stage::Position {
                after_sync: since(sync),
            })
        } else if id == self.command_id {
            let position = self.position.take()?;
            let sync = self.sync.take()?;
            Some(Stage::Command {
                after_position: since(position),
                after_sync: since(sync),
            })
        } else {
            None
        }
    }
}

fn record(histogram: &mut Histogram<u64>, latency: Duration) {
    histogram.saturating_record(u64::try_from(latency.as_micros()).unwrap_or(u64::MAX));
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    use canopen::CanFrame;
    use serde_json::{Value, json};

    fn stamped(micros: u64, id: u16, data: &[u8]) -> Stamped {
        Stamped::new(Duration::from_micros(micros), CanFrame::new(id, data))
    }

    #[test]
    fn latencies_are_differences_of_stamps_within_a_cycle() {
        let mut latencies = Latencies::new(Database::sma_actuator()).unwrap();
        let enabled = [0x37, 0x02, 0, 0, 0, 0, 0, 0];
        let end = Duration::from_secs(1);
        for (micros, id) in [
            (0, 0x190),
            (1000, 0x080),
            (1150, 0x190),
            (1400, 0x210),
            (2000, 0x080),
            (2250, 0x190),
            (2300, 0x190),
            (3000, 0x080),
            (3100, 0x210),
        ] {
            latencies.take(&stamped(micros, id, &enabled), end);
        }
        let quantiles = |histogram| Quantiles::of(histogram, 1);
        assert_eq!(latencies.sync_to_position.len(), 2);
        assert_eq!(quantiles(&latencies.sync_to_position).max, 250.0);
        assert_eq!(quantiles(&latencies.position_to_command).median, 250.0);
        assert_eq!(latencies.round_trip.len(), 1);
        assert_eq!(quantiles(&latencies.round_trip).max, 400.0);
    }

    #[test]
    fn a_stepped_clock_a_refusal_and_a_load_are_distrusted() {
        let mut host = Host {
            load: Some((1.5, 2)),
            ..Host::default()
        };
        assert_eq!(distrust(&host), Vec::<String>::new());
        host.wall_clock_step = Duration::from_millis(30);
        host.load = Some((8.0, 2));
        let refused = NodeReport {
            refused: vec!["no priority".to_owned()],
            ..NodeReport::default()
        };
        (host.controller, host.plant_emulator) = (Some(refused.clone()), Some(refused));
        let expected = [
            "no priority",
            "the wall clock was stepped by 30.0 ms during the run",
            "the machine is overloaded (load 8.0 on 2 processors)",
        ];
        assert_eq!(distrust(&host), expected);
    }

    /// The limits of each key in the schema's `[expect.timing]` become metrics with the names that it has in `requirements`.
    #[test]
    fn each_key_of_the_schema_has_its_metric() {
        let schema: Value = serde_json::from_str(&scenario::schema::json_schema()).unwrap();
        let keys = |table: &str| {
            let properties = &schema["definitions"][table]["properties"];
            let keys: Vec<String> = properties.as_object().unwrap().keys().cloned().collect();
            keys
        };
        let limit = json!({ "max": 1.0 });
        let quantiles = keys("QuantileLimits");
        let mut limits = serde_json::Map::new();
        let mut expected = BTreeSet::new();
        for key in keys("TimingLimits") {
            if key == "frames_delayed" {
                limits.insert(key.clone(), limit.clone());
                expected.insert(key);
                continue;
            }
            let of_each = quantiles.iter().map(|name| (name.clone(), limit.clone()));
            expected.extend(quantiles.iter().map(|name| format!("{key}_{name}")));
            limits.insert(key, of_each.collect::<serde_json::Map<_, _>>().into());
        }
        assert_eq!(expected.len(), 4 * 4 + 1);
        let limits: TimingLimits = serde_json::from_value(limits.into()).unwrap();
        let timing = Timing {
            controller: None,
            plant_emulator: None,
            sync_to_position_microseconds: Quantiles::default(),
            position_to_command_microseconds: Quantiles::default(),
            round_trip_microseconds: Quantiles::default(),
            distrust: Vec::new(),
        };
        let metrics = timing.metrics(&limits);
        let names: Vec<&str> = metrics.iter().map(|metric| metric.name.as_str()).collect();
        assert_eq!(BTreeSet::from_iter(limits.rows()), expected);
        assert!(limits.rows().eq(names), "in the same order");
    }

    /// Each quantile is held against its own limit.
    #[test]
    fn a_metric_has_the_value_of_its_quantile() {
        let quantiles = Quantiles {
            median: 1.0,
            p99: 2.0,
            p99_9: 3.0,
            max: 4.0,
        };
        let limit = Some(Limit {
            min: None,
            max: Some(2.5),
        });
        let limits = QuantileLimits {
            median: limit,
            p99: None,
            p99_9: limit,
            max: limit,
        };
        let rows = quantile_metrics("latency", Some(quantiles), limits);
        let rows = rows.map(|metric| (metric.name, metric.value.unwrap(), metric.passed.unwrap()));
        let expected = [
            ("latency_median", 1.0, true),
            ("latency_p99_9", 3.0, false),
            ("latency_max", 4.0, false),
        ];
        let expected = expected.map(|(name, value, passed)| (name.to_owned(), value, passed));
        assert_eq!(rows.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn limits_on_time_pass_only_where_the_timing_is_trusted() {
        use scenario::expect::Expect;

        use crate::judge::judge_timing;
        use crate::verdict::{Outcome, Verdict};
        use scenario::expect::Limit;
        let timing = |p99, distrust: &[&str]| Timing {
            controller: Some(NodeReport::default()),
            plant_emulator: Some(NodeReport::default()),
            sync_to_position_microseconds: Quantiles::default(),
            position_to_command_microseconds: Quantiles::default(),
            round_trip_microseconds: Quantiles {
                p99,
                ..Quantiles::default()
            },
            distrust: distrust.iter().map(ToString::to_string).collect(),
        };
        let max = |max| {
            let limit = Limit {
                min: None,
                max: Some(max),
            };
            Some(limit)
        };
        let name = "round_trip_microseconds_p99";
        let mut limits = Expect {
            requirements: [(name.to_owned(), vec!["REQ-1".to_owned()])].into(),
            ..Expect::default()
        };
        limits.timing.round_trip_microseconds.p99 = max(800.0);
        let outcome = |missed: f64, timing: Timing, limits: &Expect| {
            let mut verdict = Verdict::incomplete("hold", 1, "");
            verdict.metrics = vec![Metric::new("missed_cycles_percent", Ok(missed), max(0.1))];
            let passed = verdict.metrics[0].passed == Some(true);
            verdict.outcome = if passed { Outcome::Pass } else { Outcome::Fail };
            judge_timing(&mut verdict, timing, limits);
            let row = verdict.metrics.iter().find(|metric| metric.name == name);
            assert!(row.is_none_or(|row| row.requirements == ["REQ-1"]));
            assert_eq!(row.is_some(), !limits.timing.is_empty());
            verdict.outcome
        };
        let refused = ["no priority"];
        assert_eq!(outcome(0.0, timing(700.0, &[]), &limits), Outcome::Pass);
        assert_eq!(outcome(0.0, timing(900.0, &[]), &limits), Outcome::Fail);
        for p99 in [700.0, 900.0] {
            let judged = outcome(0.0, timing(p99, &refused), &limits);
            assert_eq!(judged, Outcome::Inconclusive);
        }
        assert_eq!(outcome(0.5, timing(700.0, &[]), &limits), Outcome::Fail);
        // What nobody tells does not pass, and does not hide what fails.
        let untold = |p99| {
            let mut verdict = Verdict::incomplete("hold", 1, "");
            let name = "temperature_celsius";
            verdict.metrics = vec![Metric::not_judged(
                name,
                "not available".to_owned(),
                max(90.0),
            )];
            verdict.outcome = Outcome::Inconclusive;
            verdict.reason = Some(format!("not judged: {name}"));
            judge_timing(&mut verdict, timing(p99, &[]), &limits);
            verdict.outcome
        };
        assert_eq!(untold(700.0), Outcome::Inconclusive);
        assert_eq!(untold(900.0), Outcome::Fail);
        // Without limits on time the timing is only reported.
        let none = Expect::default();
        assert_eq!(outcome(0.0, timing(9e9, &refused), &none), Outcome::Pass);
        assert_eq!(
            outcome(0.5, timing(9e9, &refused), &none),
            Outcome::Inconclusive
        );
    }
}
