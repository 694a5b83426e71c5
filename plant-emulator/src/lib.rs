//! The plant emulator: the actuator of the paper behind the bus interface of a real drive.
//!
//! [`sma`] is the physics, one file per part of the model. [`drive`] and [`disturbance`] are the two nodes that act on
//! it, [`PlantEmulator`] both of them and the actuator as one participant of the bus.

pub mod amplifier;
pub mod disturbance;
pub mod drive;
mod integrator;
mod objects;
mod rig;
pub mod sensor;
pub mod sma;
pub mod thermal_protection;

use std::time::Duration;

use canopen::eds::{self, EdsError};
use canopen::services::InvalidPdo;
use canopen::{Application, CanFrame, Device, Filter, Node, NodeId, ObjectDictionary, Progress};

use disturbance::DisturbanceModule;
use drive::Drive;
pub use objects::MissingObject;
use sma::{Actuator, Inputs, InvalidPlant};

/// Node-ID of the drive.
pub const DRIVE_NODE_ID: NodeId = NodeId::new(0x10).expect("16 is in 1 to 127");
/// Node-ID of the disturbance module.
pub const DISTURBANCE_NODE_ID: NodeId = NodeId::new(0x11).expect("17 is in 1 to 127");

/// Node-ID of the manager, by the bench's convention.
const MANAGER_NODE_ID: NodeId = NodeId::new(0x01).expect("1 is in 1 to 127");
/// TPDO1, RPDO1 to TPDO4, RPDO4 (CiA 301, 7.3.5).
const PDO_FUNCTIONS: [u16; 8] = [0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500];

/// Why there can be no emulator.
#[derive(Debug, thiserror::Error)]
pub enum InvalidEmulator {
    /// The plant makes no physical sense.
    #[error("plant: {0}")]
    Plant(#[from] InvalidPlant),
    /// A data sheet cannot be read.
    #[error("EDS of node {node_id}: {error}")]
    Eds {
        /// The node.
        node_id: NodeId,
        /// What is wrong with the text.
        error: EdsError,
    },
    /// A data sheet lacks an object.
    #[error("{0}")]
    MissingObject(#[from] MissingObject),
    /// A data sheet configures a PDO wrongly.
    #[error("{0}")]
    Pdo(#[from] InvalidPdo),
}

/// The drive with the actuator it is wired to, and the disturbance module that acts on the same actuator.
///
/// The actuator follows the emulator's own time; see [`drive`].
#[derive(Debug)]
pub struct PlantEmulator {
    drive: Device<Drive>,
    disturbance: Device<DisturbanceModule>,
}

impl PlantEmulator {
    /// The emulator of a scenario's plant, with the objects of the shipped data sheets.
    ///
    /// # Errors
    /// A plant that makes no sense, or a data sheet that does not suit.
    pub fn new(scenario: &scenario::Scenario) -> Result<Self, InvalidEmulator> {
        sma::check(&scenario.plant)?;
        let drive = device(DRIVE_NODE_ID, dbc::DRIVE_EDS, |dictionary| {
            Drive::new(scenario, dictionary)
        })?;
        let disturbance = device(
            DISTURBANCE_NODE_ID,
            dbc::DISTURBANCE_EDS,
            DisturbanceModule::new,
        )?;
        Ok(Self { drive, disturbance })
    }

    /// The actuator, as far as it has been brought up to date: to the latest SYNC or tick, or later.
    #[must_use]
    pub fn actuator(&self) -> &Actuator {
        self.drive.application().actuator()
    }

    /// What acts on the actuator.
    #[must_use]
    pub fn inputs(&self) -> &Inputs {
        self.drive.application().inputs()
    }

    /// Passes the disturbance module's outputs on to the actuator.
    fn disturb(&mut self, now: Duration) {
        let module = self.disturbance.application();
        let (factor, load) = (module.convection_factor(), module.added_load_kilograms());
        self.drive.application_mut().disturb(now, factor, load);
    }
}

impl Node for PlantEmulator {
    fn filters(&self) -> Vec<Filter> {
        let mut filters = self.drive.filters();
        filters.extend(self.disturbance.filters());
        filters.sort_unstable_by_key(|filter| (filter.id, filter.mask));
        filters.dedup();
        filters
    }

    /// The PDOs of the manager and the own ones, as far as they wait for the SYNC or nobody here listens to them.
    fn silent_filters(&self) -> Vec<Filter> {
        let nodes = [MANAGER_NODE_ID, DRIVE_NODE_ID, DISTURBANCE_NODE_ID];
        let is_silent =
            |id: &u16| self.drive.takes_silently(*id) && self.disturbance.takes_silently(*id);
        let ids = PDO_FUNCTIONS
            .into_iter()
            .flat_map(|function| nodes.map(|node| function + u16::from(node.get())));
        ids.filter(is_silent).map(Filter::exact).collect()
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.disturbance.on_frame(now, frame);
        self.disturb(now);
        self.drive.on_frame(now, frame);
    }

    fn on_tick(&mut self, now: Duration) {
        self.disturbance.on_tick(now);
        self.disturb(now);
        self.drive.on_tick(now);
    }

    fn on_stop(&mut self, now: Duration) {
        self.disturbance.on_stop(now);
        self.disturb(now);
        self.drive.on_stop(now);
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.drive
            .next_frame()
            .or_else(|| self.disturbance.next_frame())
    }

    fn next_deadline(&self) -> Option<Duration> {
        let nodes = [self.drive.next_deadline(), self.disturbance.next_deadline()];
        nodes.into_iter().flatten().min()
    }

    fn progress(&self) -> Progress {
        match (self.drive.progress(), self.disturbance.progress()) {
            (Progress::Stopped, Progress::Stopped) => Progress::Stopped,
            (failed @ Progress::Failed(_), _) | (_, failed @ Progress::Failed(_)) => failed,
            _ => Progress::Running,
        }
    }
}

/// A device with the dictionary of a data sheet.
fn device<A: Application>(
    node_id: NodeId,
    text: &str,
    application: impl FnOnce(&ObjectDictionary) -> Result<A, MissingObject>,
) -> Result<Device<A>, InvalidEmulator> {
    let eds =
        eds::parse(text, node_id.get()).map_err(|error| InvalidEmulator::Eds { node_id, error })?;
    let application = application(&eds.dictionary)?;
    Ok(Device::new(node_id, eds.dictionary, application)?)
}
