//! A drive on the bus, by its scenario: sound, or a node that fails.

use std::time::Duration;

use can::{CanFrame, Node, earlier, earliest};
use canopen::object_dictionary::Preset;
use canopen::{Device, NodeId, ObjectDictionary};
use dbc::Database;
use dbc::loops::truth_presets;
use dbc::node_objects::{self, PlantSignals};
use dbc::scenario_clock::ScenarioClock;
use faults::{FaultPlan, Faulty};
use scenario::Trial;

use crate::InvalidEmulator;
use crate::clocked_plant::ClockedPlant;
use crate::drive::{self, Drive, LoopConfig};
use crate::objects::node_id;
use crate::truth::Truth;
use crate::wires::Wires;

const IDENTITY: u16 = 0x1018;
const PRODUCT_CODE: u8 = 2;

/// The drive as a node, in a scenario without faults or with faults.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there are few, and they live as long as the program"
)]
pub(crate) enum DriveNode {
    Sound(Device<Drive>),
    Faulty(Faulty<Device<Drive>>, Truth),
}

impl DriveNode {
    /// Makes the drive of these parts; it does not hold its plant yet.
    pub(crate) fn new(
        parts: Parts,
        trial: &Trial,
        database: &Database,
    ) -> Result<Self, InvalidEmulator> {
        let sound = parts.device()?;
        if !trial.has_loop_faults() {
            return Ok(Self::Sound(sound));
        }
        let wiring = &trial.wiring;
        let plan = FaultPlan::new(&trial.drive_faults(), wiring.nodes.drive.id);
        let renew = move |device: &mut Device<Drive>| {
            // The same parts were set up before, so this cannot fail.
            if let Ok(mut fresh) = parts.device() {
                fresh
                    .application_mut()
                    .wire_to_rig_of(device.application_mut());
                *device = fresh;
            }
        };
        let drives = wiring.shared.loops.iter().map(|one| one.drive.as_str());
        let clock = ScenarioClock::new(database, drives)?;
        let faulty = Faulty::new(sound, plan, clock, renew);
        let truth = Truth::new(database, wiring)?;
        Ok(Self::Faulty(faulty, truth))
    }

    pub(crate) fn is_faulty(&self) -> bool {
        matches!(self, Self::Faulty(..))
    }

    pub(crate) fn as_node(&self) -> &dyn Node {
        match self {
            Self::Sound(device) => device,
            Self::Faulty(faulty, _) => faulty,
        }
    }

    pub(crate) fn as_node_mut(&mut self) -> &mut dyn Node {
        match self {
            Self::Sound(device) => device,
            Self::Faulty(faulty, _) => faulty,
        }
    }

    pub(crate) fn device(&self) -> &Device<Drive> {
        match self {
            Self::Sound(device) => device,
            Self::Faulty(faulty, _) => faulty.node(),
        }
    }

    pub(crate) fn drive_mut(&mut self) -> &mut Drive {
        match self {
            Self::Sound(device) => device.application_mut(),
            Self::Faulty(faulty, _) => faulty.node_mut().application_mut(),
        }
    }

    /// Advances the rig after each event, in any state of the node.
    pub(crate) fn follow(&mut self, now: Duration) {
        let Self::Faulty(faulty, truth) = self else {
            return;
        };
        let (zero, is_switched_off) = (faulty.scenario_zero(), faulty.is_switched_off());
        let drive = faulty.node_mut().application_mut();
        drive.faults.zero = zero;
        if is_switched_off {
            drive.set_output(0.0);
        }
        drive.follow();
        truth.observe(now, drive);
    }

    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        let (node, drive) = (self.as_node().next_deadline(), self.device().application());
        match self {
            Self::Sound(_) => earlier(node, Some(drive.next_advance())),
            // Each event advances the plant, and the truth is due more often than that is needed.
            Self::Faulty(_, truth) => {
                earliest([node, drive.next_fault(), Some(truth.next_deadline())])
            }
        }
    }

    pub(crate) fn overhear(&mut self, frame: &CanFrame) {
        if let Self::Faulty(faulty, _) = self {
            faulty.overhear(frame);
        }
    }

    pub(crate) fn next_frame(&mut self) -> Option<CanFrame> {
        let frame = self.as_node_mut().next_frame();
        match self {
            Self::Faulty(_, truth) => frame.or_else(|| truth.next_frame()),
            Self::Sound(_) => frame,
        }
    }
}

/// Parts of a drive, for the start and for a reboot.
pub(crate) struct Parts {
    node_id: NodeId,
    trial: Trial,
    wires: Wires,
    objects: ObjectDictionary,
}

impl Parts {
    pub(crate) fn new(
        plant: &ClockedPlant,
        wires: Wires,
        trial: &Trial,
    ) -> Result<Self, InvalidEmulator> {
        let wiring = &trial.wiring;
        let faults = trial.drive_faults();
        let wrong_id = faults
            .of("wrong_node_id")
            .next()
            .and_then(|fault| u8::try_from(fault.whole("node_id")?).ok());
        let node_id = node_id(wrong_id.unwrap_or(wiring.nodes.drive.id))?;
        let wrong_identity = faults.of("wrong_identity").next();
        let code = wrong_identity.and_then(|fault| fault.whole("product_code"));
        let identity = code.map(|code| Preset::new(IDENTITY, PRODUCT_CODE, code.into()));
        let pace = truth_presets(wiring.loop_number(), wiring.truth_every_cycles());
        let presets = trial.presets().into_iter().chain(pace).chain(identity);
        let presets = presets.chain(drive::first_values(&wires, plant));
        let presets = presets.chain(LoopConfig::default().presets());
        let truth = PlantSignals {
            published: wires.published.iter().map(|one| &one.signal).collect(),
            position: &wires.true_position,
        };
        let objects = node_objects::drive(node_id.get(), Some(truth), presets);
        let name = wiring.shared.device_name(&wiring.nodes.drive.name);
        let objects = node_objects::with_device_name(objects, name);
        Ok(Self {
            node_id,
            trial: trial.clone(),
            wires,
            objects,
        })
    }

    fn device(&self) -> Result<Device<Drive>, InvalidEmulator> {
        let drive = Drive::new(&self.trial, self.wires.clone(), &self.objects)?;
        Ok(Device::new(self.node_id, self.objects.clone(), drive)?)
    }
}
