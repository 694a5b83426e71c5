//! Arguments that name the nodes on a bus: a rig file, a scenario, or the folder of a run.

use std::path::Path;

use scenario::Scenario;
use scenario::rig::nodes::Rig;

use crate::console::invalid;
use crate::exit::Exit;
use crate::play::ValueArgs;
use crate::recorded::{read_played, refuse};
use crate::scenarios::{load, rig_text};
use plan::Plan;
use worlds::catalogue::catalogue;

/// Returns the plan of that bus, or prints the error.
///
/// # Errors
/// The exit code for the error.
pub fn named_plan(path: &Path) -> Result<Plan, Exit> {
    if path.is_dir() {
        let played = read_played(path, catalogue()).map_err(refuse)?;
        return Ok(played.0);
    }
    // A path that cannot be read may be the name of a scenario that ships.
    let Ok(text) = rig_text(path) else {
        return load(path, &ValueArgs::default());
    };
    // A file that is not clearly a scenario is meant as a rig.
    if Rig::is_meant(&text) || !Scenario::may_be(&text) {
        return Plan::from_rig(path, &text, catalogue()).map_err(invalid);
    }
    load(path, &ValueArgs::default())
}
