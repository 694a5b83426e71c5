//! Resolves a scenario and the rig that it names into the facts of a run, in one pass that checks and builds.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::contours::read_contours;
use super::expect::{is_shared, keep_part, of_no_loop};
use super::files::{Files, RigText};
use super::overlay::overlaid;
use super::sections::{CONTROLLER, DISTURBANCE, EXPECT, SHARED, Selector};
use super::{
    Factor, KIND, Objection, Reading, build, check_custom, in_unit, nodes, without_problems,
};
use crate::beside::Beside;
use crate::check::{self, Check, NamedFiles};
use crate::custom::Section;
use crate::document::{Document, KeyContext};
use crate::error::{Problem, ScenarioError, Source};
use crate::fault;
use crate::node::{NodeProgram, Nodes};
use crate::rig::nodes::Rig;
use crate::run::Run;
use crate::scenario::{Scenario, Shared};
use crate::schema;
use crate::table::ReadTable;
use crate::trial::Trial;
use crate::wiring::Wiring;

/// Names of both files in messages.
const SCENARIO: &str = "the scenario";
const RIG_FILE: &str = "the rig file";
/// Table of a scenario that a rig file does not have.
const SWEEP: &str = "sweep";

/// Scenario in which a rig idles.
const IDLE: &str =
    "schema = 1\nname = \"idle\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n";

type Objections<'a> = dyn Fn(&Trial) -> Vec<Objection> + 'a;

/// Purpose for which a scenario is read, and the caller's further checks.
#[derive(Default)]
pub struct Asked<'a> {
    /// Purpose.
    pub reading: Reading,
    /// Finds further problems of a loop.
    pub objections: Option<&'a Objections<'a>>,
}

impl Scenario {
    /// Parses a scenario, the rig that it names, and its tables. `read_file` returns the text of a file by the name that the
    /// scenario uses; `beside` locates these files.
    ///
    /// # Errors
    /// All problems of the texts, and every objection to a loop.
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
        let mut scenario = resolve(files, read_once, asked)?;
        let rig = &scenario.rig_text;
        // A rig that ships was not read from a file.
        let rig_text = || rig.text.clone();
        tables.entry(rig.beside.clone()).or_insert_with(rig_text);
        let shared = &mut scenario.shared;
        (shared.beside, shared.text, shared.tables) = (beside.clone(), text, tables);
        Ok(scenario)
    }

    /// Makes a scenario in which a rig idles; `name` is the source of its text.
    ///
    /// # Errors
    /// All problems of the rig file.
    pub fn from_rig(text: &str, name: &str) -> Result<Self, ScenarioError> {
        let fail = |problems| ScenarioError::new(KIND, name, problems);
        let scenario = Document::parse(Source::new(name, IDLE), IDLE).map_err(fail)?;
        let beside = Beside::new(Path::new(name));
        let files = Files {
            name: name.to_owned(),
            scenario,
            rig: RigText {
                text: text.to_owned(),
                name: name.to_owned(),
                ..RigText::default()
            },
            path: PathBuf::from(name),
        };
        let read_file = &mut |file: &str| beside.read(file);
        let mut scenario = resolve(files, read_file, &Asked::default())?;
        scenario.shared.beside = beside;
        Ok(scenario)
    }

    /// Makes the error of an objection to the whole scenario: at its place in the scenario if that has a value there, or varies
    /// one, else in the rig file.
    pub fn objected(&self, mut objection: Objection) -> ScenarioError {
        let (shared, rig_text) = (&self.shared, &self.rig_text);
        let name = shared.beside.scenario().display().to_string();
        let fail = |problems| ScenarioError::new(KIND, &name, problems);
        let document = match Document::parse(Source::new(&name, &shared.text), &shared.text) {
            Ok(document) => document,
            Err(problems) => return fail(problems),
        };
        let in_scenario = path_in_scenario(&objection.path, &shared.rig);
        let table = in_scenario.rsplit_once('.').map_or("", |(table, _)| table);
        let is_overlaid = document.has(&in_scenario) || document.has(table);
        if is_overlaid || objection.path.starts_with(SWEEP) {
            objection.path = in_scenario;
            return fail(vec![objection.problem(&document)]);
        }
        match Rig::document(&rig_text.text, &rig_text.name) {
            Ok(document) => nodes::fail(&rig_text.name, vec![objection.problem(&document)]),
            Err(error) => error,
        }
    }
}

fn resolve(
    files: Files<'_>,
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
    let (rig, problems) = overlaid.map_err(fail)?;
    let programs = programs(&rig, &files);
    let nodes = rig.nodes(&programs);
    let nodes = nodes.ok_or_else(|| without_controller(&rig_document, rig_name))?;
    let mut resolver = Resolver {
        files: &files,
        check: Check::new(document, &rig, problems),
        rig_check: Check::new(&rig_document, &rig, Vec::new()),
        read_file,
        asked,
        run: None,
        has_all_faults: false,
        has_all_disturbances: true,
    };
    let sheets = resolver.read_sheets();
    resolver.find_files(&programs);
    if !resolver.rig_check.problems.is_empty() {
        return Err(nodes::fail(rig_name, resolver.rig_check.problems));
    }
    let selector = Selector {
        scenario: document,
        rig: &rig,
        shared: rig.shared(&nodes),
    };
    // A misspelt table is one problem; the keys that are then missing are not further ones.
    let unknown = selector.unknown_keys();
    if !unknown.is_empty() {
        resolver.check.add(unknown);
        return Err(fail(resolver.check.problems));
    }
    resolver.read_run(&nodes);
    let wiring = Arc::clone(&selector.shared);
    let mut loops = resolver.read_loops(&selector);
    let mut check = resolver.check;
    let contours = read_contours(document, &rig, &loops).unwrap_or_else(|found| {
        check.add(found);
        Vec::new()
    });
    // All loops together are checked once each of them is right.
    let run = match resolver.run {
        Some(run) if loops.len() == rig.loops.len() => run,
        _ => return Err(fail(check.problems)),
    };
    check::faults_of_loops(&mut check, &run.faults, &loops, reading);
    let mut sweep = run.sweep.clone();
    if let Some(sweep) = sweep.as_mut().filter(|_| check.problems.is_empty()) {
        check::sweep(&mut check, sweep);
    }
    if !check.problems.is_empty() {
        return Err(fail(check.problems));
    }
    let nodes = with_tested_controller(nodes, &mut loops);
    let shared = Shared {
        run,
        contours,
        sweep,
        has_unused_law: rig.is_led_by_program() && document.has(CONTROLLER),
        rig: Arc::new(rig),
        ..Shared::default()
    };
    Ok(Scenario {
        shared,
        nodes,
        wiring,
        rig_path: files.path,
        loops,
        sheets,
        rig_text: files.rig,
    })
}

/// Refuses a rig without a controller.
fn without_controller(document: &Document<'_>, rig_name: &str) -> ScenarioError {
    let label = "no node has kind = \"controller\"";
    let problem = document.key_problem("node", "nobody leads the drives", label);
    nodes::fail(rig_name, vec![problem])
}

/// Returns the nodes of a run with these loops, which they get, too: the controller is under test if its law is a process.
fn with_tested_controller(nodes: Nodes, loops: &mut [Trial]) -> Nodes {
    let mut laws = loops.iter().map(|one| one.controller.process_law());
    if laws.all(|law| law.is_none()) {
        return nodes;
    }
    let manager = nodes.manager();
    let nodes = nodes.changed(|index, node| node.is_under_test |= index == manager);
    for one in loops {
        one.wiring.set_nodes(&nodes);
    }
    nodes
}

/// Reader of the facts and the trials of a run.
struct Resolver<'a> {
    files: &'a Files<'a>,
    /// Problems of the scenario, and the rig with the scenario's values in it.
    check: Check<'a>,
    /// Problems of the rig file.
    rig_check: Check<'a>,
    read_file: ReadTable<'a>,
    asked: &'a Asked<'a>,
    /// Facts of the run; `None` if they cannot be read.
    run: Option<Arc<Run>>,
    /// Whether all faults could be read, and all disturbances.
    has_all_faults: bool,
    has_all_disturbances: bool,
}

impl Resolver<'_> {
    /// Reads the facts of the run.
    fn read_run(&mut self, nodes: &Nodes) {
        let (scenario, rig) = (&self.files.scenario, self.check.rig);
        let (faults, wrong_faults) = fault::read(scenario, rig, nodes);
        self.has_all_faults = wrong_faults.is_empty();
        self.check.add(wrong_faults);
        let is_swept = self.asked.reading == Reading::ToPlay;
        let sweep = is_swept.then_some(SWEEP);
        let has_loops = !rig.loops.is_empty();
        if !has_loops {
            self.check.add(of_no_loop(scenario));
        }
        let has_limits = scenario
            .keys(EXPECT)
            .into_iter()
            .any(|key| !has_loops || is_shared(key));
        let expect = has_limits.then_some(EXPECT);
        let read = |tables: [Option<&str>; 2]| {
            let tables = tables.into_iter().flatten();
            let keys = SHARED.into_iter().chain(expect).chain(tables);
            let mut header = scenario.only(&Vec::from_iter(keys));
            header.rewrite(|root| {
                if let Some(expect) = root.get_mut(EXPECT).filter(|_| has_loops) {
                    keep_part(expect.get_mut(), true);
                }
            });
            build::<Run>(&header, "the scenario", &schema::RUN)
        };
        // A sweep or a disturbance that cannot be read hides no problem of the loops, only those of the other disturbances.
        let table = Some(DISTURBANCE);
        let attempts = [[sweep, table], [None, table], [sweep, None], [None, None]];
        let mut found = None;
        let built = attempts.into_iter().find_map(|tables| {
            let (run, problems) = match read(tables) {
                Ok((run, problems)) => (Some(run), problems),
                Err(problems) => (None, problems),
            };
            found.get_or_insert(problems);
            Some((run?, tables))
        });
        self.check.add(found.unwrap_or_default());
        let Some((mut run, [_, disturbance])) = built else {
            return;
        };
        self.has_all_disturbances = disturbance.is_some();
        (run.bus, run.faults) = (rig.bus.clone(), faults);
        run.disturbance.name_nodes(rig);
        // A length that is not positive is one problem; that events come after the end of the run is not a further one.
        if run.duration_seconds.is_nan() || run.duration_seconds <= 0.0 {
            run.duration_seconds = f64::INFINITY;
        }
        check::run(&mut self.check, &run, nodes);
        self.run = Some(Arc::new(run));
    }

    /// Reads the trial of each loop, without loops that cannot be read.
    fn read_loops(&mut self, selector: &Selector<'_, '_>) -> Vec<Trial> {
        let run = self.run.clone().unwrap_or_default();
        let (tables, wrong_tables) = selector.select(&run.faults);
        self.check.add(wrong_tables);
        let mut loops = Vec::new();
        for one in tables {
            let key_context = KeyContext {
                quantities: one.wiring.quantities.clone(),
                measured: one.wiring.feedback.clone(),
                commands: one.wiring.amplifier.range(),
            };
            // The keys of its tables, and the names in problems, are patterns.
            let document = selector.scenario.with_loop(one.tree, key_context);
            match self.read_trial(&document, &one.factors, one.wiring) {
                Ok(one) => loops.extend(one),
                Err(found) => {
                    let found = as_written(found, &one.factors);
                    self.check.add(in_unit(found, &document.key_context));
                }
            }
        }
        loops
    }

    /// Reads the trial of one loop from its tables, with the factors for parameters of its law; `None` if the facts of the run are
    /// not known.
    fn read_trial(
        &mut self,
        document: &Document<'_>,
        factors: &[Factor],
        wiring: Wiring,
    ) -> Result<Option<Trial>, Vec<Problem>> {
        let (rig, reading, path) = (self.check.rig, self.asked.reading, &self.files.path);
        let schema = reading.schema(&schema::TRIAL);
        let (mut trial, mut problems) = build::<Trial>(document, "the scenario", &schema)?;
        let Some(run) = &self.run else {
            return without_problems(problems, None);
        };
        let drive = &wiring.drive().name;
        trial.run = Arc::clone(run);
        trial.plants = rig.emulated_with(drive, path);
        // A drive that moves no plant has the actuator of the paper.
        trial.plants.entry(wiring.plant.clone()).or_default();
        (trial.sensor, trial.amplifier) = rig.parts_of(drive);
        trial.wiring = wiring;
        if reading != Reading::Recorded {
            let (section, law) = (Section::Controller, &mut trial.controller.custom);
            check_custom(document, section, section.key(), law, &mut problems);
        }
        trial.controller.scale(factors);
        let mut check = Check::new(document, rig, problems);
        check::trial(&mut check, &trial);
        check::limits(&mut check, &trial, self.has_all_disturbances);
        if self.has_all_faults {
            check::reactions(&mut check, &trial);
        }
        check::read_tables(&mut check, &mut trial, self.read_file);
        let mut named = NamedFiles {
            check: &mut check,
            beside: "",
            named_by: SCENARIO,
            is_recorded: reading == Reading::Recorded,
            read_file: self.read_file,
        };
        named.of_law(&trial.controller);
        trial.controller.place_files(Path::new(&self.files.name));
        let found = self.asked.objections.map(|find| find(&trial));
        let objections = found.into_iter().flatten();
        check.add(objections.map(|objection| objection.problem(document)));
        without_problems(check.problems, Some(trial))
    }

    /// Finds the files of plants and nodes.
    fn find_files(&mut self, programs: &BTreeMap<String, NodeProgram>) {
        let is_recorded = self.asked.reading == Reading::Recorded;
        let mut named_in_rig = NamedFiles {
            check: &mut self.rig_check,
            beside: &self.files.rig.beside,
            named_by: RIG_FILE,
            is_recorded,
            read_file: self.read_file,
        };
        named_in_rig.of_plants();
        // The files of a case were found before.
        let is_case = self.asked.reading == Reading::Case;
        for (node, program) in programs.iter().filter(|_| !is_case) {
            let path = format!("node.{node}.program");
            let (check, named_by) = if self.check.document.has(&path) {
                (&mut self.check, SCENARIO)
            } else {
                (&mut self.rig_check, RIG_FILE)
            };
            let mut named = NamedFiles {
                check,
                beside: &program.named_in,
                named_by,
                is_recorded,
                read_file: self.read_file,
            };
            named.command(&path, &program.command, "a file of the node");
        }
    }

    /// Reads the EDS of each external drive for which the rig file names one.
    fn read_sheets(&mut self) -> BTreeMap<String, String> {
        let mut sheets = BTreeMap::new();
        for (name, node) in &self.check.rig.node {
            let Some(eds) = &node.eds else { continue };
            let place = Path::new(&self.files.rig.beside).with_file_name(eds);
            match (self.read_file)(&place.to_string_lossy()) {
                Ok(text) => drop(sheets.insert(name.clone(), text)),
                Err(error) => {
                    let (path, label) = (format!("node.{name}.eds"), error.to_string());
                    let message = format!("the EDS of `{name}` cannot be read");
                    self.rig_check.at(&path, message, label);
                }
            }
        }
        sheets
    }
}

/// Names gains in problems as the file names them.
fn as_written(problems: Vec<Problem>, gains: &[Factor]) -> Vec<Problem> {
    let renamed = |problem: Problem| {
        gains.iter().fold(problem, |problem, gain| {
            problem.renamed(|text| text.replace(&gain.path, &gain.written))
        })
    };
    problems.into_iter().map(renamed).collect()
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
