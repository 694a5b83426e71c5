//! The `[expect]` table: what passes. Every key is optional, every limit two-sided.

mod sequence;
mod signal;

use std::collections::BTreeMap;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use crate::limit::Limit;
use crate::timing::TimingLimits;

pub use sequence::{Expected, Sequence};
pub use signal::{Course, Demand, SignalCheck};

/// Requirements by their names in whatever lists them, such as "REQ-12".
pub type Requirements = Vec<String>;

/// Limits on the metrics of a run.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Expect {
    /// Time from a step to the first sample from which on the position stays within ± 5 % of the step's height.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settling_time_seconds: Option<Limit>,
    /// How far the position goes beyond the final set-point, in percent of the step's height.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overshoot_percent: Option<Limit>,
    /// Mean absolute error over the last 0.5 s of the scenario, in which the set-point must not move.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steady_state_error_millimetres: Option<Limit>,
    /// RMS of set-point minus position: over the last three periods of a sine, else over the whole run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracking_error_millimetres_rms: Option<Limit>,
    /// Amplitude of the position divided by that of the set-point, at the frequency of a sine, over its last three periods.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sine_gain: Option<Limit>,
    /// Phase of the position minus that of the set-point, from -270 to 90, measured as `sine_gain`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sine_phase_degrees: Option<Limit>,
    /// Mean of the position minus that of the set-point, measured as `sine_gain`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sine_offset_millimetres: Option<Limit>,
    /// Last frequency of a chirp before the gain first falls below 0.708.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bandwidth_hertz: Option<Limit>,
    /// Largest deviation from the set-point from the start of a disturbance to 3 s after its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maximum_deviation_millimetres: Option<Limit>,
    /// What counts as recovered: a deviation from the set-point within this, for `recovery_time_seconds`,
    /// `recovers_within_seconds` and `current_ripple_amperes_rms`. If absent 0.25 mm; in a loop of another unit 1/240 of the sensor's
    /// range, which 0.25 mm are of 60 mm.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery_band_millimetres: Option<f64>,
    /// Time from the start of a disturbance until the deviation stays within the recovery band.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery_time_seconds: Option<Limit>,
    /// RMS of the current over the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_amperes_rms: Option<Limit>,
    /// Standard deviation of the commanded current in the last hold, from 1 s after the position has come to stay within the recovery
    /// band,
    /// for 2 s at least.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_ripple_amperes_rms: Option<Limit>,
    /// Highest minus lowest mean position of 10 ms in the last second, in which the set-point must not move. Above 0.25 mm the loop
    /// hunts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hunting_millimetres: Option<Limit>,
    /// Largest position over the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_millimetres_max: Option<Limit>,
    /// Share of the cycles in which the drive sent no position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missed_cycles_percent: Option<Limit>,
    /// Share of the cycles with a position for which the controller sent no command before the next position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missed_commands_percent: Option<Limit>,
    /// Share of the time from the first SYNC on in which frames occupy the bus, computed from their bits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bus_load_percent: Option<Limit>,
    /// Longest time between two SYNCs: more than the period when the bus or the machine was late.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sync_interval_milliseconds_max: Option<Limit>,
    /// Highest temperature of what the current heats, wire or winding. Only the emulator knows it; a real drive does not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_celsius: Option<Limit>,
    /// Longest time from the start of the first fault until no current flows through the plant for 0.1 s at least.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e6))]
    pub current_zero_within_milliseconds: Option<f64>,
    /// Longest time from the end of the last fault until the deviation from the set-point stays within the recovery
    /// band.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub recovers_within_seconds: Option<f64>,
    /// `true`: at the end no current flows, and the drive is disabled or silent. `false`: a current flows, or the drive is enabled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub safe_state: Option<bool>,
    /// Emergencies that must be sent, each as node and code: "drive 0x8130".
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub emcy: Vec<String>,
    /// Texts that no event of the run may contain, such as "emergency".
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub no_event: Vec<String>,
    /// The requirements that single limits test, by the limit's key, `overshoot_percent = ["REQ-12"]`; for those of
    /// `[expect.timing]` by key and quantile, `round_trip_microseconds_p99 = ["REQ-13"]`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub requirements: BTreeMap<String, Requirements>,
    /// The metrics of position, current and traffic are judged on what comes before this; later the loop is meant to be open,
    /// because a node dies on purpose. Reactions to faults, signals and sequences are judged to the end of the scenario.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    pub judged_until_seconds: Option<f64>,
    /// Demands on signals, each in its window of time.
    #[schemars(length(max = 1000))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub signal: Vec<SignalCheck>,
    /// Lists of events that must come one after the other.
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sequence: Vec<Sequence>,
    /// Limits on latencies in real time; virtual time ignores them.
    #[serde(skip_serializing_if = "TimingLimits::is_empty")]
    pub timing: TimingLimits,
}

impl Expect {
    /// The rows of the verdict that test requirements, each with these.
    #[must_use]
    pub fn requirements_of_rows(&self) -> BTreeMap<String, Requirements> {
        let limits = self.requirements.clone();
        let checks = self.signal.iter().flat_map(|check| {
            let rows = check.demands().map(|demand| check.row_name(&demand));
            rows.map(|row| (row, check.requirements.clone()))
        });
        let sequences = self.sequence.iter().flat_map(|sequence| {
            let rows = (0..sequence.event.len()).map(|place| sequence.row_name(place));
            rows.map(|row| (row, sequence.requirements.clone()))
        });
        let rows = limits.into_iter().chain(checks).chain(sequences);
        rows.filter(|(_, requirements)| !requirements.is_empty())
            .collect()
    }

    /// The signals that checks and sequences name, each with the path of its name in the file.
    pub fn named_signals(&self) -> impl Iterator<Item = (String, &str)> {
        let checks = self
            .signal
            .iter()
            .enumerate()
            .map(|(index, check)| (format!("expect.signal.{index}.name"), check.name.as_str()));
        let events = self
            .sequence
            .iter()
            .enumerate()
            .flat_map(|(index, sequence)| {
                let events = sequence.event.iter().enumerate();
                events.filter_map(move |(place, event)| {
                    let path = format!("expect.sequence.{index}.event.{place}.signal");
                    Some((path, event.signal.as_deref()?))
                })
            });
        checks.chain(events)
    }
}

/// An emergency of a node, written as "drive 0x8130".
#[derive(Clone, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub struct Emergency {
    /// The node's name in the DBC.
    pub node: String,
    /// The error code (CiA 301, table 26).
    pub code: u16,
}

impl FromStr for Emergency {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (node, code) = text
            .split_once(" 0x")
            .ok_or("must be node and code, as in \"drive 0x8130\"")?;
        if !["controller", "drive", "disturbance"].contains(&node) {
            return Err("the node must be controller, drive or disturbance");
        }
        let code = u16::from_str_radix(code, 16)
            .map_err(|_| "the code must have four hexadecimal digits")?;
        Ok(Self {
            node: node.to_owned(),
            code,
        })
    }
}
