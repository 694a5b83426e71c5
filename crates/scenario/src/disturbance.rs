//! The `[disturbance]` table: what disturbs the plant.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What disturbs the plant; each is commanded over the bus to the disturbance node 0x11.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Disturbance {
    /// A fan blows at the wire.
    #[schemars(length(max = 10_000))]
    pub fan: Vec<Fan>,
    /// Another load hangs on the pulley.
    #[schemars(length(max = 10_000))]
    pub load: Vec<Load>,
}

/// A fan blows at the wire.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Fan {
    /// On.
    #[schemars(range(min = 0.0, max = 86_400.0))]
    pub from_seconds: f64,
    /// Off.
    #[schemars(range(min = 0.0, max = 86_400.0))]
    pub until_seconds: f64,
    /// Multiplies the convection coefficient while on, 1 to 30.
    #[schemars(range(min = 1.0, max = 30.0))]
    pub convection_factor: f64,
}

/// The load changes and stays so.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// When.
    #[schemars(range(min = 0.0, max = 86_400.0))]
    pub at_seconds: f64,
    /// Added to the plant's load; may be negative.
    #[schemars(range(min = -1_000.0, max = 1_000.0))]
    pub added_grams: f64,
}
