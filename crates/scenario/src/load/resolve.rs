//! Resolves a scenario and the rig that it names into the facts of a run, in one pass that checks and builds.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::contours::read_contours;
use super::files::{Files, RigText};
use super::overlay::overlaid;
use super::sections::{CONTROLLER, Selector};
use super::sweep::read_sweep;
use super::{
    FindObjections, KIND, Objection, Reading, Texts, build, in_unit, nodes, read_law, reading,
    without_problems,
};
use crate::beside::Beside;
use crate::check;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::fault::{self, Fault};
use crate::fingerprint::HASH_SUFFIX;
use crate::outside::Outside;
use crate::rig::nodes::Rig;
use crate::run::{Header, Run};
use crate::scenario::{NodeProgram, Scenario};
use crate::schema;
use crate::table::{ReadTable, is_inside_folder};
use crate::trial::{Sections, Trial};
use crate::view::HIDDEN_FROM_CONTROLLER;
use crate::wiring::Wiring;

/// Beginning of paths that belong to the scenario: a rig file has none of these.
const SWEEP_PREFIX: &str = "sweep.";

/// Scenario in which a rig idles.
const IDLE: &str =
    "schema = 1\nname = \"idle\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n";

/// Finds a problem of a whole scenario, for an error at a place in the rig file, or in the scenario below `sweep`.
type FindObjection<'a> = &'a dyn Fn(&Scenario) -> Option<Objection>;

/// Purpose for which a scenario is resolved, and the caller's further checks.
struct Asked<'a> {
    reading: Reading,
    objections: FindObjections<'a>,
    object: FindObjection<'a>,
}

impl Scenario {
    /// Parses a scenario, the rig that it names, and its tables, and returns it with the texts that were read. `read_file`
    /// returns the text of a file by the name that the scenario uses; `beside` locates these files. `objections` finds further
    /// problems of a loop, `object` a problem of the rig.
    ///
    /// # Errors
    /// All problems of the texts, and every objection.
    pub fn parse(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
        objections: impl Fn(&Trial) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        let asked = Asked {
            reading: Reading::ToPlay,
            objections: &objections,
            object: &object,
        };
        parse_for(beside, text, &mut read_file, &asked)
    }

    /// Parses as [`Scenario::parse`], for a scenario with other values than one that was parsed before, on the same rig.
    ///
    /// # Errors
    /// As [`Scenario::parse`].
    pub fn parse_case(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<Self, ScenarioError> {
        let asked = Asked {
            reading: Reading::Case,
            objections: &|_| Vec::new(),
            object: &object,
        };
        parse_for(beside, text, &mut read_file, &asked).map(|(scenario, _)| scenario)
    }

    /// Parses as [`Scenario::parse`], for a scenario that was played already. Tables of plants and laws from outside are kept
    /// unchecked, whether this bench has these plants and laws or not. The sweep is not checked either.
    ///
    /// # Errors
    /// As [`Scenario::parse`], but for these tables.
    pub fn parse_recorded(
        beside: &Beside,
        text: String,
        objections: impl Fn(&Trial) -> Vec<Objection>,
        object: impl Fn(&Self) -> Option<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        let asked = Asked {
            reading: Reading::Recorded,
            objections: &objections,
            object: &object,
        };
        // Hashes come from the recording.
        let read = &mut |name: &str| beside.read_text(name);
        parse_for(beside, text, read, &asked)
    }

    /// Parses as [`Scenario::parse`], without the tables that are hidden from the controller: disturbances, faults and limits are
    /// not read.
    ///
    /// # Errors
    /// As [`Scenario::parse`], for the tables that the controller sees.
    pub fn parse_view(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
    ) -> Result<(Self, Texts), ScenarioError> {
        let asked = Asked {
            reading: Reading::View,
            objections: &|_| Vec::new(),
            object: &|_| None,
        };
        parse_for(beside, text, &mut read_file, &asked)
    }

    /// Makes a scenario in which a rig idles; `name` is the source of its text.
    ///
    /// # Errors
    /// All problems of the rig file, and the objection.
    pub fn from_rig(
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
        let asked = Asked {
            reading: Reading::ToPlay,
            objections: &|_| Vec::new(),
            object: &object,
        };
        resolve(&files, &mut |file| beside.read(file), &asked)
    }
}

// Not generic: it would be compiled again, with all of TOML and every type of a scenario, in each crate that calls it.
fn parse_for(
    beside: &Beside,
    text: String,
    read_file: ReadTable<'_>,
    asked: &Asked<'_>,
) -> Result<(Scenario, Texts), ScenarioError> {
    let name = beside.scenario().display().to_string();
    let (scenario, mut texts) = reading(text, read_file, |text, read_file| {
        let mut files = Files::parse(text, &name, beside, asked.reading, read_file)?;
        if matches!(asked.reading, Reading::View) {
            for key in HIDDEN_FROM_CONTROLLER {
                files.scenario.remove(key);
            }
        }
        resolve(&files, read_file, asked)
    })?;
    if let Some((name, text)) = &scenario.shipped_rig {
        texts.tables.insert(name.clone(), text.clone());
    }
    Ok((scenario, texts))
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
    let as_written =
        (!matches!(reading, Reading::Case)).then(|| Rig::from_tree(&rig_document, reading));
    let as_written = as_written
        .transpose()
        .map_err(|problems| nodes::fail(rig_name, problems))?;
    let fail = |problems| ScenarioError::new(KIND, &files.name, problems);
    let overlaid = overlaid(document, as_written, rig_document.root(), reading);
    let (rig, mut problems) = overlaid.map_err(fail)?;
    let sheets = read_sheets(&rig, &rig_document, &files.rig.beside, read_file)
        .map_err(|problems| nodes::fail(rig_name, problems))?;
    find_fmus(&rig, files, &rig_document, reading, read_file)?;
    let programs = read_programs(
        &rig,
        files,
        &rig_document,
        reading,
        read_file,
        &mut problems,
    )?;
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
    let (run, has_all_faults) = read_run(&selector, &mut problems);
    let told = (run.as_ref(), has_all_faults);
    let loops = read_loops(&selector, files, told, read_file, asked, &mut problems);
    let contours = read_contours(document, &rig).unwrap_or_else(|found| {
        problems.extend(found);
        Vec::new()
    });
    // All loops together are checked once each of them is right.
    let run = match run {
        Some(run) if loops.len() == rig.loops.len() => run,
        _ => return Err(fail(problems)),
    };
    problems.extend(wrong_plant_faults(document, &run, &loops, reading));
    if !problems.is_empty() {
        return Err(fail(problems));
    }
    let sweep = match reading {
        Reading::ToPlay => read_sweep(document, &rig).map_err(fail)?,
        Reading::Case | Reading::Recorded | Reading::View => None,
    };
    let RigText {
        text,
        beside,
        is_shipped,
        ..
    } = &files.rig;
    let scenario = Scenario {
        run,
        loops,
        contours,
        sweep,
        sheets,
        has_unused_law: rig.is_led_by_program() && document.has(CONTROLLER),
        rig,
        programs,
        shipped_rig: is_shipped.then(|| (beside.clone(), text.clone())),
    };
    match (asked.object)(&scenario) {
        None => Ok(scenario),
        Some(objection) => Err(objected(files, &rig_document, &scenario.rig, objection)),
    }
}

/// Reads the trial of each loop, without loops that cannot be read. Also returns the facts of the run, and whether all of its
/// faults could be read.
fn read_loops(
    selector: &Selector<'_, '_>,
    files: &Files<'_>,
    (run, has_all_faults): (Option<&Arc<Run>>, bool),
    read_file: ReadTable<'_>,
    asked: &Asked<'_>,
    problems: &mut Vec<Problem>,
) -> Vec<Trial> {
    let Selector { scenario, rig } = *selector;
    let (tables, wrong_tables) = selector.select();
    problems.extend(wrong_tables);
    let mut loops = Vec::new();
    for one in tables {
        let wiring = rig.wiring_of(rig.drive_of_loop(&one.name));
        let measurand = wiring.feedback.measurand.clone();
        let mut reader = TrialReader {
            document: scenario.with_loop(one.tree, measurand.clone()),
            factors: &one.factors,
            rig,
            rig_path: &files.path,
            scenario_path: Path::new(&files.name),
            run,
            has_all_faults,
            read_file: &mut *read_file,
            asked,
        };
        match reader.read(wiring) {
            Ok(one) => loops.extend(one),
            Err(found) => problems.extend(in_unit(found, &measurand)),
        }
    }
    loops
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

/// Reads the facts of the run; `None` if the keys of the scenario cannot be read. The flag is false if some of the faults could
/// not be read.
fn read_run(selector: &Selector<'_, '_>, problems: &mut Vec<Problem>) -> (Option<Arc<Run>>, bool) {
    let Selector { scenario, rig } = selector;
    let (faults, wrong_faults) = fault::read(scenario, rig);
    let has_all_faults = wrong_faults.is_empty();
    problems.extend(wrong_faults);
    let run = read_header(selector, problems).map(|header| {
        let run = header.run(rig.bus.clone(), faults);
        problems.extend(check::run(scenario, &run, rig));
        Arc::new(run)
    });
    (run, has_all_faults)
}

/// Reads the keys of a scenario that are not tables; `None` if one of them cannot be read.
fn read_header(selector: &Selector<'_, '_>, problems: &mut Vec<Problem>) -> Option<Header> {
    let document = selector.scenario.with_root(selector.header());
    let built = build::<Header>(
        &document,
        &Outside::Registered,
        "the scenario",
        &schema::HEADER,
    );
    let (header, found) = match built {
        Ok((header, found)) => (Some(header), found),
        Err(found) => (None, found),
    };
    problems.extend(found);
    header
}

/// Reads the trial of one loop.
struct TrialReader<'a, 'text> {
    /// Tables of the loop; their keys, and the names in problems, are patterns.
    document: Document<'text>,
    factors: &'a [(String, f64)],
    rig: &'a Rig,
    rig_path: &'a Path,
    scenario_path: &'a Path,
    run: Option<&'a Arc<Run>>,
    /// False if some of the faults could not be read.
    has_all_faults: bool,
    read_file: ReadTable<'a>,
    asked: &'a Asked<'a>,
}

impl TrialReader<'_, '_> {
    /// Reads the trial; `None` if the facts of the run are not known.
    fn read(&mut self, wiring: Wiring) -> Result<Option<Trial>, Vec<Problem>> {
        let document = &self.document;
        let outside = match self.asked.reading {
            Reading::Recorded => Outside::recorded(document.root()),
            Reading::ToPlay | Reading::Case | Reading::View => Outside::Registered,
        };
        let schema = schema::with_travel(outside.schema(&schema::SECTIONS), &wiring);
        let built = build::<Sections>(document, &outside, "the scenario", &schema);
        let (sections, mut problems) = built?;
        let Some(run) = self.run else {
            return without_problems(problems, None);
        };
        let Sections {
            controller,
            reference,
            disturbance,
            expect,
        } = sections;
        let drive = &wiring.nodes.drive.name;
        let (sensor, amplifier) = self.rig.parts_of(drive);
        let mut trial = Trial {
            run: Arc::clone(run),
            controller,
            reference,
            disturbance,
            expect,
            plant: self.rig.model_of(drive, self.rig_path),
            plants_beside: self.rig.models_beside(drive, self.rig_path),
            sensor,
            amplifier,
            wiring,
        };
        read_law(
            document,
            &outside,
            &mut trial.controller.custom,
            &mut problems,
        );
        trial.controller.scale(self.factors);
        problems.extend(check::trial(document, &trial, self.rig));
        if self.has_all_faults {
            problems.extend(check::reactions(document, &trial, self.rig));
        }
        problems.extend(check::read_tables(document, &mut trial, self.read_file));
        problems.extend(check::read_courses(document, &mut trial, self.read_file));
        let is_recorded = matches!(self.asked.reading, Reading::Recorded);
        problems.extend(check::read_files(
            document,
            &trial.controller,
            is_recorded,
            self.read_file,
        ));
        trial.controller.place_files(self.scenario_path);
        let objections = (self.asked.objections)(&trial).into_iter();
        problems.extend(objections.map(|objection| objection.problem(document)));
        without_problems(problems, Some(trial))
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
    let is_known =
        |one: &&Trial| one.plant.custom.is_none() || !matches!(reading, Reading::Recorded);
    let plant_model = |fault: &Fault| {
        let is_at = |one: &&Trial| fault.is_at_drive(one.wiring.nodes.drive.id, &one.wiring.plant);
        let at = loops.iter().find(is_at).filter(is_known);
        at.map(|one| &one.plant)
    };
    check::faults_of_plants(document, &run.faults, plant_model)
}

/// Finds the FMUs of plants, and adds their hashes to the texts that were read. A recording may lack file and hash.
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
                (Err(error), Reading::ToPlay | Reading::Case | Reading::View) => {
                    Some(match error.kind() {
                        io::ErrorKind::NotFound => {
                            "there is no such file beside the rig file".to_owned()
                        }
                        _ => error.to_string(),
                    })
                }
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

/// Returns the reason why a file cannot belong to a plant, whether it exists or not.
fn wrong_name(file: &str) -> Option<&'static str> {
    match file {
        file if !is_inside_folder(file) => {
            Some("no absolute path, no `..`: it lies beside the rig file")
        }
        file if !file.ends_with(".fmu") => Some("its name must end in .fmu"),
        _ => None,
    }
}

/// Returns the programs of nodes, with their files; problems of a program that the scenario names are added to `problems`.
fn read_programs(
    rig: &Rig,
    files: &Files<'_>,
    rig_document: &Document<'_>,
    reading: Reading,
    read_file: ReadTable<'_>,
    problems: &mut Vec<Problem>,
) -> Result<BTreeMap<String, NodeProgram>, ScenarioError> {
    let document = &files.scenario;
    let named = |node: &str| {
        if document.has(&format!("node.{node}.program")) {
            ""
        } else {
            &files.rig.beside
        }
    };
    let all = || {
        let nodes = rig.node.iter();
        nodes.filter_map(|(name, node)| Some((name, node.program.as_ref()?)))
    };
    // The files of a case were found before.
    if !matches!(reading, Reading::Case) {
        let is_recorded = matches!(reading, Reading::Recorded);
        let in_rig = all().filter(|(name, _)| !named(name).is_empty());
        let (text, beside) = (rig_document, &files.rig.beside);
        let found = check::read_programs(text, in_rig, beside, is_recorded, read_file);
        if !found.is_empty() {
            return Err(nodes::fail(&files.rig.name, found));
        }
        let in_scenario = all().filter(|(name, _)| named(name).is_empty());
        problems.extend(check::read_programs(
            document,
            in_scenario,
            "",
            is_recorded,
            read_file,
        ));
    }
    let program = |(name, command): (&String, &Vec<String>)| {
        let program = NodeProgram {
            command: command.clone(),
            named_in: named(name).to_owned(),
        };
        (name.clone(), program)
    };
    Ok(all().map(program).collect())
}

/// Reads the EDS of each external drive for which the rig file, `beside` the scenario, names one.
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
    without_problems(problems, sheets)
}
