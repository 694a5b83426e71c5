//! Which kind of file a document is meant as: no kind has the tables of another one.

use crate::document::Document;

/// A rig file of schema 1.
pub(super) fn is_rig_of_one_drive(document: &Document<'_>) -> bool {
    has_one_of(document, &["limits", "drive", "timeouts", "preflight"])
}

/// A rig file of schema 2.
pub(super) fn is_rig_of_nodes(document: &Document<'_>) -> bool {
    has_one_of(document, &["node", "loop"])
}

fn has_one_of(document: &Document<'_>, tables: &[&str]) -> bool {
    tables.iter().any(|table| document.has(table)) && !document.has("controller")
}
