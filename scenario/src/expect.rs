//! The `[expect]` table: what passes. Every key is optional, every limit two-sided.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A two-sided limit; at least one side is given.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
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
}
