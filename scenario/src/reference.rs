//! The `[reference]` table: the raw position set-point over scenario time.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The position set-point, in pieces ordered by time.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Reference {
    /// A position to hold; no event for the metrics.
    pub hold: Vec<Hold>,
    /// A jump that the metrics judge.
    pub step: Vec<Step>,
    /// A linear move from the present value.
    pub ramp: Vec<Ramp>,
    /// A harmonic.
    pub sine: Vec<Sine>,
    /// A table from a CSV file.
    pub table: Vec<Table>,
}

/// A position to hold.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Hold {
    /// From when.
    pub at_seconds: f64,
    /// Which position.
    pub position_millimetres: f64,
}

/// A jump.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// When.
    pub at_seconds: f64,
    /// To which position.
    pub position_millimetres: f64,
}

/// A linear move from the present value; the end value holds.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    /// Start.
    pub from_seconds: f64,
    /// End.
    pub until_seconds: f64,
    /// Position at the end.
    pub position_millimetres: f64,
}

/// A harmonic `centre + amplitude sin(2π (t − from) / period)`.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Sine {
    /// Start.
    pub from_seconds: f64,
    /// Centre.
    pub centre_millimetres: f64,
    /// Amplitude.
    pub amplitude_millimetres: f64,
    /// Period.
    pub period_seconds: f64,
}

/// Straight lines through the rows of a CSV file with the columns `time_seconds,position_millimetres`.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Start; the file's times count from here.
    pub from_seconds: f64,
    /// The file, relative to the scenario.
    pub file: String,
    /// The rows, `(time_seconds, position_millimetres)`, put in by the loader.
    #[serde(skip)]
    pub rows: Vec<(f64, f64)>,
}

/// The set-point and its derivatives at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetPoint {
    /// Position.
    pub position_metres: f64,
    /// First derivative.
    pub velocity_metres_per_second: f64,
    /// Second derivative.
    pub acceleration_metres_per_second_squared: f64,
    /// Third derivative.
    pub jerk_metres_per_second_cubed: f64,
    /// True where the derivatives are exact (sine): such a set-point bypasses the reference filter (PAPER E5).
    pub has_exact_derivatives: bool,
}
