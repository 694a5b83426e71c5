//! The plant emulator: a plant behind the bus interface of a real drive.
//!
//! Comes in: a scenario, and the frames of whoever leads the drive. Goes out: the frames of a drive and of a disturbance
//! module, and the truth about the plant that no real drive publishes.
//!
//! [`plant`] says what a plant is; [`sma`] is the actuator of the paper and [`dc_motor`] a motor with gearbox, one file for
//! each part of the model; [`catalogue`] lists them with those that a bench from outside brings. [`drive`] and
//! [`disturbance`] are the two nodes that act on a plant; [`PlantEmulator`] is both of them and the plant as one participant.
//!
//! It does not know: control laws, what is expected of a run, and in which world it runs. The platform is named in `main.rs`
//! only.
#![warn(missing_docs)]

pub mod amplifier;
pub mod catalogue;
mod clocked_plant;
pub mod dc_motor;
pub mod disturbance;
pub mod drive;
mod faults;
pub mod integrator;
mod objects;
pub mod plant;
pub mod sensor;
pub mod sma;
pub mod thermal_protection;
mod truth;

use std::time::Duration;

use ::faults::{FaultPlan, Faulty};
use canopen::device::PDOS_AND_SDOS;
use canopen::eds::EdsError;
use canopen::services::InvalidPdo;
use canopen::{CanFrame, Device, Filter, Node, NodeId, ObjectDictionary, Progress, earlier};

use dbc::loops::LoopPlace;
use dbc::{Database, SignalMissing};
use disturbance::DisturbanceModule;
use drive::Drive;
pub use objects::MissingObject;
use plant::{Inputs, InvalidPlant, Plant};
use scenario::fault::node::Output;
use truth::Truth;

/// Node-ID of the manager, by the bench's convention.
const MANAGER_NODE_ID: NodeId = NodeId::new(0x01).expect("1 is in 1 to 127");
const IDENTITY: u16 = 0x1018;
const PRODUCT_CODE: u8 = 2;
/// TPDO1, RPDO1 to TPDO4, RPDO4 (CiA 301, 7.3.5).
const PDO_FUNCTIONS: [u16; 8] = [0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500];

/// What is below and above [`PDOS_AND_SDOS`]: NMT, SYNC, EMCY and TIME; heartbeats and LSS.
fn other_services() -> [Filter; 4] {
    [
        (0x000, 0x700),
        (0x100, 0x780),
        (0x680, 0x780),
        (0x700, 0x700),
    ]
    .map(|(id, mask)| Filter::block(id, mask))
}

/// Why there can be no emulator.
#[derive(Debug, thiserror::Error)]
pub enum InvalidEmulator {
    /// The plant makes no physical sense.
    #[error("plant: {0}")]
    Plant(#[from] InvalidPlant),
    /// There is no such plant.
    #[error("there is no plant `{0}`")]
    UnknownPlant(String),
    /// The table of a plant from outside is that of another one.
    #[error("plant: {0}")]
    Parameters(#[from] toml::de::Error),
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
    /// No node's number.
    #[error("{0} is no node-ID")]
    NodeId(u8),
    /// The DBC lacks what the emulator says.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
}

/// The drive with the plant it is wired to, and the disturbance module that acts on the same plant.
///
/// The plant follows the emulator's own time; see [`drive`]. In a scenario with faults the drive's node may fail; the
/// plant lives on and publishes the truth about itself.
#[derive(Debug)]
pub struct PlantEmulator<P: Plant> {
    drive: DriveNode<P>,
    /// None where no node acts on the plant besides the drive.
    disturbance: Option<Device<DisturbanceModule>>,
    place: LoopPlace,
}

/// The drive as a node, in a scenario without faults and in one with them.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, and it lives as long as the program"
)]
enum DriveNode<P: Plant> {
    Sound(Device<Drive<P>>),
    Faulty(Faulty<Device<Drive<P>>>, Truth),
}

impl<P: Plant> DriveNode<P> {
    fn new(
        scenario: &scenario::Scenario,
        sound: Device<Drive<P>>,
        place: LoopPlace,
        database: &Database,
    ) -> Result<Self, InvalidEmulator> {
        if scenario.fault.is_empty() {
            return Ok(Self::Sound(sound));
        }
        let plan = FaultPlan {
            number: place.drive_node_id,
            ..FaultPlan::new(&scenario.fault, scenario::fault::node::Node::Drive)
        };
        let fresh = sound.clone();
        let renew = move |device: &mut Device<Drive<P>>| {
            let mut drive = device.application().clone();
            drive.renew(fresh.application());
            device.clone_from(&fresh);
            *device.application_mut() = drive;
        };
        let faulty = Faulty::new(sound, plan, database, renew)?;
        Ok(Self::Faulty(faulty, Truth::new(database)?))
    }

    fn as_node(&self) -> &dyn Node {
        match self {
            Self::Sound(device) => device,
            Self::Faulty(faulty, _) => faulty,
        }
    }

    fn as_node_mut(&mut self) -> &mut dyn Node {
        match self {
            Self::Sound(device) => device,
            Self::Faulty(faulty, _) => faulty,
        }
    }

    fn device(&self) -> &Device<Drive<P>> {
        match self {
            Self::Sound(device) => device,
            Self::Faulty(faulty, _) => faulty.node(),
        }
    }

    fn drive_mut(&mut self) -> &mut Drive<P> {
        match self {
            Self::Sound(device) => device.application_mut(),
            Self::Faulty(faulty, _) => faulty.node_mut().application_mut(),
        }
    }

    /// After each event: the rig goes on, whatever the node does.
    fn follow(&mut self, now: Duration) {
        let Self::Faulty(faulty, truth) = self else {
            return;
        };
        let (ahead, behind) = faulty.clock_error();
        let (zero, dead_output) = (faulty.scenario_zero(), faulty.dead_output());
        let drive = faulty.node_mut().application_mut();
        drive.set_clock_error(ahead, behind);
        if let Some(zero) = zero {
            drive.faults_mut().begin(zero);
        }
        if dead_output == Some(Output::Zero) {
            drive.cut_off(now);
        }
        drive.follow(now);
        truth.observe(now, drive.clocked_plant());
    }

    /// Before each event: the node's clock, so that the rig knows its own.
    fn set_clock(&mut self, now: Duration) {
        if let Self::Faulty(faulty, _) = self {
            let (ahead, behind) = faulty.clock_error_at(now);
            let drive = faulty.node_mut().application_mut();
            drive.set_clock_error(ahead, behind);
        }
    }

    fn next_deadline(&self) -> Option<Duration> {
        let node = self.as_node().next_deadline();
        let Self::Faulty(faulty, truth) = self else {
            return node;
        };
        let fault = faulty.node().application().next_fault();
        [node, fault, Some(truth.next_deadline())]
            .into_iter()
            .flatten()
            .min()
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        let frame = self.as_node_mut().next_frame();
        match self {
            Self::Faulty(_, truth) => frame.or_else(|| truth.next_frame()),
            Self::Sound(_) => frame,
        }
    }
}

impl<P: Plant> PlantEmulator<P> {
    /// The emulator of a plant with these parameters in a scenario, with the objects of the shipped data sheets.
    ///
    /// # Errors
    /// A plant that makes no sense, or a data sheet that does not suit.
    pub fn new(scenario: &scenario::Scenario, config: &P::Config) -> Result<Self, InvalidEmulator> {
        Self::at(scenario, config, LoopPlace::SHIPPED, Database::shipped())
    }

    /// As [`PlantEmulator::new`], where a loop is on a bus with these frames.
    ///
    /// # Errors
    /// As [`PlantEmulator::new`].
    pub fn at(
        scenario: &scenario::Scenario,
        config: &P::Config,
        place: LoopPlace,
        database: &Database,
    ) -> Result<Self, InvalidEmulator> {
        let plant = P::new(config)?;
        let wrong_id = scenario.fault.node.wrong_node_id.first();
        let drive_id = wrong_id
            .and_then(|fault| NodeId::new(fault.node_id))
            .map_or_else(|| node_id(place.drive_node_id), Ok)?;
        let mut objects = dictionary(drive_id, dbc::DRIVE_EDS)?;
        if let Some(fault) = scenario.fault.node.wrong_identity.first() {
            set_product_code(&mut objects, fault.product_code);
        }
        drive::declare(&mut objects, &plant);
        drive::set_truth_pace(&mut objects, &place);
        let drive = Drive::new(scenario, plant, &objects)?;
        let drive = Device::new(drive_id, objects, drive)?;
        let disturbance = place.disturbance_node_id.map(disturbance).transpose()?;
        Ok(Self {
            drive: DriveNode::new(scenario, drive, place, database)?,
            disturbance,
            place,
        })
    }

    /// The plant, as far as it has been brought up to date: to the latest SYNC or tick, or later.
    #[must_use]
    pub fn plant(&self) -> &P {
        self.drive.device().application().plant()
    }

    /// What acts on the plant.
    #[must_use]
    pub fn inputs(&self) -> &Inputs<P::Condition> {
        self.drive.device().application().inputs()
    }

    /// Passes the disturbance module's outputs on to the plant.
    fn disturb(&mut self, now: Duration) {
        let Some(disturbance) = &self.disturbance else {
            return;
        };
        let module = disturbance.application();
        let (factor, load) = (module.convection_factor(), module.added_load_kilograms());
        self.drive.drive_mut().disturb(now, factor, load);
    }
}

impl<P: Plant> Node for PlantEmulator<P> {
    fn filters(&self) -> Vec<Filter> {
        let mut filters = self.drive.as_node().filters();
        filters.extend(self.disturbance.iter().flat_map(Node::filters));
        filters.sort_unstable_by_key(|filter| (filter.id, filter.mask));
        filters.dedup();
        filters
    }

    /// Everything but the PDOs and SDOs of others. With faults there is more that is read.
    fn filters_as_configured(&self) -> Vec<Filter> {
        let DriveNode::Sound(drive) = &self.drive else {
            return self.filters();
        };
        let is_read = |id: &u16| {
            let mut disturbance = self.disturbance.iter();
            drive.reads(*id) || disturbance.any(|module| module.reads(*id))
        };
        let own = PDOS_AND_SDOS.filter(is_read).map(Filter::exact);
        let others = [Filter::REMOTE, Filter::EXTENDED, Filter::ERRORS];
        other_services()
            .into_iter()
            .chain(others)
            .chain(own)
            .collect()
    }

    /// The PDOs of the manager and the own ones, as far as they wait for the SYNC or nobody here listens to them. With
    /// faults any frame may make the emulator publish the truth.
    fn silent_filters(&self) -> Vec<Filter> {
        let DriveNode::Sound(drive) = &self.drive else {
            return Vec::new();
        };
        let own = [self.place.drive_node_id].into_iter();
        let own = own.chain(self.place.disturbance_node_id);
        let nodes = Vec::from_iter([MANAGER_NODE_ID.get()].into_iter().chain(own));
        let is_silent = |id: &u16| {
            let mut disturbance = self.disturbance.iter();
            drive.takes_silently(*id) && disturbance.all(|module| module.takes_silently(*id))
        };
        let ids = PDO_FUNCTIONS
            .into_iter()
            .flat_map(|function| nodes.iter().map(move |node| function + u16::from(*node)));
        ids.filter(is_silent).map(Filter::exact).collect()
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.drive.set_clock(now);
        if let Some(disturbance) = &mut self.disturbance {
            disturbance.on_frame(now, frame);
        }
        self.disturb(now);
        self.drive.as_node_mut().on_frame(now, frame);
        self.drive.follow(now);
    }

    fn on_tick(&mut self, now: Duration) {
        self.drive.set_clock(now);
        if let Some(disturbance) = &mut self.disturbance {
            disturbance.on_tick(now);
        }
        self.disturb(now);
        self.drive.as_node_mut().on_tick(now);
        self.drive.follow(now);
    }

    fn on_stop(&mut self, now: Duration) {
        self.drive.set_clock(now);
        if let Some(disturbance) = &mut self.disturbance {
            disturbance.on_stop(now);
        }
        self.disturb(now);
        self.drive.as_node_mut().on_stop(now);
        self.drive.follow(now);
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.drive
            .next_frame()
            .or_else(|| self.disturbance.as_mut()?.next_frame())
    }

    fn next_deadline(&self) -> Option<Duration> {
        let disturbance = self.disturbance.as_ref().and_then(Node::next_deadline);
        earlier(self.drive.next_deadline(), disturbance)
    }

    fn progress(&self) -> Progress {
        let drive = self.drive.as_node().progress();
        let disturbance = self.disturbance.as_ref();
        match (drive, disturbance.map_or(Progress::Stopped, Node::progress)) {
            (Progress::Stopped, Progress::Stopped) => Progress::Stopped,
            (failed @ Progress::Failed(_), _) | (_, failed @ Progress::Failed(_)) => failed,
            _ => Progress::Running,
        }
    }
}

fn disturbance(number: u8) -> Result<Device<DisturbanceModule>, InvalidEmulator> {
    let node_id = node_id(number)?;
    let objects = dictionary(node_id, dbc::DISTURBANCE_EDS)?;
    let module = DisturbanceModule::new(&objects)?;
    Ok(Device::new(node_id, objects, module)?)
}

fn node_id(number: u8) -> Result<NodeId, InvalidEmulator> {
    NodeId::new(number).ok_or(InvalidEmulator::NodeId(number))
}

/// The dictionary of a data sheet.
fn dictionary(node_id: NodeId, text: &str) -> Result<ObjectDictionary, InvalidEmulator> {
    let dictionary = dbc::dictionary(text, node_id.get());
    dictionary.map_err(|error| InvalidEmulator::Eds { node_id, error })
}

/// Makes a dictionary that of another product.
fn set_product_code(dictionary: &mut ObjectDictionary, product_code: u32) {
    if let Ok(handle) = dictionary.find(IDENTITY, PRODUCT_CODE) {
        let mut entry = dictionary.entry(handle).clone();
        entry.default = product_code.to_le_bytes().to_vec();
        dictionary.insert(entry);
    }
}
