//! Reads scenario files.
//!
//! Syntax first, then keys, types and ranges against the schema, then what only makes sense together.

mod kind;
mod loops;
mod nodes;
mod rig;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use toml::de::ValueDeserializer;

pub(crate) use loops::InUnit;

use crate::check;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::fault::{self, Faults, NodesOfRun};
use crate::file::read_text;
use crate::fingerprint::{HASH_SUFFIX, hash_line};
use crate::outside::{self, Outside};
use crate::own::{Own, Section};
use crate::plant::Sensor;
use crate::port::Unit;
use crate::rig::nodes::Rig;
use crate::scenario::Scenario;
use crate::table::ReadTable;
use crate::view::{ControllerView, HIDDEN_FROM_CONTROLLER};
use crate::wiring::Wiring;
use crate::{schema, structure};

/// Longest scenario file.
pub(crate) const SCENARIO_BYTES_MAX: u64 = 1 << 20;
/// What the file is for people.
const KIND: &str = "scenario";
/// Longest table.
const TABLE_BYTES_MAX: u64 = 64 << 20;

/// Something wrong that only the caller can know, such as a signal that the bus does not have.
#[derive(Clone, Debug, PartialEq)]
pub struct Objection {
    /// Where, as in `expect.signal.0.name`.
    pub path: String,
    /// What is wrong.
    pub message: String,
    /// What stands at the place.
    pub label: String,
    /// What to do.
    pub help: Option<String>,
}

impl Objection {
    fn problem(self, document: &Document<'_>) -> Problem {
        let problem = document.problem(&self.path, self.message, self.label);
        match self.help {
            Some(help) => problem.with_help(help),
            None => problem,
        }
    }
}

/// What was read of a scenario, to the byte.
#[derive(Clone, Debug, Default)]
pub struct Texts {
    /// The scenario's file.
    pub scenario: String,
    /// The tables beside it, and the rig file that it names, by the names that the scenario uses.
    pub tables: BTreeMap<String, String>,
}

/// What a scenario is read for.
#[derive(Clone, Copy)]
enum Reading {
    ToPlay,
    /// It was played already.
    Recorded,
}

/// The facts of a run that a loop's tree does not hold.
struct OfRun {
    wiring: Wiring,
    faults: Faults,
}

/// Finds what else is wrong with a scenario.
type FindObjections<'a> = &'a dyn Fn(&Scenario) -> Vec<Objection>;

// The functions that deserialize take trait objects: a generic one would be compiled again, with all of TOML and every
// type of a scenario, in each crate that calls it.
impl Scenario {
    /// Reads a scenario file and the tables that it names.
    ///
    /// # Errors
    /// The file cannot be read, or everything that is wrong in it.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        Self::load_for(path, Reading::ToPlay, &|_| Vec::new()).map(|(scenario, _)| scenario)
    }

    /// As [`Scenario::load`], with the very texts that were read. `objections` says what else is wrong.
    ///
    /// # Errors
    /// As [`Scenario::load`], and every objection.
    pub fn load_with_text(
        path: &Path,
        objections: impl Fn(&Self) -> Vec<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        Self::load_for(path, Reading::ToPlay, &objections)
    }

    /// As [`Scenario::load_with_text`], for a text that is at hand; the tables that it names lie beside `path`.
    ///
    /// # Errors
    /// Everything that is wrong in the text and its tables, and every objection.
    pub fn parse_beside(
        path: &Path,
        text: String,
        objections: impl Fn(&Self) -> Vec<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        parse_beside(path, text, |text, name, read_table| {
            Self::parse_for(text, name, read_table, Reading::ToPlay, &objections)
        })
    }

    /// As [`Scenario::parse_beside`], for tables that `read_table` gives by their names.
    ///
    /// # Errors
    /// As [`Scenario::parse_beside`].
    pub fn parse_with(
        path: &Path,
        text: String,
        read_table: impl FnMut(&str) -> io::Result<String>,
        objections: impl Fn(&Self) -> Vec<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        reading(path, text, read_table, |text, name, read_table| {
            Self::parse_for(text, name, read_table, Reading::ToPlay, &objections)
        })
    }

    /// As [`Scenario::load_with_text`], for a scenario that was played already: tables of plants and laws from outside are
    /// kept as they are, whether this bench has these plants and laws or not, and nothing in them is checked. Nor is what
    /// a sweep would vary.
    ///
    /// # Errors
    /// As [`Scenario::load_with_text`], but for these tables.
    pub fn load_recorded(
        path: &Path,
        objections: impl Fn(&Self) -> Vec<Objection>,
    ) -> Result<(Self, Texts), ScenarioError> {
        Self::load_for(path, Reading::Recorded, &objections)
    }

    /// Whether a text may be meant as a scenario, of whatever schema: it has a key that no rig file has, or is not even TOML.
    #[must_use]
    pub fn may_be(text: &str) -> bool {
        let keys = ["duration_seconds", "controller", "reference", "rig"];
        match Document::parse(Source::new("", text), text) {
            Ok(document) => keys.iter().any(|key| document.has(key)),
            Err(_) => true,
        }
    }

    fn load_for(
        path: &Path,
        reading: Reading,
        find_objections: FindObjections<'_>,
    ) -> Result<(Self, Texts), ScenarioError> {
        load(path, |text, name, read_table| {
            Self::parse_for(text, name, read_table, reading, find_objections)
        })
    }

    /// Reads a scenario from text. `file_name` names it in errors; `read_table` gives the text of a table by the
    /// name that the scenario uses.
    ///
    /// # Errors
    /// Everything that is wrong in the text and its tables.
    pub fn parse(
        text: &str,
        file_name: &str,
        mut read_table: impl FnMut(&str) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        Self::parse_for(text, file_name, &mut read_table, Reading::ToPlay, &|_| {
            Vec::new()
        })
    }

    fn parse_for(
        text: &str,
        file_name: &str,
        read_table: ReadTable<'_>,
        reading: Reading,
        find_objections: FindObjections<'_>,
    ) -> Result<Self, ScenarioError> {
        let fail = |problems| ScenarioError::new(KIND, file_name, problems);
        let document = Document::parse(Source::new(file_name, text), text).map_err(fail)?;
        if kind::is_rig_of_one_drive(&document) {
            let help = "scenarios are played on it: canrig run SCENARIO --rig FILE";
            let problem = document.problem("name", "this is a rig file, not a scenario", "a rig");
            return Err(fail(vec![problem.with_help(help)]));
        }
        if document.has("rig") {
            let message = "a scenario of schema 1 is of one drive, and names no rig file";
            let problem = document.problem("rig", message, "is of schema 2");
            let problem = match document.has("schema") {
                true => problem.with_place(document.span("schema"), "not 2"),
                false => problem,
            };
            let help = "write schema = 2; or leave `rig` out, and play on a rig file of schema 1 by: canrig run SCENARIO --rig FILE";
            return Err(fail(vec![problem.with_help(help)]));
        }
        let (faults, problems) = fault::read(&document, NodesOfRun::OfOneDrive);
        let of_run = OfRun {
            wiring: Wiring::default(),
            faults,
        };
        let scenario = Self::read(&document, read_table, reading, find_objections, of_run);
        scenario
            .and_then(|scenario| none_of(problems, scenario))
            .map_err(fail)
    }

    /// Reads a scenario from its tree.
    fn read(
        document: &Document<'_>,
        read_table: ReadTable<'_>,
        reading: Reading,
        find_objections: FindObjections<'_>,
        of_run: OfRun,
    ) -> Result<Self, Vec<Problem>> {
        let unit = of_run.wiring.unit.clone();
        let read = Self::read_wired(document, read_table, reading, find_objections, of_run);
        read.map_err(|problems| in_unit(problems, &unit))
    }

    /// As [`Scenario::read`]; problems have the names of positions in millimetres.
    fn read_wired(
        document: &Document<'_>,
        read_table: ReadTable<'_>,
        reading: Reading,
        find_objections: FindObjections<'_>,
        OfRun { wiring, faults }: OfRun,
    ) -> Result<Self, Vec<Problem>> {
        let outside = match reading {
            Reading::ToPlay => Outside::Registered,
            Reading::Recorded => Outside::from_recording(document.root()),
        };
        let (mut scenario, mut problems) = build::<Self>(
            document,
            &outside,
            "the scenario",
            &schema::of_travel(outside.schema(), &wiring),
        )?;
        put_range_into(&mut scenario.plant.sensor, &wiring);
        (scenario.wiring, scenario.faults) = (wiring, faults);
        let (plant, controller) = (&mut scenario.plant.own, &mut scenario.controller.own);
        for (section, own) in [(Section::Plant, plant), (Section::Controller, controller)] {
            read_own(document, &outside, section, own, &mut problems);
        }
        let control = check::Control {
            duration_seconds: scenario.duration_seconds,
            controller: &scenario.controller,
            reference: &scenario.reference,
            wiring: &scenario.wiring,
        };
        problems.extend(check::control(document, &control));
        problems.extend(check::name(document, &scenario.name));
        problems.extend(check::bench(document, &scenario, &outside));
        if !outside.is_recorded() {
            let plant = scenario.plant.name();
            problems.extend(check::sweep(document, plant, scenario.sweep.as_mut()));
        }
        problems.extend(check::read_tables(
            document,
            &mut scenario.reference,
            &mut scenario.controller,
            &scenario.wiring,
            read_table,
        ));
        problems.extend(check::read_courses(
            document,
            &mut scenario.expect.signal,
            scenario.duration_seconds,
            read_table,
        ));
        let objections = find_objections(&scenario).into_iter();
        problems.extend(objections.map(|objection| objection.problem(document)));
        none_of(problems, scenario)
    }
}

impl ControllerView {
    /// Reads what the controller may know of a scenario file; the other tables are dropped unread.
    ///
    /// # Errors
    /// As [`Scenario::load`], for the tables that the controller sees.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        load(path, Self::parse_view).map(|(view, _)| view)
    }

    /// Reads what the controller may know of a scenario from text; as [`Scenario::parse`].
    ///
    /// # Errors
    /// Everything that is wrong in what the controller sees.
    pub fn parse(
        text: &str,
        file_name: &str,
        mut read_table: impl FnMut(&str) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        Self::parse_view(text, file_name, &mut read_table)
    }

    fn parse_view(
        text: &str,
        file_name: &str,
        read_table: ReadTable<'_>,
    ) -> Result<Self, ScenarioError> {
        let fail = |problems| ScenarioError::new(KIND, file_name, problems);
        let mut document = Document::parse(Source::new(file_name, text), text).map_err(fail)?;
        Self::read(&mut document, read_table, Wiring::default()).map_err(fail)
    }

    /// Reads what the controller may know from a scenario's tree.
    fn read(
        document: &mut Document<'_>,
        read_table: ReadTable<'_>,
        wiring: Wiring,
    ) -> Result<Self, Vec<Problem>> {
        let unit = wiring.unit.clone();
        let read = Self::read_wired(document, read_table, wiring);
        read.map_err(|problems| in_unit(problems, &unit))
    }

    fn read_wired(
        document: &mut Document<'_>,
        read_table: ReadTable<'_>,
        wiring: Wiring,
    ) -> Result<Self, Vec<Problem>> {
        let plant = outside::plant_name(document.root());
        for key in HIDDEN_FROM_CONTROLLER {
            document.remove(key);
        }
        let outside = Outside::Registered;
        let (mut view, mut problems) = build::<Self>(
            document,
            &outside,
            "the scenario",
            &schema::of_travel(Cow::Borrowed(&schema::CONTROLLER_VIEW), &wiring),
        )?;
        (view.plant, view.wiring) = (plant, wiring);
        let own = &mut view.controller.own;
        read_own(document, &outside, Section::Controller, own, &mut problems);
        let control = check::Control {
            duration_seconds: view.duration_seconds,
            controller: &view.controller,
            reference: &view.reference,
            wiring: &view.wiring,
        };
        problems.extend(check::control(document, &control));
        problems.extend(check::read_tables(
            document,
            &mut view.reference,
            &mut view.controller,
            &view.wiring,
            read_table,
        ));
        none_of(problems, view)
    }
}

/// Problems of a loop in its own unit.
pub(crate) fn in_unit(problems: Vec<Problem>, unit: &Unit) -> Vec<Problem> {
    let problems = problems.into_iter();
    let problems = problems.map(|problem| problem.renamed(|text| unit.rename_keys(text)));
    problems.collect()
}

/// The converter of a sensor goes from the lowest position to the highest.
fn put_range_into(sensor: &mut Sensor, wiring: &Wiring) {
    if let Some(max) = wiring.position_max {
        sensor.span_millimetres = max - wiring.position_min;
    }
}

/// Reads a file and hands it to `parse` with a reader of the tables beside it.
fn load<T>(
    path: &Path,
    parse: impl FnOnce(&str, &str, ReadTable<'_>) -> Result<T, ScenarioError>,
) -> Result<(T, Texts), ScenarioError> {
    let scenario = read_text(path, SCENARIO_BYTES_MAX)
        .map_err(|error| ScenarioError::unreadable(KIND, &path.display().to_string(), &error))?;
    parse_beside(path, scenario, parse)
}

/// Hands a text to `parse` with a reader of the tables beside its file, and of the hashes of what is no table.
fn parse_beside<T>(
    path: &Path,
    scenario: String,
    parse: impl FnOnce(&str, &str, ReadTable<'_>) -> Result<T, ScenarioError>,
) -> Result<(T, Texts), ScenarioError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let read = |name: &str| match name.strip_suffix(HASH_SUFFIX) {
        Some(file) => hash_line(folder, file),
        None => read_table(folder, name),
    };
    reading(path, scenario, read, parse)
}

/// As [`parse_beside`], for what was played: hashes are those that were written then.
fn parse_recorded<T>(
    path: &Path,
    scenario: String,
    parse: impl FnOnce(&str, &str, ReadTable<'_>) -> Result<T, ScenarioError>,
) -> Result<(T, Texts), ScenarioError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    reading(path, scenario, |name| read_table(folder, name), parse)
}

/// Hands a text to `parse` with a reader of its tables, and keeps what was read.
fn reading<T>(
    path: &Path,
    scenario: String,
    mut read_table: impl FnMut(&str) -> io::Result<String>,
    parse: impl FnOnce(&str, &str, ReadTable<'_>) -> Result<T, ScenarioError>,
) -> Result<(T, Texts), ScenarioError> {
    let name = path.display().to_string();
    let mut tables = BTreeMap::new();
    // A table that is named twice is read once.
    let read_table = &mut |name: &str| match tables.get(name) {
        Some(text) => Ok(String::clone(text)),
        None => {
            let text = read_table(name)?;
            tables.insert(name.to_owned(), text.clone());
            Ok(text)
        }
    };
    let parsed = parse(&scenario, &name, read_table)?;
    Ok((parsed, Texts { scenario, tables }))
}

/// Reads a table beside the scenario, and refuses links that lead out of the folder.
fn read_table(folder: &Path, table: &str) -> io::Result<String> {
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let path = folder.join(table).canonicalize()?;
    if !path.starts_with(folder.canonicalize()?) {
        return Err(io::Error::other("it lies outside the scenario's folder"));
    }
    read_text(&path, TABLE_BYTES_MAX)
}

/// Builds a type from the document. With it come the problems that did not prevent that, such as values out of range.
/// `what` names the whole for people, and `schema` is that of the type.
pub(crate) fn build<T: DeserializeOwned>(
    document: &Document<'_>,
    outside: &Outside,
    what: &str,
    schema: &Value,
) -> Result<(T, Vec<Problem>), Vec<Problem>> {
    let problems = structure::check(document, what, schema);
    match document.deserialize(outside) {
        Ok(value) => Ok((value, problems)),
        Err(problem) if problems.is_empty() => Err(vec![problem]),
        Err(_) => Err(problems),
    }
}

/// The table from outside at a path of a document, if there is one, and what its own type finds wrong with it.
fn own_table(
    document: &Document<'_>,
    outside: &Outside,
    section: Section,
    path: &str,
) -> Option<(Own, Option<Problem>)> {
    let keys = document.keys(path);
    let mut names = outside.names(section).into_iter();
    let name = names.find(|name| keys.contains(name))?;
    let value = document.spanned(&format!("{path}.{name}"))?;
    let problem = |error: toml::de::Error| {
        let span = error.span().unwrap_or_else(|| value.span());
        (document.source).problem(span, "invalid value", error.message())
    };
    let checked = outside
        .check(section, name, value.clone())
        .err()
        .map(problem);
    let table =
        toml::Table::deserialize(ValueDeserializer::from(value.clone())).unwrap_or_default();
    Some((Own::new(name, table), checked))
}

/// Reads the table of a plant or a law from outside; what the schema said of it already is not said twice.
fn read_own(
    document: &Document<'_>,
    outside: &Outside,
    section: Section,
    into: &mut Option<Own>,
    problems: &mut Vec<Problem>,
) {
    let Some((own, problem)) = own_table(document, outside, section, section.key()) else {
        return;
    };
    *into = Some(own);
    if problems.is_empty() {
        problems.extend(problem);
    }
}

/// Reads the models of plants from outside; what the schema said of them already is not said twice.
fn read_models(
    document: &Document<'_>,
    outside: &Outside,
    rig: &mut Rig,
    problems: &mut Vec<Problem>,
) {
    for (name, plant) in &mut rig.plant {
        let path = format!("plant.{name}");
        let Some((own, problem)) = own_table(document, outside, Section::Plant, &path) else {
            continue;
        };
        plant.own = Some(own);
        if problems.is_empty() {
            problems.extend(problem);
        }
    }
}

pub(crate) fn none_of<T>(problems: Vec<Problem>, value: T) -> Result<T, Vec<Problem>> {
    if problems.is_empty() {
        Ok(value)
    } else {
        Err(problems)
    }
}
