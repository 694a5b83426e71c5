//! The trial of one loop, on its drive and plant.

use std::collections::BTreeMap;
use std::sync::Arc;

use canopen::object_dictionary::Preset;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::controller::Controller;
use crate::expect::Expect;
use crate::fault::{Fault, Faults, Group};
use crate::identifiers::Identifiers;
use crate::node::NodeIndex;
use crate::plant::PlantModel;
use crate::reference::Reference;
use crate::rig::nodes::{Amplifier, Sensor};
use crate::run::Run;
use crate::wiring::{LoopFacts, Wiring};

/// Second SDO channel of an emulated drive.
const SECOND_SDO: u16 = 0x1201;

/// Trial of one loop of a run: the tables of the scenario for it, and its drive and plant, put in by the loader.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// The control law: one table, such as `[controller.pid]`.
    #[schemars(extend("minProperties" = 1, "maxProperties" = 1))]
    pub controller: Controller,
    /// The position set-point; may be absent with `open_loop` only.
    #[serde(default)]
    pub reference: Reference,
    /// Limits that a run must keep to pass.
    #[serde(default)]
    pub expect: Expect,
    /// Facts of the whole run.
    #[serde(skip)]
    pub run: Arc<Run>,
    /// Plants that are emulated together, by name: the one that its drive moves, and those that nodes connect with it. The
    /// controller never sees their parameters.
    #[serde(skip)]
    pub plants: BTreeMap<String, PlantModel>,
    /// Sensor of its drive.
    #[serde(skip)]
    pub sensor: Sensor,
    /// Amplifier of its drive.
    #[serde(skip)]
    pub amplifier: Amplifier,
    /// Wiring of its drive.
    #[serde(skip)]
    pub wiring: Wiring,
}

impl Trial {
    /// Returns the facts of the run for changes that hold for this loop alone.
    pub fn run_mut(&mut self) -> &mut Run {
        Arc::make_mut(&mut self.run)
    }

    /// Returns the plant that its drive moves.
    ///
    /// # Panics
    /// Another plant was put into its wiring.
    pub fn plant(&self) -> &PlantModel {
        &self.plants[&self.wiring.plant]
    }

    /// Makes its drive move another plant.
    pub fn set_plant(&mut self, plant: PlantModel) {
        self.plants.insert(self.wiring.plant.clone(), plant);
    }

    /// Checks whether one of the plants that are emulated together is an FMU.
    pub fn has_fmu(&self) -> bool {
        self.plants.values().any(|plant| plant.fmu.is_some())
    }

    /// Returns the faults of its loop: those of its drive and plant, and those of no drive.
    pub fn loop_faults(&self) -> impl Iterator<Item = &Fault> {
        let wiring = &self.wiring;
        let faults = self.run.faults.iter();
        faults.filter(move |fault| wiring.is_hit_by(fault, wiring.drive, &wiring.plant))
    }

    /// Returns the faults that it would have if its drive were the one that it follows, and had all plants of the loop.
    pub fn faults_followed(&self) -> impl Iterator<Item = &Fault> {
        let wiring = &self.wiring;
        let faults = self.run.faults.iter();
        faults.filter(move |fault| {
            let mut plants = wiring.touched().chain([&wiring.plant]);
            plants.any(|plant| wiring.is_hit_by(fault, wiring.followed, plant))
        })
    }

    /// Returns the faults by which its position may deviate: those of its nodes and plants, of other drives of these plants, and of
    /// no drive.
    pub fn position_faults(&self) -> impl Iterator<Item = &Fault> {
        let wiring = &self.wiring;
        let is_touched = |plant: &str| wiring.touches(plant);
        let is_near = move |index: NodeIndex| {
            let node = wiring.node(index);
            let is_it = |one: &LoopFacts| {
                let is_led = one.is_led_by(&wiring.loop_name);
                one.drive == node.name && (is_led || is_touched(&one.emulated))
            };
            let is_own = [wiring.drive, wiring.followed].contains(&index);
            let is_own_io = node.is_io() && wiring.io_nodes().any(|io| io == index);
            let is_elsewhere = node.is_drive() || node.is_io();
            !is_elsewhere || is_own || is_own_io || wiring.shared.loops.iter().any(is_it)
        };
        let faults = self.run.faults.iter();
        faults.filter(move |fault| {
            fault.node.is_none_or(is_near) && fault.plant.as_deref().is_none_or(is_touched)
        })
    }

    /// Checks whether the true position is judged as well: the plant or the sensor that the loop follows has faults.
    pub fn has_true_metrics(&self) -> bool {
        let mut groups = self.faults_followed().map(|fault| fault.kind.group);
        groups.any(|group| [Group::Sensor, Group::Plant].contains(&group))
    }

    /// Returns the faults of its drive, and of the plant that the drive moves.
    pub fn drive_faults(&self) -> Faults {
        let Wiring { drive, plant, .. } = &self.wiring;
        let faults = &self.run.faults;
        faults.only(|fault| fault.is_at_drive(*drive, plant))
    }

    /// Returns the values that an emulated drive has in its data sheet: the unit of positions and velocities, the amplifier's
    /// currents and protection, and identifiers that differ from the usual ones.
    pub fn presets(&self) -> Vec<Preset> {
        let mut presets = Vec::from(self.wiring.sensor.quantity.unit.presets());
        presets.extend(self.amplifier.presets());
        let channel = self.wiring.identifiers.second_sdo;
        let usual = Identifiers::new(0, self.wiring.drive().id(), 0).second_sdo;
        for (sub_index, (identifier, usual)) in (1..).zip(channel.into_iter().zip(usual)) {
            if identifier != usual {
                presets.push(Preset::new(SECOND_SDO, sub_index, identifier.into()));
            }
        }
        presets
    }

    /// Checks whether a fault of the run belongs to its loop.
    pub fn has_loop_faults(&self) -> bool {
        self.loop_faults().next().is_some()
    }
}
