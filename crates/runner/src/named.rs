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
    match rig_text(path) {
        // A file that is not clearly a scenario is meant as a rig.
        Ok(text) if Rig::is_meant(&text) || !Scenario::may_be(&text) => {
            Plan::from_rig(path, &text, catalogue()).map_err(invalid)
        }
        // A path that cannot be read may be the name of a scenario that ships.
        _ => load(path, &ValueArgs::default()),
    }
}
