//! An io node on the bus, by its scenario: sound, or a node that fails.
//!
//! The emulator makes it of the outputs that the rig wires to its plants, passes it each event, and
//! reads from it the values of those inputs of the plants that have changed.

use std::time::Duration;

use can::{CanFrame, Node};
use canopen::{Device, ObjectDictionary};
use dbc::node_objects;
use dbc::scenario_clock::ScenarioClock;
use faults::{FaultPlan, Faulty};
use scenario::Trial;
use scenario::wiring::{IoOutput, IoWiring};

use crate::InvalidEmulator;
use crate::disturbance::DisturbanceModule;
use crate::objects::node_id;
use crate::plant::Ports;

/// An io node, and the inputs of the plants that it sets.
#[derive(Debug)]
pub(crate) struct IoNode {
    node: Played,
    outputs: Vec<IoOutput>,
    /// Whether the outputs are at rest, since the node has no power.
    is_at_rest: bool,
}

/// The node itself, in a scenario without faults at it or with some.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there are few, and they live as long as the program"
)]
enum Played {
    Sound(Device<DisturbanceModule>),
    Faulty(Faulty<Device<DisturbanceModule>>),
}

impl IoNode {
    /// Makes the io node of a wiring, with its faults, which follow the clock of a scenario that has not begun.
    pub(crate) fn new(
        io: &IoWiring,
        ports: &Ports,
        trial: &Trial,
        clock: impl FnOnce() -> Result<ScenarioClock, InvalidEmulator>,
    ) -> Result<Self, InvalidEmulator> {
        let wiring = &trial.wiring;
        let (node, manager) = (wiring.node(io.node), wiring.controller().id());
        let (id, outputs) = (node.id(), io.outputs(ports));
        let objects = node_objects::io(id, outputs.iter().map(IoOutput::in_sheet), manager);
        let name = wiring.shared.device_name(&node.name);
        let objects = node_objects::with_device_name(objects, name);
        let sound = device(id, objects.clone())?;
        let faults = trial.run.faults.at_node(io.node);
        let node = if faults.is_empty() {
            Played::Sound(sound)
        } else {
            let renew = move |module: &mut Device<DisturbanceModule>| {
                // The same objects were set up before, so this cannot fail.
                if let Ok(fresh) = device(id, objects.clone()) {
                    *module = fresh;
                }
            };
            Played::Faulty(Faulty::new(
                sound,
                FaultPlan::new(&faults, id),
                clock()?,
                renew,
            ))
        };
        Ok(Self {
            node,
            outputs,
            is_at_rest: false,
        })
    }

    pub(crate) fn as_node(&self) -> &dyn Node {
        match &self.node {
            Played::Sound(device) => device,
            Played::Faulty(faulty) => faulty,
        }
    }

    pub(crate) fn as_node_mut(&mut self) -> &mut dyn Node {
        match &mut self.node {
            Played::Sound(device) => device,
            Played::Faulty(faulty) => faulty,
        }
    }

    pub(crate) fn device(&self) -> &Device<DisturbanceModule> {
        match &self.node {
            Played::Sound(device) => device,
            Played::Faulty(faulty) => faulty.node(),
        }
    }

    fn device_mut(&mut self) -> &mut Device<DisturbanceModule> {
        match &mut self.node {
            Played::Sound(device) => device,
            Played::Faulty(faulty) => faulty.node_mut(),
        }
    }

    /// Takes a frame of a drive on the same CAN controller, from which scenario time follows.
    pub(crate) fn overhear(&mut self, frame: &CanFrame) {
        if let Played::Faulty(faulty) = &mut self.node {
            faulty.overhear(frame);
        }
    }

    /// Returns when it must be advanced next.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        self.as_node().next_deadline()
    }

    /// Returns the inputs of the plants that it sets, each with its value, if they may have changed. A node without power leaves
    /// its outputs at rest.
    pub(crate) fn changed_inputs(&mut self) -> Vec<(usize, f64)> {
        let is_at_rest = match &self.node {
            Played::Sound(_) => false,
            Played::Faulty(faulty) => faulty.is_switched_off(),
        };
        let is_switched = self.is_at_rest != is_at_rest;
        self.is_at_rest = is_at_rest;
        let module = self.device_mut().application_mut();
        if !std::mem::take(&mut module.is_changed) && !is_switched {
            return Vec::new();
        }
        let device = self.device();
        let (module, dictionary) = (device.application(), device.services().dictionary());
        let inputs = self.outputs.iter().filter_map(|output| {
            let steps = match is_at_rest {
                true => output.in_sheet().2.into(),
                false => module.steps(dictionary, output.place),
            };
            Some((output.input?, output.input_value(steps)))
        });
        inputs.collect()
    }
}

fn device(id: u8, objects: ObjectDictionary) -> Result<Device<DisturbanceModule>, InvalidEmulator> {
    let module = DisturbanceModule::new(&objects)?;
    Ok(Device::new(node_id(id)?, objects, module)?)
}
