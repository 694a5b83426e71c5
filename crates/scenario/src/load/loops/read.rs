//! Reads scenario files, each with the rig that it names.

use std::collections::BTreeMap;
use std::io;
use std::path::{Component, Path, PathBuf};

use super::Splitter;
use super::contours::read_contours;
use super::overlay::Overlaid;
use super::sweep::read_sweep;
use crate::beside::Beside;
use crate::check;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::fault::{self, Fault, Faults};
use crate::fingerprint::HASH_SUFFIX;
use crate::load::{
    KIND, Objection, OfRun, Reading, SCENARIO_BYTES_MAX, Texts, kind, nodes, none_of, reading,
};
use crate::loops::{Loops, OneLoop};
use crate::nearest::meant_or_known;
use crate::rig::nodes::Rig;
use crate::rig::shipped;
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
    "schema = 1\nname = \"idle\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n";

/// Finds what is wrong with all loops of a rig together, for an error at a place in the rig file, or in the scenario below `sweep`.
type FindObjection<'a> = &'a dyn Fn(&Loops<Scenario>) -> Option<Objection>;

impl Loops<Scenario> {
    /// Reads a scenario, the rig that it names, and its tables, with the very texts that were read. `read_file` gives the text of a
    /// file by the name that the scenario uses; `beside` says where these files are. `objections` says what else is wrong with a
    /// loop, `object` what is wrong with the rig.
    ///
    /// # Errors
    /// Everything that is wrong in the texts, and every objection.
    pub fn parse(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
        objections: impl Fn(&Scenario) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        let reading = Reading::ToPlay;
        parse_for(beside, text, &mut read_file, reading, &objections, &object)
    }

    /// As [`Loops::parse`], for a scenario with other values than one that was read before, on the same rig.
    ///
    /// # Errors
    /// As [`Loops::parse`].
    pub fn parse_case(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<Self, ScenarioError> {
        let none = |_: &Scenario| Vec::new();
        let reading = Reading::Case;
        parse_for(beside, text, &mut read_file, reading, &none, &object).map(|(loops, _)| loops)
    }

    /// As [`Loops::parse`], for a scenario that was played already: tables of plants and laws from outside are kept as they are,
    /// whether this bench has these plants and laws or not, and nothing in them is checked. Nor is what a sweep would vary.
    ///
    /// # Errors
    /// As [`Loops::parse`], but for these tables.
    pub fn parse_recorded(
        beside: &Beside,
        text: String,
        objections: impl Fn(&Scenario) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        // Hashes are those that were written then.
        let read = &mut |name: &str| beside.read_text(name);
        parse_for(beside, text, read, Reading::Recorded, &objections, &object)
    }

    /// As [`Loops::parse`], for a rig on which nothing is tried; `name` says where its text was read from.
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
        let beside = Beside::new(Path::new(name));
        let files = Files {
            name: name.to_owned(),
            scenario,
            rig: RigText {
                text: text.to_owned(),
                name: name.to_owned(),
                beside: String::new(),
                is_shipped: false,
            },
            path: PathBuf::from(name),
        };
        let read = |file: &str| beside.read(file);
        let reading = Reading::ToPlay;
        made(&files, &mut { read }, reading, &|_| Vec::new(), &object)
    }
}

impl<T> Loops<T> {
    /// What is tried in the only loop.
    ///
    /// # Errors
    /// There are several.
    pub(crate) fn only(mut self, file_name: &str) -> Result<T, ScenarioError> {
        let count = self.loops.len();
        let one = self.loops.pop().filter(|_| self.loops.is_empty());
        one.map(|one| one.scenario).ok_or_else(|| {
            let message = format!("its rig has {count} loops, and one is played here");
            ScenarioError::of_scenario(file_name, message)
        })
    }
}

// Not generic: it would be compiled again, with all of TOML and every type of a scenario, in each crate that calls it.
fn parse_for(
    beside: &Beside,
    text: String,
    read_file: ReadTable<'_>,
    for_what: Reading,
    objections: &dyn Fn(&Scenario) -> Vec<Objection>,
    object: FindObjection<'_>,
) -> Result<(Loops<Scenario>, Texts), ScenarioError> {
    let name = beside.scenario().display().to_string();
    let (loops, mut texts) = reading(text, read_file, |text, read_file| {
        let files = Files::parse(text, &name, beside, for_what, read_file)?;
        made(&files, read_file, for_what, objections, object)
    })?;
    if let Some((name, text)) = &loops.shipped_rig {
        texts.tables.insert(name.clone(), text.clone());
    }
    Ok((loops, texts))
}

fn made(
    files: &Files<'_>,
    read_file: ReadTable<'_>,
    reading: Reading,
    objections: &dyn Fn(&Scenario) -> Vec<Objection>,
    object: FindObjection<'_>,
) -> Result<Loops<Scenario>, ScenarioError> {
    let RigText {
        text, name, beside, ..
    } = &files.rig;
    let rig_document = Rig::document(text, name)?;
    let as_written = match reading {
        Reading::Case => None,
        Reading::ToPlay | Reading::Recorded => {
            let rig = Rig::of_tree(&rig_document, reading);
            Some(rig.map_err(|problems| nodes::fail(name, problems))?)
        }
    };
    let fail = |problems| ScenarioError::new(KIND, &files.name, problems);
    let overlaid = Overlaid::new(&files.scenario, as_written, rig_document.root(), reading);
    let Overlaid {
        rig,
        tree,
        mut problems,
    } = overlaid.map_err(fail)?;
    let sheets = read_sheets(&rig, &rig_document, beside, read_file);
    let sheets = sheets.map_err(|problems| nodes::fail(name, problems))?;
    find_fmus(&rig, files, &rig_document, reading, read_file)?;
    let (faults, found) = fault::read(&files.scenario, &rig);
    let has_all_faults = found.is_empty();
    problems.extend(found);
    let read = |document: &mut Document<'_>, wiring: Wiring| {
        let faults = faults.clone();
        let of_run = OfRun {
            wiring,
            faults,
            has_all_faults,
        };
        Scenario::read(document, &mut *read_file, reading, &objections, of_run)
    };
    let mut loops = match read_loops(files, rig, &tree, read) {
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
    let Some(mut objection) = object(&loops) else {
        return Ok(loops);
    };
    let in_scenario = path_in_scenario(&objection.path, &loops.rig);
    let table = in_scenario.rsplit_once('.').map_or("", |(table, _)| table);
    let is_overlaid = files.scenario.has(&in_scenario) || files.scenario.has(table);
    if is_overlaid || objection.path.starts_with(OF_SWEEP) {
        objection.path = in_scenario;
        return Err(fail(vec![objection.problem(&files.scenario)]));
    }
    Err(nodes::fail(name, vec![objection.problem(&rig_document)]))
}

/// The path by which a scenario gives another value to its rig: without the name of the plant's model.
fn path_in_scenario(path: &str, rig: &Rig) -> String {
    let mut plants = rig.plant.iter();
    let short = plants.find_map(|(name, plant)| {
        let rest = path.strip_prefix(&format!("plant.{name}.{}.", plant.model()))?;
        Some(format!("plant.{name}.{rest}"))
    });
    short.unwrap_or_else(|| path.to_owned())
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
    let is_known =
        |one: &&Scenario| one.plant.own.is_none() || !matches!(reading, Reading::Recorded);
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
        let named = &fmu.file;
        let file = Path::new(&files.rig.beside).with_file_name(named);
        let file = file.to_string_lossy();
        let wrong = match wrong_name(named) {
            Some(label) => Some(label.to_owned()),
            None => match (read_file(&format!("{file}{HASH_SUFFIX}")), reading) {
                (Err(error), Reading::ToPlay | Reading::Case) => Some(match error.kind() {
                    io::ErrorKind::NotFound => {
                        "there is no such file beside the rig file".to_owned()
                    }
                    _ => error.to_string(),
                }),
                _ => None,
            },
        };
        if let Some(label) = wrong {
            let message = format!("`{named}` cannot be the FMU of `{plant}`");
            let path = format!("plant.{plant}.fmu.file");
            let problem = rig_document.problem(&path, message, label);
            return Err(nodes::fail(&files.rig.name, vec![problem]));
        }
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
    /// Reads what the controller may know of a scenario; the other tables are dropped.
    ///
    /// # Errors
    /// As [`Loops::parse`], for the tables that the controller sees.
    pub fn parse_view(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        let name = beside.scenario().display().to_string();
        let for_what = Reading::ToPlay;
        let loops = reading(text, &mut read_file, |text, read_file| {
            let files = Files::parse(text, &name, beside, for_what, read_file)?;
            let RigText {
                text, name, beside, ..
            } = &files.rig;
            let (rig, rig_document) = Rig::read(text, name, for_what)?;
            let sheets = read_sheets(&rig, &rig_document, beside, read_file);
            let sheets = sheets.map_err(|problems| nodes::fail(name, problems))?;
            let overlaid = Overlaid::new(&files.scenario, Some(rig), rig_document.root(), for_what);
            let Overlaid { rig, tree, .. } =
                overlaid.map_err(|problems| ScenarioError::new(KIND, name, problems))?;
            let read = |document: &mut Document<'_>, wiring: Wiring| {
                ControllerView::read(document, read_file, wiring)
            };
            let loops = read_loops(&files, rig, &tree, read);
            let loops = loops.map(|loops| Self { sheets, ..loops });
            loops.map_err(|problems| ScenarioError::new(KIND, &files.name, problems))
        });
        loops.map(|(loops, _)| loops)
    }
}

/// A scenario and the rig that it names.
struct Files<'text> {
    name: String,
    scenario: Document<'text>,
    rig: RigText,
    /// Where the rig file is.
    path: PathBuf,
}

struct RigText {
    text: String,
    /// Where it was read from, for people.
    name: String,
    /// Its name beside the scenario; that of its copy in a run folder if it ships.
    beside: String,
    is_shipped: bool,
}

impl<'text> Files<'text> {
    fn parse(
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
        let rig = rig_text(&scenario, beside, reading, read_file);
        let rig = rig.map_err(|problem| fail(vec![problem]))?;
        Ok(Self {
            name: name.to_owned(),
            scenario,
            path: beside.place(&rig.beside),
            rig,
        })
    }
}

/// The rig that a scenario names: one that ships, or a file beside it.
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
        let span = scenario.key_span("name");
        let problem = scenario.source.problem(span, message, "`rig` is missing");
        return Err(problem.with_help(HELP));
    };
    let Some(rig) = rig.get_ref().as_str() else {
        let message = "`rig` must be a string".to_owned();
        return Err(problem(message, "the name of a rig").with_help(HELP));
    };
    if !rig.ends_with(".toml") {
        let Some(text) = shipped::text(rig) else {
            let message = format!("no rig that ships is called `{rig}`");
            let label = meant_or_known(rig, &shipped::names());
            let help =
                "a rig file beside the scenario is named with its ending: rig = \"FILE.toml\"";
            return Err(problem(message, &label).with_help(help));
        };
        let copy = shipped::copy_of(rig);
        let recorded = matches!(reading, Reading::Recorded).then(|| read_file(&copy).ok());
        return Ok(RigText {
            text: recorded.flatten().unwrap_or_else(|| text.to_owned()),
            name: rig.to_owned(),
            beside: copy,
            is_shipped: true,
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
        is_shipped: false,
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
    rig_tree: &toml::de::DeTable<'text>,
    mut read: impl FnMut(&mut Document<'text>, Wiring) -> Result<T, Vec<Problem>>,
) -> Result<Loops<T>, Vec<Problem>> {
    let scenario = &files.scenario;
    let splitter = Splitter {
        scenario,
        rig: &rig,
        rig_tree,
        rig_path: files.path.clone(),
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
    let RigText {
        text,
        beside,
        is_shipped,
        ..
    } = &files.rig;
    let loops = Loops {
        rig,
        loops,
        contours,
        sheets: BTreeMap::new(),
        shipped_rig: is_shipped.then(|| (beside.clone(), text.clone())),
    };
    none_of(problems, loops)
}
