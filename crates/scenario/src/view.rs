//! What the controller may know of a scenario.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::bus::Bus;
use crate::scenario::Scenario;
use crate::wiring::Wiring;
use crate::{controller, reference};

/// A scenario without the plant's parameters, its disturbances and faults, and its limits: a controller cannot use what it cannot see.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct ControllerView {
    /// Version of the format; 1.
    #[schemars(range(min = 1, max = 1))]
    pub schema: u32,
    /// What is tried, in a few words.
    #[schemars(length(min = 1, max = 200))]
    pub name: String,
    /// Length of the run from the first SYNC after Operation Enabled.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    pub duration_seconds: f64,
    /// The bus.
    #[serde(default)]
    pub bus: Bus,
    /// The control law; exactly one table.
    pub controller: controller::Controller,
    /// The position set-point.
    #[serde(default)]
    pub reference: reference::Reference,
    /// How the drive is wired, put in by the loader.
    #[serde(skip)]
    pub wiring: Wiring,
}

/// The keys that the controller's loader takes out of the document before it looks at anything.
pub(crate) const HIDDEN_FROM_CONTROLLER: [&str; 8] = [
    "description",
    "requirements",
    "seed",
    "disturbance",
    "fault",
    "plant",
    "expect",
    "sweep",
];

impl Scenario {
    /// What the controller may know of this scenario.
    #[must_use]
    pub fn controller_view(&self) -> ControllerView {
        ControllerView {
            schema: self.schema,
            name: self.name.clone(),
            duration_seconds: self.duration_seconds,
            bus: self.bus.clone(),
            controller: self.controller.clone(),
            reference: self.reference.clone(),
            wiring: self.wiring.clone(),
        }
    }
}
