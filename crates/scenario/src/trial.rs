//! What is tried in one loop, on which drive and plant.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::Deserialize;

use crate::controller::Controller;
use crate::disturbance::Disturbance;
use crate::expect::Expect;
use crate::fault::{Fault, Faults};
use crate::plant::{Amplifier, PlantModel, Sensor};
use crate::reference::Reference;
use crate::run::Run;
use crate::wiring::Wiring;

/// One loop of a run: what its law does, what disturbs it, and what is expected of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// The facts of the whole run.
    pub run: Arc<Run>,
    /// The control law.
    pub controller: Controller,
    /// The set-point.
    pub reference: Reference,
    /// What disturbs the plant.
    pub disturbance: Disturbance,
    /// Limits: what a run must keep to pass.
    pub expect: Expect,
    /// The plant that its drive moves; the controller never sees its parameters.
    pub plant: PlantModel,
    /// The sensor of its drive.
    pub sensor: Sensor,
    /// The amplifier of its drive.
    pub amplifier: Amplifier,
    /// How its drive is wired.
    pub wiring: Wiring,
}

/// The tables of a scenario that are of one loop.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Sections {
    /// The control law: one table, such as `[controller.pid]`.
    #[schemars(extend("minProperties" = 1, "maxProperties" = 1))]
    pub(crate) controller: Controller,
    /// The position set-point; may be absent with `open_loop` only.
    #[serde(default)]
    pub(crate) reference: Reference,
    /// What disturbs the plant.
    #[serde(default)]
    pub(crate) disturbance: Disturbance,
    /// Limits: what a run must keep to pass.
    #[serde(default)]
    pub(crate) expect: Expect,
}

impl Trial {
    /// The facts of the run, to be changed for this loop alone.
    pub fn run_mut(&mut self) -> &mut Run {
        Arc::make_mut(&mut self.run)
    }

    /// The faults of its loop: those at its drive and plant, and those at no other drive.
    pub fn own_faults(&self) -> impl Iterator<Item = &Fault> {
        let Wiring { nodes, plant, .. } = &self.wiring;
        let is_own = |fault: &&Fault| fault.is_of_loop(nodes.drive.id, plant);
        self.run.faults.iter().filter(is_own)
    }

    /// The faults at its drive, and at the plant that the drive moves.
    #[must_use]
    pub fn drive_faults(&self) -> Faults {
        let Wiring { nodes, plant, .. } = &self.wiring;
        self.run.faults.at_drive(nodes.drive.id, plant)
    }

    /// Whether one of the faults of the run is of its loop.
    #[must_use]
    pub fn has_own_faults(&self) -> bool {
        self.own_faults().next().is_some()
    }
}
