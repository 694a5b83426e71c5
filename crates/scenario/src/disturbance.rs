//! The `[disturbance]` table: disturbances of the plant.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Disturbances of the plant; each is commanded over the bus to an io node.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Disturbance {
    /// A fan blows at the plant and multiplies its cooling by air.
    #[schemars(length(max = 10_000))]
    pub fan: Vec<Fan>,
    /// The load changes, and stays so.
    #[schemars(length(max = 10_000))]
    pub load: Vec<Load>,
    /// Another output of an io node changes: one that the rig file names in its `outputs`.
    #[schemars(length(max = 10_000))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub output: Vec<Output>,
}

/// An output of an io node changes.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "DisturbanceOutput")]
pub struct Output {
    /// The io node; needed where several have this output, or the rig has several loops.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub node: String,
    /// Its name among the `outputs` of the io node.
    #[schemars(length(min = 1, max = 64))]
    pub name: String,
    /// Time of the change.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// Time at which the output returns to its value at rest; it stays if absent.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: Option<f64>,
    /// Its value, in the unit at the end of its name, within the range of the plant's port.
    pub value: f64,
}

/// A fan blows at the wire.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Fan {
    /// The io node; needed where several have this output, or the rig has several loops.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub node: String,
    /// Time at which the fan starts.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// Time at which the fan stops.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: f64,
    /// Factor on the cooling by air while the fan is on.
    #[schemars(range(min = 1.0, max = 30.0))]
    pub convection_factor: f64,
}

/// The load changes and stays so.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// The io node; needed where several have this output, or the rig has several loops.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub node: String,
    /// Time of the change.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// Added to the plant's load; may be negative.
    #[schemars(range(min = -1_000.0, max = 1_000.0))]
    pub added_grams: f64,
}
