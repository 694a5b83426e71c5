//! Scenario files: what to try and what passes.
//!
//! [`Scenario`] is everything; the controller gets a [`ControllerView`] that cannot see `[plant]`.

mod check;
pub mod controller;
mod curve;
pub mod disturbance;
mod document;
mod error;
pub mod events;
pub mod expect;
pub mod fault;
mod load;
mod nearest;
pub mod own;
pub mod plant;
pub mod profile;
pub mod reference;
pub mod rig;
pub mod schema;
mod structure;
pub mod sweep;
mod table;
#[cfg(test)]
mod tests;
pub mod timing;
mod view;

use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use error::{Problem, ScenarioError};
pub use load::{Objection, read_text};
pub use nearest::nearest;
pub use view::ControllerView;

/// One scenario file.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Version of the format; 1.
    #[schemars(range(min = 1, max = 1))]
    pub schema: u32,
    /// What is tried, in a few words.
    #[schemars(length(min = 1, max = 200))]
    pub name: String,
    /// What the scenario shows and where its limits come from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub description: Option<String>,
    /// The requirements that the scenario as a whole tests, such as "REQ-12".
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 100), inner(length(min = 1, max = 100)))]
    pub requirements: Vec<String>,
    /// Seed of every random number in the run.
    #[serde(default)]
    #[schemars(range(min = 0, max = 9_007_199_254_740_991_u64))]
    pub seed: u64,
    /// Length of the run from the first SYNC after Operation Enabled.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 86_400.0))]
    pub duration_seconds: f64,
    /// The bus.
    #[serde(default)]
    pub bus: Bus,
    /// The control law; exactly one table.
    #[schemars(extend("minProperties" = 1, "maxProperties" = 1))]
    pub controller: controller::Controller,
    /// The position set-point; may be absent with `open_loop` only.
    #[serde(default)]
    pub reference: reference::Reference,
    /// What disturbs the plant.
    #[serde(default)]
    pub disturbance: disturbance::Disturbance,
    /// What goes wrong on purpose; no node sees it, each only suffers it.
    #[serde(default, skip_serializing_if = "fault::Faults::is_empty")]
    pub fault: fault::Faults,
    /// The emulated plant; the controller never sees it.
    #[serde(default)]
    pub plant: plant::Plant,
    /// What passes.
    #[serde(default)]
    pub expect: expect::Expect,
    /// What `canrig sweep` varies, to make many scenarios of this one; all other commands play it as it stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweep: Option<sweep::Sweep>,
}

/// The bus and its cycle.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Bit rate of the bus.
    #[schemars(extend("enum" = [10, 20, 50, 125, 250, 500, 800, 1000]))]
    pub bitrate_kilobits_per_second: u32,
    /// Time between two SYNCs, a multiple of 0.1 ms.
    #[schemars(range(min = 0.1, max = 100.0), extend("multipleOf" = 0.1))]
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

impl Bus {
    /// The time between two SYNCs.
    #[must_use]
    pub fn sync_period(&self) -> Duration {
        // The schema admits multiples of 0.1 ms; rounding takes the decimal fraction's error away.
        let tenths = libm::round(self.sync_period_milliseconds * 10.0).clamp(1.0, 1000.0);
        Duration::from_micros(100).mul_f64(tenths)
    }
}

/// What is 0 by default is left out when written.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
pub(crate) fn is_zero(value: &f64) -> bool {
    *value == 0.0
}
