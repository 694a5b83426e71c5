//! The nodes of a rig, built from a plan.

use std::sync::Arc;

use ::faults::Faulty;
use can::Node;
use controller::{ControllerNode, controller_node_of_loops};
use plant_emulator::plant::InvalidPlant;
use plant_emulator::{InvalidEmulator, catalogue};
use scenario::ControllerView;
use scenario::fault::Actor;

use crate::error::WorldError;
use crate::law_process::LawPlace;
use crate::names::emulator_name;
use crate::programs::faults_at;
use plan::loaded_drive::LoadedDrive;
use plan::{ControlLoop, Plan};

/// Makes the emulator of this name: plants with the drives of all loops that it emulates.
///
/// # Errors
/// If the plant cannot be emulated.
pub fn plant_emulator(plan: &Plan, name: &str) -> Result<Box<dyn Node>, WorldError> {
    let is_its = |one: &&ControlLoop| one.drive().is_ours() && emulator_name(one) == name;
    let drives = plan.loops.iter().filter(is_its);
    let loops = Vec::from_iter(drives.map(|one| &one.trial));
    match catalogue::joint_emulator(&loops, plan.database()) {
        Ok(emulator) => Ok(Box::new(emulator)),
        Err(InvalidEmulator::Plant(InvalidPlant::Machine { what, source })) => {
            Err(WorldError::CannotBegin {
                what: format!("the {name} cannot be set up: {what}: {source}"),
                source: Some(source),
            })
        }
        Err(error) => Err(WorldError::set_up(name, &error)),
    }
}

/// Part of a plan that the controller may know of one loop, with its drive if that is a real one.
type LoopView = (ControllerView, Option<Arc<LoadedDrive>>);

/// Returns the parts of a plan that the controller may know.
pub fn controller_views(plan: &Plan) -> Vec<LoopView> {
    let loops = plan.loops.iter();
    loops
        .map(|one| (one.trial.controller_view(), one.real_drive.clone()))
        .collect()
}

/// Makes the manager with the laws of these loops; `laws` is the place of their processes.
///
/// # Errors
/// If a controller cannot be set up.
pub fn make_controller(loops: &[LoopView], laws: &LawPlace) -> Result<ControllerNode, WorldError> {
    let loops = loops.iter().map(|(view, real_drive)| {
        let real = real_drive.as_deref();
        (view, real.map(|drive| (&drive.real, &drive.layout)))
    });
    controller_node_of_loops(loops, &|law| laws.start(law))
        .map_err(|error| WorldError::set_up(&laws.controller, &error))
}

/// Makes the manager with its faults, which it cannot see; `laws` is the place of its laws' processes. In real time the bench
/// causes crash and hang, from outside the process.
///
/// # Errors
/// If it cannot be made.
pub fn faulty_controller(plan: &Plan, laws: LawPlace) -> Result<Box<dyn Node>, WorldError> {
    let views = controller_views(plan);
    let node = make_controller(&views, &laws)?;
    if !plan.has_faults() {
        return Ok(Box::new(node));
    }
    let mut faults = faults_at(plan, plan.nodes.manager());
    if laws.is_real_time {
        let planned = &mut faults.faults;
        planned.retain(|one| one.fault.kind.actor != Actor::Process);
    }
    let renew = move |node: &mut ControllerNode| {
        // The first call succeeded, so this one does.
        if let Ok(new) = make_controller(&views, &laws) {
            *node = new;
        }
    };
    let faulty = Faulty::new(node, faults, plan.scenario_clock()?, renew);
    Ok(Box::new(faulty))
}
