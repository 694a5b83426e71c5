//! The `[expect]` table: what passes. Every key is optional, every limit two-sided.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::timing::TimingLimits;

/// A two-sided limit; at least one side is given.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
#[schemars(extend("minProperties" = 1))]
pub struct Limit {
    /// Smallest value that passes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Largest value that passes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

/// Limits on the metrics of a run.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Expect {
    /// First sample of the uninterrupted stay within ± 5 % of the step's height, less the time of the step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settling_time_seconds: Option<Limit>,
    /// How far the position goes beyond the final set-point, by the step's height.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overshoot_percent: Option<Limit>,
    /// Mean absolute error over the last 0.5 s of the last hold.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steady_state_error_millimetres: Option<Limit>,
    /// RMS of set-point less position: over the last three periods of a sine, else over the whole run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracking_error_millimetres_rms: Option<Limit>,
    /// Largest deviation from the set-point from the start of a disturbance to 3 s after its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maximum_deviation_millimetres: Option<Limit>,
    /// From the start of a disturbance until the deviation stays within 0.25 mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery_time_seconds: Option<Limit>,
    /// RMS of the current over the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_amperes_rms: Option<Limit>,
    /// Largest position over the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_millimetres_max: Option<Limit>,
    /// Cycles without a position from the drive, by all cycles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missed_cycles_percent: Option<Limit>,
    /// Time in which frames occupy the bus, computed from their bits, by all time from the first SYNC on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bus_load_percent: Option<Limit>,
    /// Longest time between two SYNCs: more than the period when the bus or the machine was late.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sync_interval_milliseconds_max: Option<Limit>,
    /// Limits on real time. Scenarios that have them are kept apart from the others.
    #[serde(skip_serializing_if = "TimingLimits::is_empty")]
    pub timing: TimingLimits,
}

impl Limit {
    /// True when the value is within both sides.
    #[must_use]
    pub fn admits(&self, value: f64) -> bool {
        self.min.is_none_or(|min| value >= min) && self.max.is_none_or(|max| value <= max)
    }
}

impl Expect {
    /// The limits that are given, each with the name of its metric, in the order of the format.
    pub fn limits(&self) -> impl Iterator<Item = (&'static str, Limit)> + use<> {
        let limits = [
            ("settling_time_seconds", self.settling_time_seconds),
            ("overshoot_percent", self.overshoot_percent),
            (
                "steady_state_error_millimetres",
                self.steady_state_error_millimetres,
            ),
            (
                "tracking_error_millimetres_rms",
                self.tracking_error_millimetres_rms,
            ),
            (
                "maximum_deviation_millimetres",
                self.maximum_deviation_millimetres,
            ),
            ("recovery_time_seconds", self.recovery_time_seconds),
            ("current_amperes_rms", self.current_amperes_rms),
            ("position_millimetres_max", self.position_millimetres_max),
            ("missed_cycles_percent", self.missed_cycles_percent),
            ("bus_load_percent", self.bus_load_percent),
            (
                "sync_interval_milliseconds_max",
                self.sync_interval_milliseconds_max,
            ),
        ];
        let given = |(name, limit): (_, Option<Limit>)| limit.map(|limit| (name, limit));
        limits.into_iter().filter_map(given)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_lists_every_key_of_the_table() {
        let limit = Limit {
            min: Some(0.0),
            max: Some(1.0),
        };
        let schema = crate::schema::schema_of::<Expect>();
        let names = schema["properties"].as_object().unwrap().keys();
        let names: Vec<&String> = names.filter(|name| *name != "timing").collect();
        let text: String = names
            .iter()
            .map(|name| format!("{name} = {{ min = 0.0, max = 1.0 }}\n"))
            .collect();
        let expect: Expect = toml::from_str(&text).unwrap();
        let mut listed: Vec<&str> = expect.limits().map(|(name, _)| name).collect();
        listed.sort_unstable();
        assert_eq!(listed, names);
        assert!(expect.limits().all(|(_, given)| given == limit));
    }

    #[test]
    fn a_limit_admits_its_ends_and_never_nan() {
        let limit = Limit {
            min: Some(1.0),
            max: Some(2.0),
        };
        assert!(limit.admits(1.0) && limit.admits(2.0));
        assert!(!limit.admits(0.999) && !limit.admits(2.001) && !limit.admits(f64::NAN));
    }
}
