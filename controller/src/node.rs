//! The controller as a node of the bus: NMT manager, SYNC producer, and the cycle of the laws.
//!
//! A SYNC makes the drives sample; the TPDO1 of each brings its sample; the law's command leaves in RPDO1 and acts with the
//! next SYNC: one cycle of delay. Scenario time 0 is the first SYNC after every drive's latest statusword said Operation
//! enabled.
//!
//! [`sequence`] leads from the search for the drives to their stop, [`control_loop`] is what runs in between, [`drive`] is
//! what each loop moves, and [`application`] is what calls them.

mod application;
mod control_loop;
mod drive;
mod phase;
mod sequence;
mod statistics;
#[cfg(test)]
mod tests;
mod together;

use std::ops::RangeInclusive;
use std::time::Duration;

use canopen::object_dictionary::Entry;
use canopen::{CanFrame, Device, Filter, Node, ObjectDictionary, Progress, nmt::NodeId};
use dbc::LawTerm;
use scenario::ControllerView;
use scenario::controller::OpenLoop as ProfileOfNone;
use scenario::law_ports::terms_of;
use scenario::loops::OneLoop;
use scenario::plant::SMA_ACTUATOR;
use scenario::port::Unit;
use scenario::rig::drive::DriveLayout;
use scenario::rig::limits::LimitWatch;
use scenario::rig::{Limits, RigDrive, RigFile, Timeouts};

use crate::catalogue;
use crate::error::ControllerError;
use crate::explanation::{self, ExplanationObjects};
use crate::law::Law;
use crate::law_with_ports::{Ports, WiredLaw};
use crate::node_ids::{CONTROLLER, DISTURBANCE};
use crate::open_loop::OpenLoop;
use crate::plausibility::Plausibility;
use control_loop::ControlLoop;
pub use drive::ENABLE_TIME;
use drive::LedDrive;
use phase::Phase;
use sequence::{CONSUMER_HEARTBEAT_TIME, Controller, IO_WATCH_ENTRY, watch_entry};
pub use statistics::Statistics;
use together::Together;

/// The parameters of SDO clients (CiA 301, 7.5.2.33).
const SDO_CLIENTS: RangeInclusive<u16> = 0x1280..=0x12FF;

/// The controller.
#[derive(Debug)]
pub struct ControllerNode {
    device: Device<Controller>,
}

impl ControllerNode {
    /// A controller for what it may know of a scenario.
    ///
    /// # Errors
    /// The scenario selects no law, or an EDS does not fit.
    pub fn new(view: &ControllerView) -> Result<Self, ControllerError> {
        let plan = LoopPlan::emulated(view, RigDrive::default().node_id)?;
        Self::leading(vec![plan], vec![DISTURBANCE])
    }

    /// As [`ControllerNode::new`], for several loops, each with a drive of its own: an emulated one, or that of a rig file with
    /// its EDS, whose limits it obeys.
    ///
    /// # Errors
    /// As [`ControllerNode::new`].
    pub fn of_loops<'a>(
        loops: impl IntoIterator<Item = (&'a OneLoop<ControllerView>, Option<(&'a RigFile, &'a str)>)>,
    ) -> Result<Self, ControllerError> {
        let mut plans = Vec::new();
        let mut io_nodes = Vec::new();
        for (one, rig) in loops {
            plans.push(match rig {
                Some((rig, eds)) => LoopPlan::on_rig(&one.scenario, rig, eds)?,
                None => LoopPlan::emulated(&one.scenario, one.place.drive)?,
            });
            if let Some(id) = one.place.io {
                io_nodes.push(NodeId::new(id).ok_or(ControllerError::NodeId(id))?);
            }
        }
        Self::leading(plans, io_nodes)
    }

    /// As [`ControllerNode::new`], for the drive of a rig file, whose limits it obeys.
    ///
    /// # Errors
    /// As [`ControllerNode::new`].
    pub fn on_rig(
        view: &ControllerView,
        rig: &RigFile,
        drive_eds: &str,
    ) -> Result<Self, ControllerError> {
        let view = ControllerView {
            bus: rig.bus.of_scenario(),
            ..view.clone()
        };
        let fan = rig.fan.node_id;
        let fan = NodeId::new(fan).ok_or(ControllerError::NodeId(fan))?;
        let plan = LoopPlan::on_rig(&view, rig, drive_eds)?;
        Self::leading(vec![plan], vec![fan])
    }

    fn leading(plans: Vec<LoopPlan<'_>>, io_nodes: Vec<NodeId>) -> Result<Self, ControllerError> {
        let sync_period = plans[0].view.bus.sync_period();
        // All are begun at once, when the last is ready.
        let bring_up = plans.iter().map(|plan| plan.timeouts.bring_up());
        let bring_up = bring_up.max().unwrap_or_default();
        let together = law_of_all(&plans)?;
        let laws = plans.iter().map(|plan| match together {
            Some(_) => Ok(Law::of::<OpenLoop>(&ProfileOfNone::default())),
            None => catalogue::law(&plan.view.controller),
        });
        let laws = laws.collect::<Result<Vec<_>, _>>()?;
        let terms = laws.iter().zip(&plans).map(|(law, plan)| match &together {
            Some(together) => terms_of_loop(together.ports(), plan.view),
            None => law.terms(),
        });
        let terms = Vec::from_iter(terms);
        let drives = plans.iter().map(|plan| plan.drive.node_id());
        let dictionary = dictionary(&terms, &Vec::from_iter(drives), &io_nodes)?;
        let further = further_drives(&plans);
        let loops = plans.into_iter().zip(laws).enumerate();
        let loops = loops.map(|(place, (plan, law))| {
            let view = plan.view;
            let is_wire = view.plant == SMA_ACTUATOR;
            let unit = &view.wiring.unit;
            Ok(ControlLoop {
                drive: LedDrive::new(
                    plan.drive,
                    sync_period,
                    &plan.timeouts,
                    plan.limits
                        .map(|limits| LimitWatch::new(limits, sync_period).in_unit(unit)),
                    Plausibility::new(&view.wiring, is_wire),
                ),
                law_units_per_metre: match unit {
                    Unit::Millimetres => 1.0,
                    _ => 1e3,
                },
                missing_max: plan.timeouts.missing_positions_cycles.into(),
                trajectory: view.reference.trajectory(),
                has_set_point: !view.reference.is_empty(),
                explanation: ExplanationObjects::find(&dictionary, terms[place].len(), place)?,
                law,
                further: further[place].clone(),
                is_led: view.wiring.led_by.is_some() || together.is_some(),
                sync_period,
                has_position: false,
                position_metres: f64::NAN,
                missing: 0,
            })
        });
        let controller = Controller {
            loops: loops.collect::<Result<_, ControllerError>>()?,
            together: together.map(Together::new),
            io_nodes,
            sync_period,
            bring_up,
            phase: Phase::Off,
            failure: None,
            statistics: Statistics::default(),
        };
        let device = Device::new(CONTROLLER, dictionary, controller)?;
        Ok(Self { device })
    }

    /// What has been counted since the start of the scenario.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.device.application().statistics
    }
}

/// The law with ports that leads all loops, wired to them; none where each has its own.
fn law_of_all(plans: &[LoopPlan<'_>]) -> Result<Option<WiredLaw>, ControllerError> {
    let mut found = plans.iter().filter_map(|plan| {
        let law = catalogue::joint_law(&plan.view.controller)?;
        Some((law, &plan.view.wiring.loops))
    });
    let Some((law, loops)) = found.next() else {
        return Ok(None);
    };
    Ok(Some(WiredLaw::new(law?, loops)?))
}

/// What a law of all loops publishes for one of them.
fn terms_of_loop(ports: &Ports, view: &ControllerView) -> Vec<LawTerm> {
    let Some(own) = view.wiring.own_loop() else {
        return Vec::new();
    };
    let terms = terms_of(ports, own);
    let terms = terms.map(|(name, port)| LawTerm {
        name: name.to_owned(),
        unit: port.symbol.clone(),
        comment: port.comment.clone(),
    });
    terms.collect()
}

/// For each loop the places of those that stand for the further drives which its law leads, in their order.
fn further_drives(plans: &[LoopPlan<'_>]) -> Vec<Vec<usize>> {
    let of_leader = |leader: &LoopPlan<'_>| {
        let own_id = leader.drive.node_id().get();
        let led = plans.iter().enumerate().filter_map(|(place, plan)| {
            let by = plan.view.wiring.led_by?;
            (by.first == own_id).then_some((by.place, place))
        });
        let mut led = Vec::from_iter(led);
        led.sort_unstable();
        Vec::from_iter(led.into_iter().map(|(_, place)| place))
    };
    plans.iter().map(of_leader).collect()
}

/// A loop that is to be closed.
struct LoopPlan<'a> {
    view: &'a ControllerView,
    drive: DriveLayout,
    /// The rig's.
    limits: Option<&'a Limits>,
    timeouts: Timeouts,
}

impl<'a> LoopPlan<'a> {
    fn emulated(view: &'a ControllerView, node_id: u8) -> Result<Self, ControllerError> {
        let mut rig = RigDrive {
            node_id,
            ..RigDrive::default()
        };
        rig.position.units_per_millimetre = view.wiring.unit.counts();
        let dictionary = dbc::dictionary(dbc::DRIVE_EDS, node_id)?;
        Ok(Self {
            view,
            drive: DriveLayout::emulated(dictionary, &rig)?,
            limits: None,
            timeouts: Timeouts::default(),
        })
    }

    fn on_rig(
        view: &'a ControllerView,
        rig: &'a RigFile,
        drive_eds: &str,
    ) -> Result<Self, ControllerError> {
        let dictionary = dbc::dictionary(drive_eds, rig.drive.node_id)?;
        Ok(Self {
            view,
            drive: DriveLayout::new(dictionary, &rig.drive, rig.limits.current_amperes)?,
            limits: Some(&rig.limits),
            timeouts: rig.timeouts,
        })
    }
}

/// The parameters of an SDO client for each of these nodes, to which the controller talks, in place of those of the shipped rig.
fn with_clients(
    shipped: &ObjectDictionary,
    servers: impl Iterator<Item = NodeId>,
) -> ObjectDictionary {
    let mut dictionary = ObjectDictionary::new();
    let (clients, others): (Vec<_>, Vec<_>) =
        (shipped.entries().iter()).partition(|entry| SDO_CLIENTS.contains(&entry.index));
    others
        .into_iter()
        .for_each(|entry| dictionary.insert(entry.clone()));
    let mut once = Vec::new();
    for server in servers {
        if !once.contains(&server) {
            once.push(server);
        }
    }
    for (index, server) in SDO_CLIENTS.zip(once) {
        let id = server.get();
        let first = clients.iter();
        let first = first.filter(|entry| entry.index == *SDO_CLIENTS.start());
        for entry in first {
            let default = match entry.sub_index {
                1 => (0x600 + u32::from(id)).to_le_bytes().to_vec(),
                2 => (0x580 + u32::from(id)).to_le_bytes().to_vec(),
                3 => vec![id],
                _ => entry.default.clone(),
            };
            let (name, data_type, access) = (&entry.name, entry.data_type, entry.access);
            let twin = Entry::new(index, entry.sub_index, name, data_type, access, default);
            dictionary.insert(twin);
        }
    }
    dictionary
}

/// The controller's objects, with those that explain the law of each loop, by its own terms.
fn dictionary(
    laws: &[Vec<LawTerm>],
    drives: &[NodeId],
    io_nodes: &[NodeId],
) -> Result<ObjectDictionary, ControllerError> {
    let shipped = dbc::dictionary(dbc::CONTROLLER_EDS, CONTROLLER.get())?;
    let servers = drives.iter().chain(io_nodes).copied();
    let mut dictionary = with_clients(&shipped, servers);
    // Checked here, since it is written only when the drives are configured.
    let watch = dictionary.find(CONSUMER_HEARTBEAT_TIME, watch_entry(0));
    let watch = watch.map_err(|_| ControllerError::NoObject(CONSUMER_HEARTBEAT_TIME))?;
    let watch = dictionary.entry(watch).clone();
    for (place, terms) in laws.iter().enumerate() {
        explanation::declare(&mut dictionary, &shipped, terms, place);
        let mut entry = watch.clone();
        entry.sub_index = watch_entry(place);
        dictionary.insert(entry);
    }
    if laws.len() > 1 {
        let count = watch_entry(laws.len() - 1);
        explanation::set_default(&mut dictionary, CONSUMER_HEARTBEAT_TIME, 0, &[count]);
        // The data sheet watches the module of the shipped rig, whose node-ID may be a drive's here.
        let time = dictionary.unsigned(CONSUMER_HEARTBEAT_TIME, IO_WATCH_ENTRY);
        let time = time.unwrap_or_default() & u32::from(u16::MAX);
        let watch = io_nodes
            .first()
            .map_or(0, |id| u32::from(id.get()) << 16 | time);
        let watch = watch.to_le_bytes();
        explanation::set_default(
            &mut dictionary,
            CONSUMER_HEARTBEAT_TIME,
            IO_WATCH_ENTRY,
            &watch,
        );
    }
    Ok(dictionary)
}

impl Node for ControllerNode {
    /// NMT, SYNC and EMCY, the TPDO1 of each drive, SDO, and heartbeats. The emulator's truth (TPDO2) is not among them.
    fn filters(&self) -> Vec<Filter> {
        let function = |id| Filter {
            mask: Filter::exact(0).mask & !0x7F,
            ..Filter::exact(id)
        };
        let drives = self.device.application().drives();
        let feedback = drives.map(|drive| Filter::exact(drive.layout.feedback_id()));
        let before = [Filter::exact(0x000), function(0x080)];
        let behind = [
            function(0x580),
            function(0x600),
            function(0x700),
            Filter::ERRORS,
        ];
        before.into_iter().chain(feedback).chain(behind).collect()
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.device.on_frame(now, frame);
    }

    fn on_tick(&mut self, now: Duration) {
        self.device.on_tick(now);
    }

    fn on_stop(&mut self, now: Duration) {
        self.device.on_stop(now);
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.device.next_frame()
    }

    fn next_deadline(&self) -> Option<Duration> {
        self.device.next_deadline()
    }

    fn progress(&self) -> Progress {
        self.device.progress()
    }
}
