//! Deadlines that a run in real time kept, and the limits on them.

use std::ops::Add;
use std::time::Duration;

use dbc::SignalMissing;
use plan::{Plan, each_once};
use recording::frames::Frames;
use recording::latency::{Host, NodeReport, Quantiles, latencies};
use recording::stalls::Stall;
use scenario::timing::TimingLimits;
use serde::{Deserialize, Serialize};

use crate::attribution::stalls::Spans;
use crate::metric::Metric;

const NO_LOOP: &str = "not available: all nodes are external";
/// Largest step of the wall clock with which the stamps are still of use.
const CLOCK_STEP_MAX: Duration = Duration::from_millis(1);
/// Largest percentage of a run in stalls; beyond it, 99.9 % of the cycles no longer show the quality of the software.
const STALLS_PERCENT_MAX: f64 = 0.1;

/// Timing of a run, as `verdict.json` holds it. A verdict in virtual time has none.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct Timing {
    /// Report of the controller's loop; `None` if the controller is external.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller: Option<NodeReport>,
    /// Report of the emulator's loop, or of several loops together; `None` if the drive is external.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plant_emulator: Option<NodeReport>,
    /// Time from the SYNC to the drive's position.
    pub sync_to_position_microseconds: Quantiles,
    /// Time from the drive's position to the command that follows from it.
    pub position_to_command_microseconds: Quantiles,
    /// Time from the SYNC to the command.
    pub round_trip_microseconds: Quantiles,
    /// Names of the nodes that canrig did not start, on a bus of this machine: they stand still
    /// with it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub on_this_machine: Vec<String>,
    /// Reasons why these numbers are no measure of the software; empty if they are.
    pub distrust: Vec<String>,
}

impl Timing {
    /// Returns the timing of a run from its recording and the host's observations. For several loops each quantile is that of the
    /// worst.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub fn new(frames: &Frames, plan: &Plan, host: Host) -> Result<Self, SignalMissing> {
        let of_host = Self {
            distrust: distrust(&host, plan.duration()),
            controller: host.controller,
            plant_emulator: host.plant_emulator,
            on_this_machine: host.on_this_machine,
            ..Self::default()
        };
        of_host.again(frames, plan)
    }

    /// Returns the timing of the same run, read from its recording again. The host's observations are kept.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub fn again(self, frames: &Frames, plan: &Plan) -> Result<Self, SignalMissing> {
        let mut worst = [Quantiles::default(); 3];
        for one in &plan.loops {
            let quantiles =
                latencies(frames.iter(), plan, one)?.map(|histogram| Quantiles::new(&histogram, 1));
            let each = worst.iter_mut().zip(quantiles);
            each.for_each(|(worst, quantiles)| *worst = worst.worst(quantiles));
        }
        let [sync_to_position, position_to_command, round_trip] = worst;
        Ok(Self {
            sync_to_position_microseconds: sync_to_position,
            position_to_command_microseconds: position_to_command,
            round_trip_microseconds: round_trip,
            ..self
        })
    }

    /// Returns the reports of the loops that canrig ran, with their names.
    fn loops(&self) -> impl Iterator<Item = (&'static str, &NodeReport)> {
        let loops = [
            ("controller", &self.controller),
            ("plant emulator", &self.plant_emulator),
        ];
        loops
            .into_iter()
            .filter_map(|(name, report)| Some((name, report.as_ref()?)))
    }

    /// Returns the value for the limit at a path below `[expect.timing]`; `None` if all nodes are external.
    fn value(&self, path: &str) -> Option<f64> {
        let (latency, quantile) = path.split_once('.').unwrap_or((path, ""));
        let reports = self.loops().map(|(_, report)| report);
        let quantiles = match latency {
            "frames_delayed" => {
                let delayed = reports.map(|report| report.frames_delayed);
                return delayed.reduce(u64::add).map(|frames| frames as f64);
            }
            "wake_up_lateness_microseconds" => {
                let lateness = reports.map(|report| report.wake_up_lateness_microseconds);
                lateness.reduce(Quantiles::worst)?
            }
            "sync_to_position_microseconds" => self.sync_to_position_microseconds,
            "position_to_command_microseconds" => self.position_to_command_microseconds,
            "round_trip_microseconds" => self.round_trip_microseconds,
            _ => return None,
        };
        quantiles.named(quantile)
    }

    /// Returns the distributions with their names.
    pub fn rows(&self) -> Vec<(String, Quantiles)> {
        let lateness = self.loops().map(|(name, report)| {
            let quantiles = report.wake_up_lateness_microseconds;
            (format!("wake-up lateness, {name}"), quantiles)
        });
        let latencies = [
            ("SYNC to position", self.sync_to_position_microseconds),
            ("position to command", self.position_to_command_microseconds),
            ("round trip", self.round_trip_microseconds),
        ]
        .map(|(name, quantiles)| (name.to_owned(), quantiles));
        lateness.chain(latencies).collect()
    }

    /// Describes the losses of each loop.
    pub fn losses(&self) -> String {
        let losses = self.loops().map(|(name, report)| {
            let (overruns, dropped) = (report.overruns, report.frames_dropped);
            let mut text = format!("{name}: {overruns} overruns, {dropped} frames dropped");
            if report.frames_delayed > 0 {
                let frames = report.frames_delayed;
                text += &format!(", {frames} frames delayed by a full queue of the bus");
            }
            if report.late_answers > 0 {
                let cycles = report.late_answers;
                text += &format!(", no answer of a law in time in {cycles} cycles");
            }
            text
        });
        losses.collect::<Vec<_>>().join("; ")
    }

    /// Checks the values against the limits that are given. External nodes report no value.
    pub fn metrics(&self, limits: &TimingLimits) -> Vec<Metric> {
        let named = limits.rows().zip(limits.limits());
        let metrics = named.map(|(row, (path, limit))| match self.value(&path) {
            Some(value) => Metric::new(row, Ok(value), Some(limit)),
            None => Metric::not_judged(row, NO_LOOP.to_owned(), Some(limit)),
        });
        metrics.collect()
    }
}

/// Returns the reasons why the timing of a run of this duration is not trusted.
fn distrust(host: &Host, duration: Duration) -> Vec<String> {
    let reports = [&host.controller, &host.plant_emulator];
    let refused = reports.into_iter().flatten().flat_map(|one| &one.refused);
    let mut reasons = each_once(refused.cloned());
    if host.wall_clock_step > CLOCK_STEP_MAX {
        let milliseconds = 1e3 * host.wall_clock_step.as_secs_f64();
        let step = format!("the wall clock was stepped by {milliseconds:.1} ms during the run");
        reasons.push(step);
    }
    reasons.extend(held_up(&host.stalls, duration));
    reasons
}

/// Returns the reason to distrust a run in which the nodes were held up for too long.
fn held_up(stalls: &[Stall], duration: Duration) -> Option<String> {
    let percent = distrusted_percent(stalls, duration)?;
    let longest = stalls.iter().max_by_key(|stall| stall.length())?;
    Some(format!(
        "stalls cover {percent:.2} % of the run (limit {STALLS_PERCENT_MAX} %); in the longest {longest}"
    ))
}

/// Returns the percentage of a run that stalls cover, if it is too large to trust its timing.
pub(crate) fn distrusted_percent(stalls: &[Stall], duration: Duration) -> Option<f64> {
    // Seconds since 1970 in an `f64` would lose the microseconds.
    let first = stalls.iter().map(|stall| stall.from).min()?;
    let seconds = |time: Duration| time.saturating_sub(first).as_secs_f64();
    let span = |stall: &Stall| (seconds(stall.from), seconds(stall.until));
    let spans = Spans::of(stalls.iter().map(span).collect());
    let covered = spans.seconds_in(f64::NEG_INFINITY, f64::INFINITY);
    let percent = 100.0 * covered / duration.as_secs_f64();
    (percent > STALLS_PERCENT_MAX).then_some(percent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::expect::Limit;
    use scenario::timing::QuantileLimits;
    use std::collections::BTreeSet;

    use recording::stalls::{What, Who};

    use serde_json::{Value, json};

    #[test]
    fn a_stepped_clock_a_refusal_and_stalls_are_distrusted() {
        let milliseconds = Duration::from_millis;
        let stall = |from, until| {
            let (from, until) = (milliseconds(from), milliseconds(until));
            Stall::new(from, until, Who::Machine, What::StoodStill)
        };
        let run = Duration::from_secs(10);
        // Two stalls that overlap cover 10 ms.
        let mut host = Host {
            stalls: vec![stall(100, 108), stall(103, 110)],
            ..Host::default()
        };
        assert_eq!(distrust(&host, run), Vec::<String>::new());
        host.wall_clock_step = Duration::from_millis(30);
        host.stalls.push(stall(200, 245));
        let refused = NodeReport {
            refused: vec!["no priority".to_owned()],
            ..NodeReport::default()
        };
        (host.controller, host.plant_emulator) = (Some(refused.clone()), Some(refused));
        let expected = [
            "no priority",
            "the wall clock was stepped by 30.0 ms during the run",
            "stalls cover 0.55 % of the run (limit 0.1 %); in the longest the machine stood still for 45.0 ms",
        ];
        assert_eq!(distrust(&host, run), expected);
    }

    /// Returns the timing of a run of external nodes.
    fn timing() -> Timing {
        Timing {
            controller: None,
            plant_emulator: None,
            sync_to_position_microseconds: Quantiles::default(),
            position_to_command_microseconds: Quantiles::default(),
            round_trip_microseconds: Quantiles::default(),
            on_this_machine: Vec::new(),
            distrust: Vec::new(),
        }
    }

    /// The limits of each key in the schema's `[expect.timing]` become metrics with the names of the key in `requirements`.
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
            let quantile_limits = quantiles.iter().map(|name| (name.clone(), limit.clone()));
            expected.extend(quantiles.iter().map(|name| format!("{key}_{name}")));
            limits.insert(
                key,
                quantile_limits.collect::<serde_json::Map<_, _>>().into(),
            );
        }
        assert_eq!(expected.len(), 4 * 4 + 1);
        let limits: TimingLimits = serde_json::from_value(limits.into()).unwrap();
        let metrics = timing().metrics(&limits);
        let names: Vec<&str> = metrics.iter().map(|metric| metric.name.as_str()).collect();
        assert_eq!(BTreeSet::from_iter(limits.rows()), expected);
        assert!(limits.rows().eq(names), "in the same order");
        let played = |value| Quantiles {
            median: value,
            p99: value,
            p99_9: value,
            max: value,
        };
        let values = [1.0, 2.0, 3.0, 4.0].map(|value| [value; 4]).concat();
        let timing = Timing {
            controller: Some(NodeReport {
                wake_up_lateness_microseconds: played(1.0),
                frames_delayed: 5,
                ..NodeReport::default()
            }),
            sync_to_position_microseconds: played(2.0),
            position_to_command_microseconds: played(3.0),
            round_trip_microseconds: played(4.0),
            ..timing()
        };
        let judged = timing.metrics(&limits);
        let found = Vec::from_iter(judged.iter().map(|metric| metric.value.unwrap()));
        assert_eq!(found, [values, vec![5.0]].concat());
    }

    /// Each quantile has a limit of its own.
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
        let timing = Timing {
            round_trip_microseconds: quantiles,
            ..timing()
        };
        let limits = TimingLimits {
            round_trip_microseconds: limits,
            ..TimingLimits::default()
        };
        let rows = timing
            .metrics(&limits)
            .into_iter()
            .map(|metric| (metric.name, metric.value.unwrap(), metric.passed.unwrap()));
        let expected = [
            ("round_trip_microseconds_median", 1.0, true),
            ("round_trip_microseconds_p99_9", 3.0, false),
            ("round_trip_microseconds_max", 4.0, false),
        ]
        .map(|(name, value, passed)| (name.to_owned(), value, passed));
        assert_eq!(rows.collect::<Vec<_>>(), expected);
    }
}
