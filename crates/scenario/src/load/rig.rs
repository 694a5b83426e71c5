//! Reads rig files, with the same errors as scenario files.

use std::path::{Path, PathBuf};

use super::kind::{is_rig_of_nodes, is_rig_of_one_drive};
use super::{SCENARIO_BYTES_MAX, build, none_of};
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::file::read_text;
use crate::outside::Outside;
use crate::rig::{ObjectAddress, RigFile};
use crate::{schema, table};

/// What the file is for people.
const KIND: &str = "rig file";

impl RigFile {
    /// Reads a rig file, with the very text that was read.
    ///
    /// # Errors
    /// The file cannot be read, or everything that is wrong in it.
    pub fn load_with_text(path: &Path) -> Result<(Self, String), ScenarioError> {
        let name = path.display().to_string();
        let text = read_text(path, SCENARIO_BYTES_MAX)
            .map_err(|error| ScenarioError::unreadable(KIND, &name, &error))?;
        Self::parse(&text, &name).map(|rig| (rig, text))
    }

    /// Reads a rig file from text; `file_name` names it in errors.
    ///
    /// # Errors
    /// Everything that is wrong in the text.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, ScenarioError> {
        let fail = |problems| ScenarioError::new(KIND, file_name, problems);
        let document = Document::parse(Source::new(file_name, text), text).map_err(fail)?;
        if document.has("controller") {
            let help = "a rig file has [limits]; --rig takes one, beside the scenarios";
            let problem =
                document.problem("name", "this is a scenario, not a rig file", "a scenario");
            return Err(fail(vec![problem.with_help(help)]));
        }
        if is_rig_of_nodes(&document) {
            let message = "this is a rig file of schema 2, which names its nodes";
            let problem = document.problem("schema", message, "not 1");
            let help =
                "a scenario of schema 2 names it: rig = \"FILE.toml\"; --rig takes one of schema 1";
            return Err(fail(vec![problem.with_help(help)]));
        }
        let (rig, mut problems) = build::<Self>(
            &document,
            &Outside::Registered,
            "the rig file",
            &schema::RIG,
        )
        .map_err(fail)?;
        problems.extend(check(&document, &rig));
        none_of(problems, rig).map_err(fail)
    }

    /// Its text.
    ///
    /// # Panics
    /// Never: all of it has a form in TOML.
    #[must_use]
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("tables of plain data")
    }

    /// Whether a text is meant as a rig file: no scenario has one of these tables.
    #[must_use]
    pub fn is_meant(text: &str) -> bool {
        let document = Document::parse(Source::new("", text), text);
        document.is_ok_and(|document| is_rig_of_one_drive(&document))
    }

    /// The drive's EDS; none for that of the emulated drive. `rig_file` is where this was read from.
    #[must_use]
    pub fn eds_path(&self, rig_file: &Path) -> Option<PathBuf> {
        let folder = rig_file.parent().unwrap_or(Path::new(""));
        self.drive.eds.as_ref().map(|eds| folder.join(eds))
    }
}

/// What the schema cannot say.
fn check(document: &Document<'_>, rig: &RigFile) -> Vec<Problem> {
    let mut problems = Vec::from_iter(crate::check::name(document, &rig.name));
    let drive = &rig.drive;
    if drive.node_id == rig.fan.node_id {
        let message = format!("node-ID {} is taken", drive.node_id);
        let path = match document.has("drive.node_id") {
            true => "drive.node_id",
            false => "fan.node_id",
        };
        let label = "drive, and fan and load module, have the same";
        problems.push(document.problem(path, message, label));
    }
    problems.extend(check_drive(document, rig, str::to_owned));
    problems
}

/// What the schema cannot say of the drive; `place` is where a key of a rig file of one drive stands in this file.
pub(super) fn check_drive(
    document: &Document<'_>,
    rig: &RigFile,
    place: impl Fn(&str) -> String,
) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut object = |path: &str, message: &str, label: &str| {
        problems.push(document.problem(&place(path), message, label));
    };
    let drive = &rig.drive;
    if drive
        .eds
        .as_ref()
        .is_some_and(|eds| !table::is_inside_folder(eds))
    {
        let message = "the EDS must lie in the rig file's folder";
        object("drive.eds", message, "no absolute path, no `..`");
    }
    let objects = [
        ("drive.command.object", &drive.command.object, false),
        ("drive.position.object", &drive.position.object, false),
        ("drive.current.object", &drive.current.object, true),
    ];
    for (path, text, may_be_absent) in objects {
        let is_absent = may_be_absent && text.is_empty();
        if let Err(reason) = text.parse::<ObjectAddress>()
            && !is_absent
        {
            let message = format!("\"{text}\" names no object");
            object(path, &message, reason);
        }
    }
    let per_millimetre = drive.position.units_per_millimetre;
    if per_millimetre.abs() < 1e-6 {
        let path = "drive.position.units_per_millimetre";
        let message = "a position that does not change with the load";
        object(path, message, "must not be 0");
    }
    let range = rig.limits.position_millimetres;
    if range.min >= range.max {
        let message = "no position is within the limits";
        let label = format!("min {} is not below max {}", range.min, range.max);
        object("limits.position_millimetres", message, &label);
    }
    let timeouts = &rig.timeouts;
    let (period, lost) = (
        timeouts.drive_heartbeat_milliseconds,
        timeouts.drive_lost_milliseconds,
    );
    if period >= lost {
        let path = "timeouts.drive_lost_milliseconds";
        let message = "the drive is lost between two heartbeats";
        let label = format!("must be above the heartbeat period of {period} ms");
        object(path, message, &label);
    }
    problems
}
