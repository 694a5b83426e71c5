//! The nodes of the shipped rig, built from a scenario.

use std::sync::Arc;

use ::faults::{FaultKind, FaultPlan, Faulty};
use canopen::Node;
use controller::ControllerNode;
use plant_emulator::{DriveOf, InvalidEmulator, catalogue};
use scenario::loops::{NodesOfLoop, OneLoop};
use scenario::{ControllerView, Scenario};

use crate::error::WorldError;
use crate::names::{CONTROLLER, PLANT_EMULATOR, emulator_name};
use rig::rig_file::LoadedRig;
use rig::setup::Setup;

/// The rig with its drive and its disturbance module.
///
/// # Errors
/// The scenario's plant cannot be emulated.
pub fn plant_emulator(scenario: &Scenario) -> Result<Box<dyn Node>, WorldError> {
    catalogue::emulator(scenario).map_err(|error| no_emulator(PLANT_EMULATOR, error))
}

/// A plant with all drives that move it: those of the loops whose emulator has this name.
///
/// # Errors
/// The plant cannot be emulated.
pub fn plant_emulator_of(setups: &[Setup], name: &str) -> Result<Box<dyn Node>, WorldError> {
    let drives = setups.iter().filter(|setup| emulator_name(setup) == name);
    let scenarios = drives.clone().map(|setup| Scenario {
        seed: setup.place.seed(setup.scenario.seed),
        ..setup.scenario.clone()
    });
    let scenarios = Vec::from_iter(scenarios);
    let drives = scenarios.iter().zip(drives);
    let drives = drives.map(|(scenario, setup)| DriveOf {
        scenario,
        place: setup.place,
        database: &setup.database,
    });
    // The participant of a rig's only plant has no name of its own, but the plant has.
    let plant = scenarios.first().map(|one| one.wiring.plant.as_str());
    let plant = plant.filter(|plant| !plant.is_empty()).unwrap_or(name);
    let made = catalogue::emulator_of(plant, &Vec::from_iter(drives));
    made.map_err(|error| no_emulator(name, error))
}

fn no_emulator(name: &str, error: InvalidEmulator) -> WorldError {
    let name = name.to_owned();
    match error {
        InvalidEmulator::Machine { what, source } => WorldError::NodeNow { name, what, source },
        error => WorldError::Node {
            name,
            reason: error.to_string(),
        },
    }
}

/// What the controller may know of a loop, and of its drive where that is not canrig's.
pub struct LoopView {
    view: OneLoop<ControllerView>,
    rig: Option<Arc<LoadedRig>>,
}

/// What the controller may know of these loops.
#[must_use]
pub fn controller_views(setups: &[Setup]) -> Vec<LoopView> {
    let views = setups.iter().map(|setup| OneLoop {
        name: setup
            .loop_name
            .as_ref()
            .map_or_else(String::new, |names| names.name.clone()),
        place: NodesOfLoop {
            drive: setup.place.drive_node_id,
            io: setup.place.disturbance_node_id,
            truth_every_cycles: setup.place.truth_every_cycles,
        },
        scenario: setup.scenario.controller_view(),
    });
    on_rigs(views.collect(), setups)
}

/// The views with what is known of the drives of these loops, which are the same ones.
#[must_use]
pub fn on_rigs(views: Vec<OneLoop<ControllerView>>, setups: &[Setup]) -> Vec<LoopView> {
    let rigs = setups.iter().map(|setup| setup.rig.clone());
    let views = views.into_iter().zip(rigs);
    views.map(|(view, rig)| LoopView { view, rig }).collect()
}

/// The manager with the laws of these loops.
///
/// # Errors
/// A controller cannot be set up.
pub fn controller_of(loops: &[LoopView]) -> Result<ControllerNode, WorldError> {
    let loops = loops.iter().map(|LoopView { view, rig }| {
        let rig = rig.as_deref().map(|rig| (&rig.file, rig.eds.as_str()));
        (view, rig)
    });
    ControllerNode::of_loops(loops).map_err(|error| WorldError::Node {
        name: CONTROLLER.to_owned(),
        reason: error.to_string(),
    })
}

/// The manager with its control law, for the drive of a rig or the emulated one.
///
/// # Errors
/// The scenario's controller cannot be set up.
pub fn controller(
    view: &ControllerView,
    rig: Option<&LoadedRig>,
) -> Result<ControllerNode, WorldError> {
    let made = match rig {
        Some(loaded) => ControllerNode::on_rig(view, &loaded.file, &loaded.eds),
        None => ControllerNode::new(view),
    };
    made.map_err(|error| WorldError::Node {
        name: CONTROLLER.to_owned(),
        reason: error.to_string(),
    })
}

/// The manager as it behaves where a loop has faults, which it cannot see; `is_played_elsewhere` are those that happen
/// to its process. `make` makes it, also after a crash.
///
/// # Errors
/// It cannot be made.
pub fn faulty_controller(
    make: impl Fn() -> Result<ControllerNode, WorldError> + Send + 'static,
    setups: &[Setup],
    is_played_elsewhere: impl Fn(&FaultKind) -> bool,
) -> Result<Box<dyn Node>, WorldError> {
    let node = make()?;
    let Some(setup) = first_with_faults(setups) else {
        return Ok(Box::new(node));
    };
    let plan = FaultPlan::new(
        &setup.scenario.fault,
        scenario::fault::node::Node::Controller,
    );
    let renew = move |node: &mut ControllerNode| {
        // It could be set up once, so it can again.
        if let Ok(new) = make() {
            *node = new;
        }
    };
    let plan = plan.without(is_played_elsewhere);
    let faulty = Faulty::new(node, plan, &setup.database, renew)?;
    Ok(Box::new(faulty))
}

/// The first loop with faults. Those of the controller are in every loop.
pub(crate) fn first_with_faults(setups: &[Setup]) -> Option<&Setup> {
    setups.iter().find(|setup| !setup.scenario.fault.is_empty())
}
