//! The nodes of the shipped rig, built from a scenario.

use ::faults::{FaultKind, FaultPlan, Faulty};
use canopen::Node;
use controller::ControllerNode;
use dbc::Database;
use plant_emulator::catalogue;
use scenario::fault::Faults;
use scenario::{ControllerView, Scenario};

use crate::error::WorldError;
use rig::rig_file::LoadedRig;

/// Names of the nodes, for messages and for the command line of their processes.
pub(crate) const CONTROLLER: &str = "controller";
pub(crate) const PLANT_EMULATOR: &str = "plant-emulator";
pub(crate) const BENCH: &str = "bench";
/// What the plant emulator plays, and a real one is.
pub(crate) const DRIVE: &str = "drive";

/// The rig with its drive and its disturbance module.
///
/// # Errors
/// The scenario's plant cannot be emulated.
pub fn plant_emulator(scenario: &Scenario) -> Result<Box<dyn Node>, WorldError> {
    catalogue::emulator(scenario).map_err(|error| WorldError::Node {
        name: PLANT_EMULATOR.to_owned(),
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

/// The manager as it behaves in a scenario with faults, which it cannot see; `is_played_elsewhere` are those that happen
/// to its process. `make` makes it, also after a crash.
///
/// # Errors
/// It cannot be made.
pub fn faulty_controller(
    make: impl Fn() -> Result<ControllerNode, WorldError> + Send + 'static,
    faults: &Faults,
    is_played_elsewhere: impl Fn(&FaultKind) -> bool,
) -> Result<Box<dyn Node>, WorldError> {
    let node = make()?;
    if faults.is_empty() {
        return Ok(Box::new(node));
    }
    let plan = FaultPlan::new(faults, scenario::fault::node::Node::Controller);
    let renew = move |node: &mut ControllerNode| {
        // It could be set up once, so it can again.
        if let Ok(new) = make() {
            *node = new;
        }
    };
    let plan = plan.without(is_played_elsewhere);
    let faulty = Faulty::new(node, plan, Database::shipped(), renew)?;
    Ok(Box::new(faulty))
}
