//! A scenario file as a whole.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bus::Bus;
use crate::controller::Controller;
use crate::disturbance::Disturbance;
use crate::expect::Expect;
use crate::fault::{Fault, Faults};
use crate::plant::Plant;
use crate::reference::Reference;
use crate::sweep::Sweep;
use crate::wiring::Wiring;

/// One scenario file.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Version of the format; 1.
    #[schemars(range(min = 1, max = 1))]
    pub schema: u32,
    /// What the scenario tries, in a few words.
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
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    pub duration_seconds: f64,
    /// Bit rate and cycle of the bus.
    #[serde(default)]
    pub bus: Bus,
    /// The control law: one table, such as `[controller.pid]`.
    #[schemars(extend("minProperties" = 1, "maxProperties" = 1))]
    pub controller: Controller,
    /// The position set-point; may be absent with `open_loop` only.
    #[serde(default)]
    pub reference: Reference,
    /// What disturbs the plant.
    #[serde(default)]
    pub disturbance: Disturbance,
    /// The faults of the whole run, read by the loader; the nodes do not know of them.
    #[serde(
        rename = "fault",
        skip_deserializing,
        skip_serializing_if = "Faults::is_empty"
    )]
    #[schemars(skip)]
    pub faults: Faults,
    /// The emulated plant; the controller never sees its parameters.
    #[serde(default)]
    pub plant: Plant,
    /// Limits: what a run must keep to pass.
    #[serde(default)]
    pub expect: Expect,
    /// What `canrig sweep` varies, to make many scenarios of this one; all other commands ignore it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweep: Option<Sweep>,
    /// How its drive is wired, put in by the loader.
    #[serde(skip)]
    pub wiring: Wiring,
}

impl Scenario {
    /// The faults of its loop: those at its drive and plant, and those at no other drive.
    pub fn own_faults(&self) -> impl Iterator<Item = &Fault> {
        let Wiring { nodes, plant, .. } = &self.wiring;
        let is_own = |fault: &&Fault| fault.is_of_loop(nodes.drive.id, plant);
        self.faults.iter().filter(is_own)
    }

    /// The faults at its drive, and at the plant that the drive moves.
    #[must_use]
    pub fn drive_faults(&self) -> Faults {
        let Wiring { nodes, plant, .. } = &self.wiring;
        self.faults.at_drive(nodes.drive.id, plant)
    }

    /// Whether one of the faults of the run is of its loop.
    #[must_use]
    pub fn has_own_faults(&self) -> bool {
        self.own_faults().next().is_some()
    }
}
