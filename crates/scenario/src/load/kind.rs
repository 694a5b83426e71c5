//! Recognises the intended kind of a file by its tables: each kind has tables that the other has not.

use crate::document::Document;
use crate::error::Problem;

/// Checks whether the document is meant as a rig file.
pub(super) fn is_rig(document: &Document<'_>) -> bool {
    let tables = ["node", "loop", "defaults", "drive", "limits"];
    let is_scenario = document.has("controller") || document.has("rig");
    tables.iter().any(|table| document.has(table)) && !is_scenario
}

/// Checks whether the document is meant as a scenario.
pub(crate) fn is_scenario(document: &Document<'_>) -> bool {
    let keys = ["controller", "rig", "duration_seconds", "reference"];
    keys.iter().any(|key| document.has(key))
}

/// Finds a table at the top of a rig file that belongs to a drive: a drive is a node of a rig file.
pub(super) fn drive_without_node(document: &Document<'_>) -> Option<Problem> {
    let tables = ["drive", "limits", "timeouts", "preflight"];
    let table = tables.into_iter().find(|table| document.has(table))?;
    let message = "a drive is a node of a rig file";
    let label = match table {
        "drive" => "write [node.NAME] with kind = \"drive\"".to_owned(),
        table => format!("write [node.NAME.{table}]"),
    };
    let problem = document.key_problem(table, message, label);
    Some(problem.with_help(
        "a real drive has `limits` in its node; the rig names a controller and a loop besides",
    ))
}
