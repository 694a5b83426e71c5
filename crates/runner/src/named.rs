//! Arguments that name the nodes on a bus: a rig file, a scenario, or the folder of a run.

use std::path::Path;

use scenario::node::Node;
use scenario::rig::nodes::Rig;
use scenario::{Scenario, read_sheet};

use crate::exit::{Exit, Failure};
use crate::play::ValueArgs;
use crate::recorded::{read_played, require_inside, unreadable};
use crate::scenarios::{load, rig_text};
use plan::named_nodes::{NamedNodes, node_sheets};
use plan::{FILE_BYTES_MAX, Plan};
use recording::run_folder::file;
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

/// Returns the nodes of that bus, each with the text of its EDS. A run has written them; a recording does not have the plants and
/// laws on which they depend.
///
/// # Errors
/// The file or the folder is not valid, or an EDS of the run cannot be read.
pub fn named_sheets(path: &Path) -> Result<Vec<(Node, String)>, Failure> {
    let plan = named_plan(path)?;
    Ok(written_sheets(path, &plan)?.unwrap_or_else(|| node_sheets(&plan)))
}

/// Returns the nodes of that bus as tools know them.
///
/// # Errors
/// As [`named_sheets`].
pub fn named_nodes(path: &Path) -> Result<NamedNodes, Failure> {
    let plan = named_plan(path)?;
    match written_sheets(path, &plan)? {
        Some(sheets) => {
            let nodes = NamedNodes::of_run(&plan, &sheets);
            nodes.map_err(|error| Exit::CannotStart.because(error))
        }
        None => Ok(NamedNodes::of(&plan)),
    }
}

/// Returns the EDS of each node that a run has written, in the order of the node-IDs; `None` for other paths, and for a run that has
/// not written all.
fn written_sheets(path: &Path, plan: &Plan) -> Result<Option<Vec<(Node, String)>>, Failure> {
    if !path.is_dir() {
        return Ok(None);
    }
    let mut nodes = Vec::from_iter(plan.rig_nodes().map(|(_, node)| node));
    nodes.sort_by_key(|node| node.id());
    let mut sheets = Vec::new();
    for node in nodes {
        let name = format!("{}/{}.eds", file::SHEETS, node.name);
        let place = require_inside(path, &name)?;
        if !place.exists() {
            return Ok(None);
        }
        let text = read_sheet(&place, FILE_BYTES_MAX).map_err(unreadable(&place))?;
        sheets.push((node.clone(), text));
    }
    Ok(Some(sheets))
}
