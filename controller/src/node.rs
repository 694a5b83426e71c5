//! The controller as a node of the bus: NMT manager, SYNC producer, and the cycle of the laws.
//!
//! A SYNC makes the drives sample. The TPDO1 of each carries its sample. The law's command leaves in RPDO1 and acts
//! with the next SYNC: one cycle of delay. Scenario time 0 is the first SYNC after every drive's latest statusword was
//! Operation enabled.
//!
//! [`sequence`] leads from the search for the drives to their stop; [`control_loop`] and [`leading_law`] run in
//! between. [`drive`] has the drive of each loop, and [`application`] calls all of them.

mod application;
mod control_loop;
mod drive;
mod leading_law;
mod phase;
mod sequence;
#[cfg(test)]
mod tests;

use canopen::Device;
use canopen::nmt::NodeId;
use dbc::node_objects;
use scenario::ControllerView;
use scenario::rig::drive::DriveLayout;
use scenario::rig::{Limits, RealDrive, Timeouts};

use crate::catalogue;
use crate::error::ControllerError;
use crate::law::AnyLaw;
use crate::process_law::{StartPlayer, no_player};
use control_loop::ControlLoop;
pub use drive::ENABLE_TIME;
use drive::LedDrive;
use leading_law::{LeadingLaw, Seen};
use phase::Phase;
pub use sequence::Leader;

/// The controller as a node.
pub type ControllerNode = Device<Leader>;

/// Makes a controller from the part of a scenario that it may know.
///
/// # Errors
/// The scenario selects no law, or an EDS does not fit.
pub fn controller_node(view: &ControllerView) -> Result<ControllerNode, ControllerError> {
    controller_node_of_loops([(view, None)], &no_player)
}

/// Works as [`controller_node`], for several loops with their drives: emulated ones, or real ones with their layouts,
/// whose limits the controller obeys. `start` starts the processes that play laws.
///
/// # Errors
/// As [`controller_node`].
pub fn controller_node_of_loops<'a>(
    loops: impl IntoIterator<Item = (&'a ControllerView, Option<(&'a RealDrive, &'a DriveLayout)>)>,
    start: StartPlayer<'_>,
) -> Result<ControllerNode, ControllerError> {
    let mut plans = Vec::new();
    for (view, real_drive) in loops {
        plans.push(LoopPlan::new(view, real_drive)?);
    }
    let io = plans[0].view.wiring.shared.io.iter();
    let io_nodes = io
        .map(|io| node_id(plans[0].view.wiring.node(io.node).id()))
        .collect::<Result<_, _>>()?;
    Leader::leading(plans, io_nodes, start)
}

impl Leader {
    fn leading(
        plans: Vec<LoopPlan<'_>>,
        io_nodes: Vec<NodeId>,
        start: StartPlayer<'_>,
    ) -> Result<ControllerNode, ControllerError> {
        let view = plans[0].view;
        let own_id = node_id(view.wiring.controller().id())?;
        let sync_period = view.bus.sync_period();
        // All drives begin together, when the last one is ready.
        let bring_ups = plans.iter().map(|plan| plan.timeouts.bring_up());
        let bring_up = bring_ups.max().unwrap_or_default();
        let mut laws = laws_of(&plans)?;
        let mut terms = vec![Vec::new(); plans.len()];
        for (law, places) in &mut laws {
            let started = law.start(sync_period, start);
            started.map_err(ControllerError::Other)?;
            // A law of one loop publishes its terms there, not for its further drives.
            let loops = law.drives().map_or(places.len(), |_| 1);
            for place in &places[..loops] {
                terms[*place] = law.terms(&plans[*place].view.wiring);
            }
        }
        let drives = plans.iter().map(|plan| plan.drive.node_id.get());
        let io_ids = io_nodes.iter().map(|node| node.get());
        let identifiers = plans.iter().map(|plan| plan.view.wiring.identifiers.terms);
        let terms = Vec::from_iter(terms.into_iter().zip(identifiers));
        let dictionary = node_objects::controller(
            own_id.get(),
            &terms,
            &Vec::from_iter(drives),
            &Vec::from_iter(io_ids),
        );
        let name = view
            .wiring
            .shared
            .device_name(&view.wiring.controller().name);
        let dictionary = node_objects::with_device_name(dictionary, name);
        let leading = laws.into_iter().map(|(law, places)| {
            let wiring = &plans[places[0]].view.wiring;
            LeadingLaw::new(law, places, wiring, &dictionary)
        });
        let laws = leading.collect::<Result<_, ControllerError>>()?;
        let follows = plans
            .iter()
            .map(|plan| followed_place(&plans, plan))
            .collect::<Result<Vec<_>, _>>()?;
        let loops = plans.into_iter().zip(follows).map(|(plan, follows)| {
            let view = plan.view;
            ControlLoop {
                missing_max: plan.timeouts.missing_positions_cycles.into(),
                drive: LedDrive::new(plan, own_id, sync_period),
                trajectory: view.reference.trajectory(),
                has_set_point: !view.reference.is_empty(),
                sync_period,
                follows,
                has_position: false,
                has_sample: false,
                seen: Seen::default(),
                scenario_time_seconds: 0.0,
                missing: 0,
            }
        });
        let leader = Self {
            loops: loops.collect(),
            laws,
            io_nodes,
            sync_period,
            bring_up,
            phase: Phase::Off,
            failure: None,
        };
        Ok(Device::new(own_id, dictionary, leader)?)
    }
}

/// Converts a number to a node-ID.
fn node_id(number: u8) -> Result<NodeId, ControllerError> {
    NodeId::new(number).ok_or_else(|| ControllerError::Other(format!("{number} is no node-ID")))
}

/// Returns the laws, each with the indices of the loops that it leads: one law for all loops, or one for each loop with
/// its further drives.
fn laws_of(plans: &[LoopPlan<'_>]) -> Result<Vec<(AnyLaw, Vec<usize>)>, ControllerError> {
    let mut laws = Vec::new();
    let leaders = plans.iter().enumerate();
    for (place, plan) in leaders.filter(|(_, plan)| plan.view.wiring.led_by.is_none()) {
        let law = catalogue::law(&plan.view.controller, &plan.view.wiring)?;
        if law.drives().is_none() {
            return Ok(vec![(law, (0..plans.len()).collect())]);
        }
        let places = [place].into_iter().chain(further_drives(plans, plan));
        laws.push((law, places.collect()));
    }
    Ok(laws)
}

/// Returns the index of the loop whose drive measures the position that a loop follows.
fn followed_place(plans: &[LoopPlan<'_>], of: &LoopPlan<'_>) -> Result<usize, ControllerError> {
    let followed = of.view.wiring.followed_drive().id();
    let mut drives = plans.iter().map(|plan| plan.drive.node_id.get());
    let place = drives.position(|drive| drive == followed);
    place.ok_or_else(|| {
        ControllerError::Other(format!(
            "a loop follows the drive with node-ID {followed}, which the controller does not lead"
        ))
    })
}

/// Returns the indices of the loops of a leader's further drives, in their order.
fn further_drives(plans: &[LoopPlan<'_>], leader: &LoopPlan<'_>) -> Vec<usize> {
    let leading = &leader.view.wiring.loop_name;
    let led = plans.iter().enumerate().filter_map(|(place, plan)| {
        let by = plan.view.wiring.led_by.as_ref()?;
        (by.loop_name == *leading).then_some((by.place, place))
    });
    let mut led = Vec::from_iter(led);
    led.sort_unstable();
    led.into_iter().map(|(_, place)| place).collect()
}

/// Plan of a loop.
struct LoopPlan<'a> {
    view: &'a ControllerView,
    drive: DriveLayout,
    /// Limits of a real drive.
    limits: Option<&'a Limits>,
    timeouts: Timeouts,
}

impl<'a> LoopPlan<'a> {
    /// Makes the plan of a loop with a real drive, or with the emulated one.
    fn new(
        view: &'a ControllerView,
        real_drive: Option<(&'a RealDrive, &DriveLayout)>,
    ) -> Result<Self, ControllerError> {
        let drive = match real_drive {
            Some((_, layout)) => layout.clone(),
            None => {
                let emulated = RealDrive::emulated(&view.wiring);
                DriveLayout::new(
                    dbc::dictionary(dbc::DRIVE_EDS, emulated.node_id)?,
                    &emulated,
                )?
            }
        };
        let timeouts = real_drive.map(|(real, _)| real.timeouts);
        Ok(Self {
            view,
            drive,
            limits: real_drive.map(|(real, _)| &real.limits),
            timeouts: timeouts.unwrap_or_default(),
        })
    }
}
