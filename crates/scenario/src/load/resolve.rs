//! Resolves a scenario and the rig that it names into the facts of a run, in one pass that checks and builds.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::contours::read_contours;
use super::files::{Files, RigText};
use super::overlay::overlaid;
use super::sections::{CONTROLLER, SHARED, Selector};
use super::sweep::read_sweep;
use super::{KIND, Objection, Reading, build, check_custom, in_unit, nodes, without_problems};
use crate::beside::Beside;
use crate::check::{self, NamedFiles};
use crate::custom::Section;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::fault::{self, Fault};
use crate::rig::nodes::Rig;
use crate::run::Run;
use crate::scenario::{NodeProgram, Scenario, Shared};
use crate::schema;
use crate::table::ReadTable;
use crate::trial::Trial;
use crate::wiring::Wiring;

/// Names of both files in messages.
const SCENARIO: &str = "the scenario";
const RIG_FILE: &str = "the rig file";
/// Beginning of paths that belong to the scenario: a rig file has none of these.
const SWEEP_PREFIX: &str = "sweep.";

/// Scenario in which a rig idles.
const IDLE: &str =
    "schema = 1\nname = \"idle\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n";

/// Purpose for which a scenario is read, and the caller's further checks.
pub struct Asked<'a> {
    /// Purpose.
    pub reading: Reading,
    /// Finds further problems of a loop.
    pub objections: &'a dyn Fn(&Trial) -> Vec<Objection>,
    /// Finds a problem of a whole scenario, at a place in the rig file, or in the scenario below `sweep`.
    pub object: &'a dyn Fn(&Scenario) -> Option<Objection>,
}

/// Reads to play, without further checks.
impl Default for Asked<'_> {
    fn default() -> Self {
        Self {
            reading: Reading::ToPlay,
            objections: &|_| Vec::new(),
            object: &|_| None,
        }
    }
}

impl Scenario {
    /// Parses a scenario, the rig that it names, and its tables. `read_file` returns the text of a file by the name that the
    /// scenario uses; `beside` locates these files.
    ///
    /// # Errors
    /// All problems of the texts, and every objection.
    // Not generic: it would be compiled again, with all of TOML and every type of a scenario, in each crate that calls it.
    pub fn parse(
        beside: &Beside,
        text: String,
        read_file: ReadTable<'_>,
        asked: &Asked<'_>,
    ) -> Result<Self, ScenarioError> {
        let name = beside.scenario().display().to_string();
        let mut tables = BTreeMap::new();
        // A file that is named twice is read once.
        let read_once = &mut |name: &str| match tables.get(name) {
            Some(text) => Ok(String::clone(text)),
            None => {
                let text = read_file(name)?;
                tables.insert(name.to_owned(), text.clone());
                Ok(text)
            }
        };
        let files = Files::parse(&text, &name, beside, asked.reading, read_once)?;
        let mut scenario = resolve(&files, read_once, asked)?;
        let rig = files.rig;
        // It borrows the text.
        drop(files.scenario);
        tables.extend(rig.is_shipped.then_some((rig.beside, rig.text)));
        let shared = &mut scenario.shared;
        (shared.beside, shared.text, shared.tables) = (beside.clone(), text, tables);
        Ok(scenario)
    }

    /// Makes a scenario in which a rig idles; `name` is the source of its text.
    ///
    /// # Errors
    /// All problems of the rig file, and the objection.
    pub fn from_rig(
        text: &str,
        name: &str,
        object: &dyn Fn(&Self) -> Option<Objection>,
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
        let asked = Asked {
            object,
            ..Asked::default()
        };
        let mut scenario = resolve(&files, &mut |file| beside.read(file), &asked)?;
        scenario.shared.beside = beside;
        Ok(scenario)
    }
}

fn resolve(
    files: &Files<'_>,
    read_file: ReadTable<'_>,
    asked: &Asked<'_>,
) -> Result<Scenario, ScenarioError> {
    let (reading, document) = (asked.reading, &files.scenario);
    let rig_name = &files.rig.name;
    let rig_document = Rig::document(&files.rig.text, rig_name)?;
    // The rig of a case was checked before.
    let as_written = (reading != Reading::Case).then(|| Rig::from_tree(&rig_document, reading));
    let as_written = as_written
        .transpose()
        .map_err(|problems| nodes::fail(rig_name, problems))?;
    let fail = |problems| ScenarioError::new(KIND, &files.name, problems);
    let overlaid = overlaid(document, as_written, rig_document.root(), reading);
    let (rig, mut problems) = overlaid.map_err(fail)?;
    let programs = programs(&rig, files);
    let (sheets, wrong) = find_files(
        (&rig, &programs),
        files,
        &rig_document,
        reading,
        read_file,
        &mut problems,
    );
    if !wrong.is_empty() {
        return Err(nodes::fail(rig_name, wrong));
    }
    let selector = Selector {
        scenario: document,
        rig: &rig,
    };
    // A misspelt table is one problem; the keys that are then missing are not further ones.
    let unknown = selector.unknown_keys();
    if !unknown.is_empty() {
        problems.extend(unknown);
        return Err(fail(problems));
    }
    let told = read_run(&selector, &mut problems);
    let loops = read_loops(&selector, files, &told, read_file, asked, &mut problems);
    let contours = read_contours(document, &rig).unwrap_or_else(|found| {
        problems.extend(found);
        Vec::new()
    });
    // All loops together are checked once each of them is right.
    let run = match told.run {
        Some(run) if loops.len() == rig.loops.len() => run,
        _ => return Err(fail(problems)),
    };
    problems.extend(wrong_plant_faults(document, &run, &loops, reading));
    if !problems.is_empty() {
        return Err(fail(problems));
    }
    let sweep = match reading {
        Reading::ToPlay => read_sweep(document, &rig).map_err(fail)?,
        Reading::Case | Reading::Recorded => None,
    };
    let shared = Shared {
        run,
        contours,
        sweep,
        has_unused_law: rig.is_led_by_program() && document.has(CONTROLLER),
        rig: Arc::new(rig),
        programs,
        ..Shared::default()
    };
    let scenario = Scenario {
        shared,
        loops,
        sheets,
    };
    match (asked.object)(&scenario) {
        None => Ok(scenario),
        Some(objection) => Err(objected(
            files,
            &rig_document,
            &scenario.shared.rig,
            objection,
        )),
    }
}

/// Facts of a run for the readers of its trials.
struct Told<'a> {
    rig: &'a Rig,
    /// `None` if they cannot be read.
    run: Option<Arc<Run>>,
    /// False if some of the faults could not be read.
    has_all_faults: bool,
}

/// Reads the trial of each loop, without loops that cannot be read.
fn read_loops(
    selector: &Selector<'_, '_>,
    files: &Files<'_>,
    told: &Told<'_>,
    read_file: ReadTable<'_>,
    asked: &Asked<'_>,
    problems: &mut Vec<Problem>,
) -> Vec<Trial> {
    let (tables, wrong_tables) = selector.select();
    problems.extend(wrong_tables);
    let mut loops = Vec::new();
    for one in tables {
        let wiring = told.rig.wiring_of(told.rig.drive_of_loop(&one.name));
        let measurand = wiring.feedback.measurand.clone();
        // The keys of its tables, and the names in problems, are patterns.
        let document = selector.scenario.with_loop(one.tree, measurand.clone());
        let tables = (&document, one.factors.as_slice());
        match read_trial(tables, wiring, files, told, read_file, asked) {
            Ok(one) => loops.extend(one),
            Err(found) => problems.extend(in_unit(found, &measurand)),
        }
    }
    loops
}

/// Reads the trial of one loop from its tables, with the factors for parameters of its law; `None` if the facts of the run are not
/// known.
fn read_trial(
    (document, factors): (&Document<'_>, &[(String, f64)]),
    wiring: Wiring,
    files: &Files<'_>,
    told: &Told<'_>,
    read_file: ReadTable<'_>,
    asked: &Asked<'_>,
) -> Result<Option<Trial>, Vec<Problem>> {
    let schema = schema::with_travel(asked.reading.schema(&schema::TRIAL), &wiring);
    let (mut trial, mut problems) = build::<Trial>(document, "the scenario", &schema)?;
    let (rig, Some(run)) = (told.rig, &told.run) else {
        return without_problems(problems, None);
    };
    let drive = &wiring.nodes.drive.name;
    trial.run = Arc::clone(run);
    trial.plant = rig.model_of(drive, &files.path);
    trial.plants_beside = rig.models_beside(drive, &files.path);
    (trial.sensor, trial.amplifier) = rig.parts_of(drive);
    trial.wiring = wiring;
    if asked.reading != Reading::Recorded {
        let (section, law) = (Section::Controller, &mut trial.controller.custom);
        check_custom(document, section, section.key(), law, &mut problems);
    }
    trial.controller.scale(factors);
    problems.extend(check::trial(document, &trial, rig));
    if told.has_all_faults {
        problems.extend(check::reactions(document, &trial, rig));
    }
    problems.extend(check::read_tables(document, &mut trial, read_file));
    let mut named = NamedFiles {
        document,
        beside: "",
        named_by: SCENARIO,
        is_recorded: asked.reading == Reading::Recorded,
        read_file,
    };
    problems.extend(named.of_law(&trial.controller));
    trial.controller.place_files(Path::new(&files.name));
    let objections = (asked.objections)(&trial).into_iter();
    problems.extend(objections.map(|objection| objection.problem(document)));
    without_problems(problems, Some(trial))
}

/// Places an objection: in the scenario if that has a value at its path, else in the rig file.
fn objected(
    files: &Files<'_>,
    rig_document: &Document<'_>,
    rig: &Rig,
    mut objection: Objection,
) -> ScenarioError {
    let document = &files.scenario;
    let in_scenario = path_in_scenario(&objection.path, rig);
    let table = in_scenario.rsplit_once('.').map_or("", |(table, _)| table);
    let is_overlaid = document.has(&in_scenario) || document.has(table);
    if is_overlaid || objection.path.starts_with(SWEEP_PREFIX) {
        objection.path = in_scenario;
        return ScenarioError::new(KIND, &files.name, vec![objection.problem(document)]);
    }
    nodes::fail(&files.rig.name, vec![objection.problem(rig_document)])
}

/// Reads the facts of the run.
fn read_run<'a>(selector: &Selector<'a, '_>, problems: &mut Vec<Problem>) -> Told<'a> {
    let &Selector { scenario, rig } = selector;
    let (faults, wrong_faults) = fault::read(scenario, rig);
    let has_all_faults = wrong_faults.is_empty();
    problems.extend(wrong_faults);
    let header = scenario.only(&SHARED);
    let run = match build::<Run>(&header, "the scenario", &schema::RUN) {
        Ok((mut run, found)) => {
            problems.extend(found);
            (run.bus, run.faults) = (rig.bus.clone(), faults);
            // A length that is not positive is one problem; that events come after the end of the run is not a further one.
            if run.duration_seconds.is_nan() || run.duration_seconds <= 0.0 {
                run.duration_seconds = f64::INFINITY;
            }
            problems.extend(check::run(scenario, &run, rig));
            Some(Arc::new(run))
        }
        Err(found) => {
            problems.extend(found);
            None
        }
    };
    Told {
        rig,
        run,
        has_all_faults,
    }
}

/// Returns the path by which a scenario changes a value of its rig: without the name of the plant's model.
fn path_in_scenario(path: &str, rig: &Rig) -> String {
    let mut plants = rig.plant.iter();
    let short = plants.find_map(|(name, plant)| {
        let rest = path.strip_prefix(&format!("plant.{name}.{}.", plant.key()))?;
        Some(format!("plant.{name}.{rest}"))
    });
    short.unwrap_or_else(|| path.to_owned())
}

/// Finds faults that have no meaning for their plants.
fn wrong_plant_faults(
    document: &Document<'_>,
    run: &Run,
    loops: &[Trial],
    reading: Reading,
) -> Vec<Problem> {
    // Only the bench that played a plant from outside knows which faults have a meaning for it.
    let is_known = |one: &&Trial| one.plant.custom.is_none() || reading != Reading::Recorded;
    let plant_model = |fault: &Fault| {
        let is_at = |one: &&Trial| fault.is_at_drive(one.wiring.nodes.drive.id, &one.wiring.plant);
        let at = loops.iter().find(is_at).filter(is_known);
        at.map(|one| &one.plant)
    };
    check::faults_of_plants(document, &run.faults, plant_model)
}

/// Returns the programs of nodes, by the names of the nodes.
fn programs(rig: &Rig, files: &Files<'_>) -> BTreeMap<String, NodeProgram> {
    let programs = rig.node.iter().filter_map(|(name, node)| {
        let is_here = files.scenario.has(&format!("node.{name}.program"));
        let named_in = if is_here { "" } else { &files.rig.beside };
        let program = NodeProgram {
            command: node.program.clone()?,
            named_in: named_in.to_owned(),
        };
        Some((name.clone(), program))
    });
    programs.collect()
}

/// Finds the files of plants and nodes, and returns the EDS of external drives, with the problems of files that the rig file names.
/// Those of programs that the scenario names are added to `problems`.
fn find_files(
    (rig, programs): (&Rig, &BTreeMap<String, NodeProgram>),
    files: &Files<'_>,
    rig_document: &Document<'_>,
    reading: Reading,
    read_file: ReadTable<'_>,
    problems: &mut Vec<Problem>,
) -> (BTreeMap<String, String>, Vec<Problem>) {
    let mut wrong = Vec::new();
    let beside = files.rig.beside.as_str();
    let sheets = read_sheets(rig, rig_document, beside, read_file, &mut wrong);
    let is_recorded = reading == Reading::Recorded;
    let mut named_in_rig = NamedFiles {
        document: rig_document,
        beside,
        named_by: RIG_FILE,
        is_recorded,
        read_file: &mut *read_file,
    };
    wrong.extend(named_in_rig.of_plants(rig));
    // The files of a case were found before.
    for (node, program) in programs.iter().filter(|_| reading != Reading::Case) {
        let path = format!("node.{node}.program");
        let (document, named_by, into) = if files.scenario.has(&path) {
            (&files.scenario, SCENARIO, &mut *problems)
        } else {
            (rig_document, RIG_FILE, &mut wrong)
        };
        let mut files = NamedFiles {
            document,
            beside: &program.named_in,
            named_by,
            is_recorded,
            read_file: &mut *read_file,
        };
        into.extend(files.command(&path, &program.command, "a file of the node"));
    }
    (sheets, wrong)
}

/// Reads the EDS of each external drive for which the rig file, `beside` the scenario, names one.
fn read_sheets(
    rig: &Rig,
    document: &Document<'_>,
    beside: &str,
    read_file: ReadTable<'_>,
    problems: &mut Vec<Problem>,
) -> BTreeMap<String, String> {
    let mut sheets = BTreeMap::new();
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
    sheets
}
