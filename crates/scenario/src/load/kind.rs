//! Recognises the intended kind of a file by its tables: each kind has tables that the other has not.

use crate::document::Document;
use crate::error::{Problem, Source};

/// Tables of a rig file.
const OF_RIG: [&str; 5] = ["node", "loop", "defaults", "drive", "limits"];
/// Keys of a scenario that no rig file has.
const OF_SCENARIO: [&str; 4] = ["controller", "rig", "duration_seconds", "reference"];
/// Key of every file of canrig, and the table of a sweep.
const SCHEMA: &str = "schema";
const SWEEP: &str = "sweep";

/// Intended kind of a file, by its text alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A scenario, right or wrong.
    Scenario,
    /// A scenario with a sweep.
    Sweep,
    /// A rig file.
    Rig,
    /// Not a file of canrig, or nothing that can be told.
    Other,
}

impl FileKind {
    /// Returns the kind of a file with this text. If the text is not TOML, its lines decide, so that a scenario with a wrong
    /// character remains one.
    pub fn of(text: &str) -> Self {
        match Document::parse(Source::new("", text), text) {
            Ok(document) if is_rig(&document) => Self::Rig,
            Ok(document) if is_scenario(&document) || document.has(SCHEMA) => {
                Self::scenario(document.has(SWEEP))
            }
            Ok(_) => Self::Other,
            Err(_) => {
                let names = Vec::from_iter(names_in(text));
                let has = |name| names.contains(&name);
                if has(SCHEMA) && OF_SCENARIO.into_iter().any(has) {
                    Self::scenario(has(SWEEP))
                } else {
                    Self::Other
                }
            }
        }
    }

    fn scenario(is_swept: bool) -> Self {
        if is_swept {
            Self::Sweep
        } else {
            Self::Scenario
        }
    }

    /// Returns the word for the kind.
    pub fn word(self) -> &'static str {
        match self {
            Self::Scenario => "scenario",
            Self::Sweep => "sweep",
            Self::Rig => "rig",
            Self::Other => "other",
        }
    }
}

/// Returns the names of the keys and tables at the top of a text that need not be TOML.
fn names_in(text: &str) -> impl Iterator<Item = &str> {
    let mut is_at_top = true;
    text.lines().filter_map(move |line| {
        let line = line.trim_start();
        let is_table = line.starts_with('[');
        is_at_top &= !is_table;
        let name = line.trim_start_matches(['[', ' ']);
        let end = name.find(|letter: char| !letter.is_alphanumeric() && letter != '_');
        (is_table || is_at_top).then(|| &name[..end.unwrap_or(name.len())])
    })
}

/// Checks whether the document is meant as a rig file.
pub(super) fn is_rig(document: &Document<'_>) -> bool {
    let is_scenario = document.has("controller") || document.has("rig");
    OF_RIG.iter().any(|table| document.has(table)) && !is_scenario
}

/// Checks whether the document is meant as a scenario.
pub(crate) fn is_scenario(document: &Document<'_>) -> bool {
    OF_SCENARIO.iter().any(|key| document.has(key))
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
