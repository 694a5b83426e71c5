//! Which kind of file a document is meant as: no kind has the tables of another one.

use crate::document::Document;
use crate::error::Problem;

/// A rig file.
pub(super) fn is_rig(document: &Document<'_>) -> bool {
    let tables = ["node", "loop", "defaults", "drive", "limits"];
    let is_scenario = document.has("controller") || document.has("rig");
    tables.iter().any(|table| document.has(table)) && !is_scenario
}

/// A scenario.
pub(crate) fn is_scenario(document: &Document<'_>) -> bool {
    let keys = ["controller", "rig", "duration_seconds", "reference"];
    keys.iter().any(|key| document.has(key))
}

/// A table in which a rig file of a single drive might be expected to have it: a drive is a node of a rig file.
pub(super) fn drive_without_node(document: &Document<'_>) -> Option<Problem> {
    let tables = ["drive", "limits", "timeouts", "preflight"];
    let table = tables.into_iter().find(|table| document.has(table))?;
    let span = document.key_span(table);
    let message = "a drive is a node of a rig file";
    let label = match table {
        "drive" => "write [node.NAME] with kind = \"drive\"".to_owned(),
        table => format!("write [node.NAME.{table}]"),
    };
    let problem = document.source.problem(span, message, label);
    Some(problem.with_help(
        "a real drive has `limits` in its node; the rig names a controller and a loop besides",
    ))
}
