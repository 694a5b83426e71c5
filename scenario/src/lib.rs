//! Scenario files: what to try and what passes.
//!
//! [`Scenario`] is everything; the controller gets a view that cannot see `[plant]`.

pub mod controller;
pub mod disturbance;
pub mod expect;
pub mod plant;
pub mod reference;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One scenario file.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Version of the format; 1.
    pub schema: u32,
    /// What is tried, in a few words.
    pub name: String,
    /// What the scenario shows and where its limits come from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub description: Option<String>,
    /// Seed of every random number in the run.
    #[serde(default)]
    pub seed: u64,
    /// Length of the run from the first SYNC after Operation Enabled.
    pub duration_seconds: f64,
    /// The bus.
    #[serde(default)]
    pub bus: Bus,
    /// The control law; exactly one table.
    pub controller: controller::Controller,
    /// The position set-point; may be absent with `open_loop` only.
    #[serde(default)]
    pub reference: reference::Reference,
    /// What disturbs the plant.
    #[serde(default)]
    pub disturbance: disturbance::Disturbance,
    /// The emulated plant; the controller never sees it.
    #[serde(default)]
    pub plant: plant::Plant,
    /// What passes.
    #[serde(default)]
    pub expect: expect::Expect,
}

/// The bus and its cycle.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Bit rate of the bus.
    pub bitrate_kilobits_per_second: u32,
    /// Time between two SYNCs, a multiple of 0.1 ms.
    pub sync_period_milliseconds: f64,
}

impl Default for Bus {
    fn default() -> Self {
        Self {
            bitrate_kilobits_per_second: 1000,
            sync_period_milliseconds: 1.0,
        }
    }
}
