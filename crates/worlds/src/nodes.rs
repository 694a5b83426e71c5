//! The nodes of the shipped rig, built from a scenario.

use std::sync::Arc;

use ::faults::{FaultKind, FaultPlan, Faulty};
use canopen::Node;
use controller::ControllerNode;
use plant_emulator::plant::InvalidPlant;
use plant_emulator::{DriveOf, InvalidEmulator, catalogue};
use scenario::ControllerView;

use crate::error::WorldError;
use crate::law_process::LawPlace;
use crate::names::emulator_name;
use plan::Plan;
use plan::loaded_drive::LoadedDrive;

/// The emulator of this name: plants with the drives of all loops that it emulates.
///
/// # Errors
/// The plant cannot be emulated.
pub fn plant_emulator(plan: &Plan, name: &str) -> Result<Box<dyn Node>, WorldError> {
    let drives = plan.loops.iter().filter(|one| emulator_name(one) == name);
    let clock = plan.scenario_clock()?;
    let drives = drives.map(|one| DriveOf {
        trial: &one.trial,
        place: one.place,
        database: &one.database,
        clock: &clock,
    });
    let made = catalogue::emulator_of(&Vec::from_iter(drives));
    made.map_err(|error| no_emulator(name, error))
}

fn no_emulator(name: &str, error: InvalidEmulator) -> WorldError {
    let name = name.to_owned();
    match error {
        InvalidEmulator::Plant(InvalidPlant::Machine { what, source }) => {
            WorldError::NodeNow { name, what, source }
        }
        error => WorldError::Node {
            name,
            reason: error.to_string(),
        },
    }
}

/// The part of a plan that the controller may know of one loop, and its drive where that is a real one.
pub struct LoopView {
    view: ControllerView,
    real_drive: Option<Arc<LoadedDrive>>,
}

/// The parts of a plan that the controller may know.
#[must_use]
pub fn controller_views(plan: &Plan) -> Vec<LoopView> {
    let views = plan.loops.iter().map(|one| LoopView {
        view: one.trial.controller_view(),
        real_drive: one.real_drive.clone(),
    });
    views.collect()
}

/// The manager with the laws of these loops; processes of laws run in that place.
///
/// # Errors
/// A controller cannot be set up.
pub fn controller_of(loops: &[LoopView], laws: &LawPlace) -> Result<ControllerNode, WorldError> {
    let loops = loops.iter().map(|LoopView { view, real_drive }| {
        let real = real_drive.as_deref();
        (view, real.map(|drive| (&drive.real, drive.eds.as_str())))
    });
    ControllerNode::of_loops(loops, &|part| laws.start(part)).map_err(|error| WorldError::Node {
        name: laws.controller.clone(),
        reason: error.to_string(),
    })
}

/// The manager as it behaves in a run with faults, which it cannot see; `is_played_elsewhere` are those that happen
/// to its process. `make` makes it, also after a crash.
///
/// # Errors
/// It cannot be made.
pub fn faulty_controller(
    make: impl Fn() -> Result<ControllerNode, WorldError> + Send + 'static,
    plan: &Plan,
    is_played_elsewhere: impl Fn(&FaultKind) -> bool,
) -> Result<Box<dyn Node>, WorldError> {
    let node = make()?;
    if !plan.has_faults() {
        return Ok(Box::new(node));
    }
    let faults = controller_faults(plan);
    let renew = move |node: &mut ControllerNode| {
        // It could be set up once, so it can again.
        if let Ok(new) = make() {
            *node = new;
        }
    };
    let faults = faults.without(is_played_elsewhere);
    let faulty = Faulty::new(node, faults, plan.scenario_clock()?, renew);
    Ok(Box::new(faulty))
}

/// The faults of the controller.
pub(crate) fn controller_faults(plan: &Plan) -> FaultPlan {
    let faults = plan.shared.run.faults.at_controller();
    FaultPlan::new(&faults, plan.controller().id)
}
