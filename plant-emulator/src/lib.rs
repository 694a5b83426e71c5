//! The plant emulator: a plant behind the bus interface of a real drive.
//!
//! Inputs are a scenario, and the frames of the controller. Outputs are the frames of the drives and disturbance
//! modules of a plant, and the truth about the plant that no real drive publishes.
//!
//! [`plant`] has the trait of all plants: named inputs and outputs, and time. [`plants`] has those that ship, with a
//! file for each part of a model; [`catalogue`] lists them and the custom ones. [`drive`] and [`disturbance`] are the
//! nodes that act on a plant. [`PlantEmulator`] is the plant with all of them, as one participant.
//!
//! The emulator does not know control laws, the expectations on a run, or the world in which it runs. It
//! does not use the platform.
#![warn(missing_docs)]

pub mod amplifier;
pub mod catalogue;
mod clocked_plant;
pub mod disturbance;
pub mod drive;
mod drive_node;
mod faults;
pub mod integrator;
mod io_node;
mod objects;
pub mod plant;
pub mod plants;
pub mod sensor;
pub mod thermal_protection;
mod truth;
mod wires;

use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress, earliest};
use canopen::NodeId;
use canopen::device::PDOS_AND_SDOS;
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::services::InvalidPdo;

use clocked_plant::ClockedPlant;
use dbc::{Database, SignalMissing};
use drive_node::{DriveNode, Parts, scenario_clock};
use io_node::IoNode;
use plant::{InvalidPlant, Plant, Ports};
use scenario::Trial;
use wires::Wires;

/// TPDO1, RPDO1 to TPDO4, RPDO4 (CiA 301, 7.3.5).
const PDO_FUNCTIONS: [u16; 8] = [0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500];

/// Returns the filters below and above [`PDOS_AND_SDOS`] except heartbeats: NMT, SYNC, EMCY and TIME; LSS.
fn other_services() -> [Filter; 4] {
    [
        (0x000, 0x700),
        (0x100, 0x780),
        (0x680, 0x780),
        (0x780, 0x780),
    ]
    .map(|(id, mask)| Filter::block(id, mask))
}

/// Reason why there can be no emulator.
#[derive(Debug, thiserror::Error)]
pub enum InvalidEmulator {
    /// The plant makes no physical sense.
    #[error("plant: {0}")]
    Plant(#[from] InvalidPlant),
    /// The parameters do not fit the custom plant.
    #[error("plant: {0}")]
    Parameters(#[from] toml::de::Error),
    /// A data sheet configures a PDO wrongly.
    #[error("{0}")]
    Pdo(#[from] InvalidPdo),
    /// The DBC lacks a signal of the emulator.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
    /// Another reason, as text.
    #[error("{0}")]
    Other(String),
}

/// Plants that are connected by nodes, usually one, with their drives and the io nodes that act on them.
///
/// The plants follow the emulator's own time; see [`drive`]. In a scenario with faults the node of a drive may fail;
/// the plant continues and publishes the truth about itself.
#[derive(Debug)]
pub struct PlantEmulator {
    /// Name of the plants in errors.
    name: String,
    /// Drives, in the order of their node-IDs.
    drives: Vec<DriveNode>,
    /// Index of the drive that holds the plants.
    holder: usize,
    modules: Vec<IoNode>,
    /// Node-IDs of drives and modules.
    node_ids: Vec<u8>,
    /// Node-ID of their manager.
    manager: u8,
}

impl PlantEmulator {
    /// Makes the emulator of named plants and of the drives of these loops, with the objects of the shipped data sheets, on a bus
    /// with these frames.
    ///
    /// # Errors
    /// The plants lack a port, or a data sheet does not fit.
    pub fn of(
        plants: Vec<(String, Box<dyn Plant>)>,
        loops: &[&Trial],
        database: &Database,
    ) -> Result<Self, InvalidEmulator> {
        let controller = loops.first().map(|trial| trial.wiring.controller().id());
        let manager = controller.unwrap_or_default();
        let ports = plants
            .iter()
            .map(|(name, plant)| (name.as_str(), plant.ports()));
        let ports = Ports::joined(ports);
        let names = Vec::from_iter(plants.iter().map(|(name, _)| name.clone()));
        let name = names.join(" and ");
        let plants = ClockedPlant::new(plants);
        let mut sorted = loops.to_vec();
        sorted.sort_by_key(|trial| trial.wiring.drive().id());
        let (mut nodes, mut modules, mut node_ids) = (Vec::new(), Vec::new(), Vec::new());
        for trial in sorted {
            let wires = Wires::new(&ports, &trial.wiring)?;
            node_ids.push(trial.wiring.drive().id());
            for io in (trial.wiring.shared).io_on(|plant| names.iter().any(|name| name == plant)) {
                let id = trial.wiring.node(io.node).id();
                if !node_ids.contains(&id) {
                    node_ids.push(id);
                    let clock = || scenario_clock(trial, database);
                    modules.push(IoNode::new(io, &ports, trial, clock)?);
                }
            }
            let parts = Parts::new(&plants, wires, trial)?;
            nodes.push(DriveNode::new(parts, trial, database)?);
        }
        if let Some(first) = nodes.first_mut() {
            first.drive_mut().plant = plants;
        }
        Ok(Self {
            name,
            drives: nodes,
            holder: 0,
            modules,
            node_ids,
            manager,
        })
    }

    /// Returns the first plant of this type, at the time of its last advance: the latest SYNC or tick, or later.
    pub fn plant<P: Plant>(&self) -> Option<&P> {
        self.in_hand()?.plant()
    }

    /// Returns the values of the plant's inputs.
    pub fn inputs(&self) -> &[f64] {
        self.in_hand().map_or(&[], ClockedPlant::inputs)
    }

    fn in_hand(&self) -> Option<&ClockedPlant> {
        let holder = self.drives.get(self.holder)?;
        Some(&holder.device().application().plant)
    }

    /// Hands the plant over to a drive.
    #[inline]
    fn hand_over(&mut self, to: usize) {
        if self.holder != to {
            let plant = std::mem::take(&mut self.drives[self.holder].drive_mut().plant);
            self.drives[to].drive_mut().plant = plant;
            self.holder = to;
        }
    }

    /// Applies an event to the modules, then to each drive, in the order of node-IDs. At last it advances the rig.
    fn each(&mut self, now: Duration, to_node: impl Fn(&mut dyn Node)) {
        for module in &mut self.modules {
            to_node(module.as_node_mut());
        }
        self.disturb(now);
        for place in 0..self.drives.len() {
            self.hand_over(place);
            to_node(self.drives[place].as_node_mut());
        }
        for place in 0..self.drives.len() {
            if self.drives[place].is_faulty() {
                self.hand_over(place);
                self.drives[place].follow(now);
            }
        }
    }

    /// Passes the time and the outputs of the disturbance modules to the plant.
    fn disturb(&mut self, now: Duration) {
        let Some(holder) = self.drives.get_mut(self.holder) else {
            return;
        };
        holder.drive_mut().plant.now = now;
        for module in &mut self.modules {
            for (input, value) in module.changed_inputs() {
                holder.drive_mut().disturb(input, value);
            }
        }
    }
}

impl Node for PlantEmulator {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::ALL, Filter::ERRORS]
    }

    /// Returns filters that exclude the PDOs, SDOs and heartbeats for other nodes. Drives and modules need the
    /// heartbeats of their manager, which they watch once they are configured. With faults they read more frames.
    fn filters_as_configured(&self) -> Vec<Filter> {
        if self.drives.iter().any(DriveNode::is_faulty) {
            return self.filters();
        }
        let is_read = |id: &u16| {
            let mut drives = self.drives.iter();
            let mut modules = self.modules.iter();
            drives.any(|drive| drive.device().reads(*id))
                || modules.any(|module| module.device().reads(*id))
        };
        let read = PDOS_AND_SDOS.filter(is_read).map(Filter::exact);
        let is_watched = |node: &NodeId| {
            let mut drives = self.drives.iter();
            let mut modules = self.modules.iter();
            node.get() == self.manager
                || drives.any(|drive| drive.device().watches(*node))
                || modules.any(|module| module.device().watches(*node))
        };
        let nodes = (1..=127).filter_map(NodeId::new);
        let heartbeats = nodes
            .filter(is_watched)
            .map(|node| Filter::exact(ERROR_CONTROL_ID + u16::from(node.get())));
        let others = [Filter::REMOTE, Filter::EXTENDED, Filter::ERRORS];
        let services = other_services().into_iter().chain(others);
        services.chain(read).chain(heartbeats).collect()
    }

    /// Returns filters for PDOs of the manager and of the nodes here that wait for the SYNC, or that no node here reads.
    /// With faults any frame may make the emulator publish the truth.
    fn silent_filters(&self) -> Vec<Filter> {
        if self.drives.iter().any(DriveNode::is_faulty) {
            return Vec::new();
        }
        let here = self.node_ids.iter().copied();
        let nodes = Vec::from_iter([self.manager].into_iter().chain(here));
        let is_silent = |id: &u16| {
            let mut drives = self.drives.iter();
            let mut modules = self.modules.iter();
            drives.all(|drive| drive.device().takes_silently(*id))
                && modules.all(|module| module.device().takes_silently(*id))
        };
        let ids = PDO_FUNCTIONS
            .into_iter()
            .flat_map(|function| nodes.iter().map(move |node| function + u16::from(*node)));
        ids.filter(is_silent).map(Filter::exact).collect()
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.each(now, |node| node.on_frame(now, frame));
    }

    fn on_tick(&mut self, now: Duration) {
        self.each(now, |node| node.on_tick(now));
    }

    fn on_stop(&mut self, now: Duration) {
        self.each(now, |node| node.on_stop(now));
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        let mut drives = self.drives.iter_mut().enumerate();
        let sent = drives.find_map(|(place, drive)| Some((place, drive.next_frame()?)));
        if let Some((sender, frame)) = sent {
            for (place, drive) in self.drives.iter_mut().enumerate() {
                if place != sender {
                    drive.overhear(&frame);
                }
            }
            for module in &mut self.modules {
                module.overhear(&frame);
            }
            return Some(frame);
        }
        let mut modules = self.modules.iter_mut();
        modules.find_map(|module| module.as_node_mut().next_frame())
    }

    fn next_deadline(&self) -> Option<Duration> {
        let drives = self.drives.iter().map(DriveNode::next_deadline);
        let modules = self.modules.iter().map(IoNode::next_deadline);
        earliest(drives.chain(modules))
    }

    /// Returns a failure if the plant cannot continue, whatever its drives report.
    fn progress(&self) -> Progress {
        if let Some(reason) = self.in_hand().and_then(ClockedPlant::failure) {
            return Progress::Failed(format!("the plant `{}` cannot go on: {reason}", self.name));
        }
        let drives = self.drives.iter().map(|drive| drive.as_node().progress());
        let modules = self
            .modules
            .iter()
            .map(|module| module.as_node().progress());
        let mut all = Progress::Stopped;
        for one in drives.chain(modules) {
            match one {
                failed @ Progress::Failed(_) => return failed,
                Progress::Running => all = Progress::Running,
                Progress::Stopped => {}
            }
        }
        all
    }
}
