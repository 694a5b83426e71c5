//! Reads scenario files of schema 2, each with the rig file that it names.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::path::{Component, Path, PathBuf};

use toml::Spanned;
use toml::de::DeValue;

use super::contours::read_contours;
use super::sweep::read_sweep;
use super::{SCHEMA, SCHEMA_OF_ONE, Splitter};
use crate::check;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::fault::{self, Fault, Faults, NodesOfRun};
use crate::file::read_text;
use crate::fingerprint::{HASH_SUFFIX, hash_line};
use crate::load::{
    KIND, Objection, OfRun, Reading, SCENARIO_BYTES_MAX, Texts, kind, nodes, none_of, parse_beside,
    parse_recorded, reading,
};
use crate::loops::{Loops, OneLoop};
use crate::rig::nodes::{Rig, SHIPPED, SHIPPED_NAME};
use crate::scenario::Scenario;
use crate::table::{ReadTable, is_inside_folder};
use crate::view::ControllerView;
use crate::wiring::Wiring;

/// What a scenario's file is called in a run folder, beside the files that it names.
const SCENARIO_FILE: &str = "scenario.toml";

/// Where a path begins that is one of the scenario: a rig file has none of these.
const OF_SWEEP: &str = "sweep.";

/// A scenario that tries nothing.
const IDLE: &str =
    "schema = 2\nname = \"idle\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n";

/// Finds what is wrong with all loops of a rig together, for an error at a place in the rig file, or in the scenario below `sweep`.
type FindObjection<'a> = &'a dyn Fn(&Loops<Scenario>) -> Option<Objection>;

impl Loops<Scenario> {
    /// Whether a text is meant as a scenario of schema 2.
    #[must_use]
    pub fn is_meant(text: &str) -> bool {
        let document = Document::parse(Source::new("", text), text);
        document.is_ok_and(|document| {
            let schema = document.root().get("schema");
            let number = schema.and_then(|value| value.get_ref().as_integer());
            number.is_some_and(|number| number.as_str() == SCHEMA)
        })
    }

    /// Reads a scenario file of schema 2, the rig file that it names, and its tables, with the very texts that were read.
    /// `objections` says what else is wrong with a loop, `object` what is wrong with the rig.
    ///
    /// # Errors
    /// A file cannot be read, or everything that is wrong in it, and every objection.
    pub fn load(
        path: &Path,
        objections: impl Fn(&Scenario) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        Self::parse_beside(path, text_of(path)?, objections, object)
    }

    /// As [`Loops::load`], for a text that is at hand; the files that it names lie beside `path`.
    ///
    /// # Errors
    /// As [`Loops::load`].
    pub fn parse_beside(
        path: &Path,
        text: String,
        objections: impl Fn(&Scenario) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        parse_beside(path, text, |text, name, read_file| {
            parse_for(text, name, read_file, Reading::ToPlay, &objections, &object)
        })
    }

    /// As [`Loops::parse_beside`], for files that `read_file` gives by their names.
    ///
    /// # Errors
    /// As [`Loops::load`].
    pub fn parse(
        path: &Path,
        text: String,
        read_file: impl FnMut(&str) -> io::Result<String>,
        objections: impl Fn(&Scenario) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        reading(path, text, read_file, |text, name, read_file| {
            parse_for(text, name, read_file, Reading::ToPlay, &objections, &object)
        })
    }

    /// As [`Loops::load`], for a rig on which nothing is tried; `name` says where its text was read from.
    ///
    /// # Errors
    /// Everything that is wrong in the rig file, and the objection.
    pub fn of_rig(
        text: &str,
        name: &str,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<Self, ScenarioError> {
        let fail = |problems| ScenarioError::new(KIND, name, problems);
        let scenario = Document::parse(Source::new(name, IDLE), IDLE).map_err(fail)?;
        let files = Files {
            name: name.to_owned(),
            scenario,
            rig: RigText {
                text: text.to_owned().into(),
                name: name.to_owned(),
                beside: String::new(),
            },
        };
        let folder = Path::new(name).parent().unwrap_or(Path::new(""));
        let beside = |file: &str| match file.strip_suffix(HASH_SUFFIX) {
            Some(file) => hash_line(folder, file),
            None => read_text(&folder.join(file), SCENARIO_BYTES_MAX),
        };
        made(
            &files,
            &mut { beside },
            Reading::ToPlay,
            &|_| Vec::new(),
            &object,
        )
    }

    /// As [`Loops::load`], for a scenario that was played already.
    ///
    /// # Errors
    /// As [`Loops::load`].
    pub fn load_recorded(
        path: &Path,
        objections: impl Fn(&Scenario) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        parse_recorded(path, text_of(path)?, |text, name, read_file| {
            let reading = Reading::Recorded;
            parse_for(text, name, read_file, reading, &objections, &object)
        })
    }
}

fn parse_for(
    text: &str,
    name: &str,
    read_file: ReadTable<'_>,
    reading: Reading,
    objections: &dyn Fn(&Scenario) -> Vec<Objection>,
    object: FindObjection<'_>,
) -> Result<Loops<Scenario>, ScenarioError> {
    let files = Files::parse(text, name, read_file)?;
    made(&files, read_file, reading, objections, object)
}

fn made(
    files: &Files<'_>,
    read_file: ReadTable<'_>,
    reading: Reading,
    objections: &dyn Fn(&Scenario) -> Vec<Objection>,
    object: FindObjection<'_>,
) -> Result<Loops<Scenario>, ScenarioError> {
    let RigText { text, name, beside } = &files.rig;
    let (rig, rig_document) = Rig::read(text, name, reading)?;
    let sheets = read_sheets(&rig, &rig_document, beside, read_file);
    let sheets = sheets.map_err(|problems| nodes::fail(name, problems))?;
    find_fmus(&rig, files, &rig_document, reading, read_file)?;
    let fail = |problems| ScenarioError::new(KIND, &files.name, problems);
    let (faults, mut problems) = fault::read(&files.scenario, NodesOfRun::Of(&rig));
    let read = |document: &mut Document<'_>, wiring: Wiring| {
        let faults = faults.clone();
        let of_run = OfRun { wiring, faults };
        Scenario::read(document, &mut *read_file, reading, &objections, of_run)
    };
    let mut loops = match read_loops(files, rig, &rig_document, read) {
        Ok(loops) => loops,
        Err(found) => {
            problems.extend(found);
            return Err(fail(problems));
        }
    };
    problems.extend(wrong_faults(files, &loops, &faults, reading));
    if !problems.is_empty() {
        return Err(fail(problems));
    }
    loops.sheets = sheets;
    if matches!(reading, Reading::ToPlay) {
        let sweep = read_sweep(&files.scenario, &loops.rig).map_err(fail)?;
        for one in &mut loops.loops {
            one.scenario.sweep.clone_from(&sweep);
        }
    }
    match object(&loops) {
        Some(objection) if objection.path.starts_with(OF_SWEEP) => {
            Err(fail(vec![objection.problem(&files.scenario)]))
        }
        Some(objection) => Err(nodes::fail(name, vec![objection.problem(&rig_document)])),
        None => Ok(loops),
    }
}

/// Faults at times that the run has not, and those that mean nothing to their plants.
fn wrong_faults(
    files: &Files<'_>,
    loops: &Loops<Scenario>,
    faults: &Faults,
    reading: Reading,
) -> Vec<Problem> {
    let scenarios = || loops.loops.iter().map(|one| &one.scenario);
    let duration_seconds = scenarios().next().map(|one| one.duration_seconds);
    let document = &files.scenario;
    let mut problems = check::faults(document, faults, duration_seconds.unwrap_or_default());
    // Which faults mean something to a plant from outside, only the bench knows that played it.
    let is_known = |one: &&Scenario| one.plant.own.is_none() || matches!(reading, Reading::ToPlay);
    let plant_of = |fault: &Fault| {
        let is_at =
            |one: &&Scenario| fault.is_at_drive(one.wiring.nodes.drive.id, &one.wiring.plant);
        let at = scenarios().find(is_at).filter(is_known);
        at.map(|one| &one.plant)
    };
    problems.extend(check::faults_of_plants(document, faults, plant_of));
    problems
}

/// Finds the FMUs of plants, whose hashes then are among what was read. Of a recording neither file nor hash need be there.
fn find_fmus(
    rig: &Rig,
    files: &Files<'_>,
    rig_document: &Document<'_>,
    reading: Reading,
    read_file: ReadTable<'_>,
) -> Result<(), ScenarioError> {
    for (plant, model) in &rig.plant {
        let Some(fmu) = &model.fmu else { continue };
        let path = format!("plant.{plant}.fmu.file");
        let other = files.scenario.spanned(&path);
        let other = other.and_then(|value| value.get_ref().as_str());
        let named = other.unwrap_or(&fmu.file);
        let file = Path::new(&files.rig.beside).with_file_name(named);
        let file = file.to_string_lossy();
        let wrong = match wrong_name(named) {
            Some(label) => Some(label.to_owned()),
            None => match (read_file(&format!("{file}{HASH_SUFFIX}")), reading) {
                (Err(error), Reading::ToPlay) => Some(match error.kind() {
                    io::ErrorKind::NotFound => {
                        "there is no such file beside the rig file".to_owned()
                    }
                    _ => error.to_string(),
                }),
                _ => None,
            },
        };
        let Some(label) = wrong else { continue };
        let message = format!("`{named}` cannot be the FMU of `{plant}`");
        return Err(match other {
            Some(_) => {
                let problem = files.scenario.problem(&path, message, label);
                ScenarioError::new(KIND, &files.name, vec![problem])
            }
            None => {
                let problem = rig_document.problem(&path, message, label);
                nodes::fail(&files.rig.name, vec![problem])
            }
        });
    }
    Ok(())
}

/// Why a file cannot be one of a plant, whether it is there or not.
fn wrong_name(file: &str) -> Option<&'static str> {
    match file {
        file if !is_inside_folder(file) => {
            Some("no absolute path, no `..`: it lies beside the rig file")
        }
        file if !file.ends_with(".fmu") => Some("its name must end in .fmu"),
        _ => None,
    }
}

/// Reads the EDS of each drive that is somebody else's, where the rig file, `beside` the scenario, names one.
fn read_sheets(
    rig: &Rig,
    document: &Document<'_>,
    beside: &str,
    read_file: ReadTable<'_>,
) -> Result<BTreeMap<String, String>, Vec<Problem>> {
    let mut sheets = BTreeMap::new();
    let mut problems = Vec::new();
    for (name, node) in &rig.node {
        let Some(eds) = &node.eds else { continue };
        let place = Path::new(beside).with_file_name(eds);
        match read_file(&place.to_string_lossy()) {
            Ok(text) => drop(sheets.insert(name.clone(), text)),
            Err(error) => {
                let message = format!("the EDS of `{name}` cannot be read");
                let path = format!("node.{name}.eds");
                problems.push(document.problem(&path, message, error.to_string()));
            }
        }
    }
    none_of(problems, sheets)
}

impl Loops<ControllerView> {
    /// Reads what the controller may know of a scenario file of schema 2; the other tables are dropped.
    ///
    /// # Errors
    /// As [`Loops::load`], for the tables that the controller sees.
    pub fn load_view(path: &Path) -> Result<Self, ScenarioError> {
        let loops = parse_beside(path, text_of(path)?, |text, name, read_file| {
            let files = Files::parse(text, name, read_file)?;
            let (rig, rig_document) = Rig::read(&files.rig.text, &files.rig.name, Reading::ToPlay)?;
            let read = |document: &mut Document<'_>, wiring: Wiring| {
                ControllerView::read(document, read_file, wiring)
            };
            let loops = read_loops(&files, rig, &rig_document, read);
            loops.map_err(|problems| ScenarioError::new(KIND, name, problems))
        });
        loops.map(|(loops, _)| loops)
    }
}

fn text_of(path: &Path) -> Result<String, ScenarioError> {
    read_text(path, SCENARIO_BYTES_MAX)
        .map_err(|error| ScenarioError::unreadable(KIND, &path.display().to_string(), &error))
}

/// A scenario and the rig file that it names.
struct Files<'text> {
    name: String,
    scenario: Document<'text>,
    rig: RigText,
}

struct RigText {
    text: Cow<'static, str>,
    /// Where it was read from, for people.
    name: String,
    /// Its name beside the scenario.
    beside: String,
}

impl<'text> Files<'text> {
    fn parse(
        text: &'text str,
        name: &str,
        read_file: ReadTable<'_>,
    ) -> Result<Self, ScenarioError> {
        let fail = |problems| ScenarioError::new(KIND, name, problems);
        let scenario = Document::parse(Source::new(name, text), text).map_err(fail)?;
        if kind::is_rig_of_nodes(&scenario) {
            let help = "a scenario names it: rig = \"FILE.toml\"";
            let problem = scenario.problem("name", "this is a rig file, not a scenario", "a rig");
            return Err(fail(vec![problem.with_help(help)]));
        }
        let rig = rig_text(&scenario, name, read_file).map_err(|problem| fail(vec![problem]))?;
        Ok(Self {
            name: name.to_owned(),
            scenario,
            rig,
        })
    }

    /// The scenario's folder.
    fn folder(&self) -> &Path {
        Path::new(&self.name).parent().unwrap_or(Path::new(""))
    }

    /// Where the rig file is; that of a rig on which nothing is tried is where its text was read from.
    fn rig_path(&self) -> PathBuf {
        match self.rig.beside.as_str() {
            "" => PathBuf::from(&self.name),
            beside => self.folder().join(beside),
        }
    }
}

/// The rig file that a scenario names, else the one that ships.
fn rig_text(
    scenario: &Document<'_>,
    scenario_name: &str,
    read_file: ReadTable<'_>,
) -> Result<RigText, Problem> {
    let Some(rig) = scenario.root().get("rig") else {
        return Ok(RigText {
            text: SHIPPED.into(),
            name: SHIPPED_NAME.to_owned(),
            beside: SHIPPED_NAME.to_owned(),
        });
    };
    let problem = |message: String, label: &str| scenario.problem("rig", message, label);
    let Some(rig) = rig.get_ref().as_str() else {
        let message = "`rig` must be a string".to_owned();
        return Err(problem(message, "the name of a rig file beside this one"));
    };
    if !is_inside_folder(rig) {
        let message = "a rig file must lie in the scenario's folder, or below it".to_owned();
        return Err(problem(message, "no absolute path, no `..`"));
    }
    let path = Path::new(scenario_name);
    if is_same_file(rig, path) {
        let message = format!("`{rig}` is this scenario itself");
        let problem = problem(message, "a rig file is another file");
        return Err(problem.with_place(scenario.key_span("name"), "this is a scenario"));
    }
    if !rig.ends_with(".toml") || is_same_file(rig, Path::new(SCENARIO_FILE)) {
        let message = format!("a rig file cannot be called `{rig}`");
        let label = "a name that ends in .toml, and is not that of the scenario in a run folder";
        return Err(problem(message, label));
    }
    let name = path.parent().unwrap_or(Path::new("")).join(rig);
    let name = name.display().to_string();
    let text = read_file(rig).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => problem(
            format!("the rig file {rig} does not exist"),
            "looked for beside the scenario",
        ),
        _ => problem(
            format!("the rig file {rig} cannot be read"),
            &error.to_string(),
        ),
    })?;
    if text.len() as u64 > SCENARIO_BYTES_MAX {
        let message = format!("the rig file {rig} has {} bytes", text.len());
        let label = format!("it is longer than {SCENARIO_BYTES_MAX}");
        return Err(problem(message, &label));
    }
    Ok(RigText {
        text: text.into(),
        name,
        beside: rig.to_owned(),
    })
}

/// Whether a file beside another one is that other one.
fn is_same_file(beside: &str, path: &Path) -> bool {
    let components = Path::new(beside).components();
    let names = components.filter(|component| *component != Component::CurDir);
    let own = path.file_name().map(Component::Normal);
    names.eq(own)
}

fn read_loops<'text, T>(
    files: &Files<'text>,
    rig: Rig,
    rig_document: &Document<'text>,
    mut read: impl FnMut(&mut Document<'text>, Wiring) -> Result<T, Vec<Problem>>,
) -> Result<Loops<T>, Vec<Problem>> {
    let scenario = &files.scenario;
    let schema = DeValue::parse(SCHEMA_OF_ONE).map(Spanned::into_inner);
    let splitter = Splitter {
        scenario,
        rig: &rig,
        rig_tree: rig_document.root(),
        rig_path: files.rig_path(),
        schema_1: schema.unwrap_or(DeValue::Boolean(false)),
    };
    let (trees, mut problems) = splitter.split();
    let mut loops = Vec::new();
    for (name, tree) in trees {
        let wiring = rig.wiring_of(rig.drive_of_loop(&name));
        match read(&mut scenario.with_root(tree), wiring) {
            Ok(scenario) => loops.push(OneLoop {
                place: rig.place(&name),
                name,
                scenario,
            }),
            Err(found) => problems.extend(found),
        }
    }
    let contours = read_contours(scenario, &rig).unwrap_or_else(|found| {
        problems.extend(found);
        Vec::new()
    });
    let loops = Loops {
        rig,
        loops,
        contours,
        sheets: BTreeMap::new(),
    };
    none_of(problems, loops)
}
