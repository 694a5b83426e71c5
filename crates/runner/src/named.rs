//! Arguments that name the nodes on a bus: a rig file, a scenario, or the folder of a run.

use std::path::Path;

use scenario::Scenario;
use scenario::rig::nodes::Rig;

use crate::exit::Failure;
use crate::play::ValueArgs;
use crate::recorded::read_played;
use crate::scenarios::{load, rig_text};
use plan::Plan;
use worlds::catalogue::catalogue;

/// Returns the plan of that bus.
///
/// # Errors
/// The file or the folder is not valid.
pub fn named_plan(path: &Path) -> Result<Plan, Failure> {
    if path.is_dir() {
        return Ok(read_played(path, catalogue())?.0);
    }
    match rig_text(path) {
        // A file that is not clearly a scenario is meant as a rig.
        Ok(text) if Rig::is_meant(&text) || !Scenario::may_be(&text) => {
            Ok(Plan::from_rig(path, &text, catalogue())?)
        }
        // A path that cannot be read may be the name of a scenario that ships.
        _ => load(path, &ValueArgs::default()),
    }
}
