//! The two files of a run: a scenario, and the rig that it names.

use std::io;
use std::path::{Component, Path, PathBuf};

use super::{KIND, Reading, SCENARIO_BYTES_MAX, kind};
use crate::beside::Beside;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::nearest::meant_or_known;
use crate::rig::shipped;
use crate::table::{ReadTable, is_inside_folder};

/// Name of a scenario's file in a run folder, which also has the files that it names.
const SCENARIO_FILE: &str = "scenario.toml";

/// A scenario and the rig that it names.
pub(super) struct Files<'text> {
    pub(super) name: String,
    pub(super) scenario: Document<'text>,
    pub(super) rig: RigText,
    /// Path of the rig file.
    pub(super) path: PathBuf,
}

/// The text of a rig file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RigText {
    pub(super) text: String,
    /// Name of the rig file in messages.
    pub(super) name: String,
    /// Name of the rig file relative to the scenario; the name of its copy in a run folder if it ships.
    pub(super) beside: String,
}

impl<'text> Files<'text> {
    pub(super) fn parse(
        text: &'text str,
        name: &str,
        beside: &Beside,
        reading: Reading,
        read_file: ReadTable<'_>,
    ) -> Result<Self, ScenarioError> {
        let fail = |problems| ScenarioError::new(KIND, name, problems);
        let scenario = Document::parse(Source::new(name, text), text).map_err(fail)?;
        if kind::is_rig(&scenario) {
            let help = "a scenario names it: rig = \"FILE.toml\"";
            let problem = scenario.problem("name", "this is a rig file, not a scenario", "a rig");
            return Err(fail(vec![problem.with_help(help)]));
        }
        let rig = rig_text(&scenario, beside, reading, read_file)
            .map_err(|problem| fail(vec![problem]))?;
        Ok(Self {
            name: name.to_owned(),
            scenario,
            path: beside.place(&rig.beside),
            rig,
        })
    }
}

/// Returns the rig that a scenario names: a shipped one, or a file in the folder of the scenario.
fn rig_text(
    scenario: &Document<'_>,
    beside: &Beside,
    reading: Reading,
    read_file: ReadTable<'_>,
) -> Result<RigText, Problem> {
    const HELP: &str = "rig = \"sma_actuator\" is the actuator of the paper; rig = \"FILE.toml\" a rig file beside the scenario";
    let problem = |message: String, label: &str| scenario.problem("rig", message, label);
    let Some(rig) = scenario.root().get("rig") else {
        let message = "the scenario names no rig".to_owned();
        let problem = scenario.key_problem("name", message, "`rig` is missing");
        return Err(problem.with_help(HELP));
    };
    let Some(rig) = rig.get_ref().as_str() else {
        let message = "`rig` must be a string".to_owned();
        return Err(problem(message, "the name of a rig").with_help(HELP));
    };
    if !rig.ends_with(".toml") {
        let Some(text) = shipped::text(rig) else {
            let message = format!("no rig that ships is called `{rig}`");
            let label = meant_or_known(rig, shipped::names());
            let help =
                "a rig file beside the scenario is named with its ending: rig = \"FILE.toml\"";
            return Err(problem(message, &label).with_help(help));
        };
        let copy = shipped::copied_name(rig);
        let recorded = (reading == Reading::Recorded).then(|| read_file(&copy).ok());
        return Ok(RigText {
            text: recorded.flatten().unwrap_or_else(|| text.to_owned()),
            name: rig.to_owned(),
            beside: copy,
        });
    }
    if !is_inside_folder(rig) {
        let message = "a rig file must lie in the scenario's folder, or below it".to_owned();
        return Err(problem(message, "no absolute path, no `..`"));
    }
    if is_same_file(rig, beside.scenario()) {
        let message = format!("`{rig}` is this scenario itself");
        let problem = problem(message, "a rig file is another file");
        return Err(problem.with_place(scenario.key_span("name"), "this is a scenario"));
    }
    if is_same_file(rig, Path::new(SCENARIO_FILE)) {
        let message = format!("a rig file cannot be called `{rig}`");
        return Err(problem(message, "the name of the scenario in a run folder"));
    }
    let place = beside.place(rig).display().to_string();
    let text = read_file(rig).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => {
            let message = format!("the rig file {place} does not exist");
            let problem = problem(message, "looked for beside the scenario");
            let name = Path::new(rig).file_stem().and_then(|name| name.to_str());
            match name.filter(|name| shipped::text(name).is_some()) {
                Some(name) => {
                    problem.with_help(format!("the one that ships is named rig = \"{name}\""))
                }
                None => problem,
            }
        }
        _ => problem(
            format!("the rig file {place} cannot be read"),
            &error.to_string(),
        ),
    })?;
    if text.len() as u64 > SCENARIO_BYTES_MAX {
        let message = format!("the rig file {rig} has {} bytes", text.len());
        let label = format!("it is longer than {SCENARIO_BYTES_MAX}");
        return Err(problem(message, &label));
    }
    Ok(RigText {
        text,
        name: place,
        beside: rig.to_owned(),
    })
}

/// Checks whether a file in the folder of another one is the same file.
fn is_same_file(beside: &str, path: &Path) -> bool {
    let components = Path::new(beside).components();
    let names = components.filter(|component| *component != Component::CurDir);
    let file_name = path.file_name().map(Component::Normal);
    names.eq(file_name)
}
