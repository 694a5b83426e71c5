//! Reads scenario files.
//!
//! Syntax first, then keys, types and ranges against the schema, then what only makes sense together.

mod kind;
mod loops;
mod nodes;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use toml::de::ValueDeserializer;

pub(crate) use loops::InUnit;

use crate::beside::Beside;
use crate::check;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::fault::Faults;
use crate::file::read_text;
use crate::loops::Loops;
use crate::outside::Outside;
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
    /// As `ToPlay`, with other values than those with which its rig was checked.
    Case,
    /// It was played already.
    Recorded,
}

/// The facts of a run that a loop's tree does not hold.
struct OfRun {
    wiring: Wiring,
    faults: Faults,
    /// False where some of the faults could not be read.
    has_all_faults: bool,
}

/// Finds what else is wrong with a scenario.
type FindObjections<'a> = &'a dyn Fn(&Scenario) -> Vec<Objection>;

impl Scenario {
    /// Reads the scenario of a rig with one loop, and the files that it names.
    ///
    /// # Errors
    /// The file cannot be read, or everything that is wrong in it; several loops are.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let beside = Beside::new(path);
        let read = |name: &str| beside.read(name);
        Self::parse(&text_of(path)?, &path.display().to_string(), read)
    }

    /// As [`Scenario::load`], from text. `file_name` names it in errors; `read_table` gives the text of a table by the name that the
    /// scenario uses.
    ///
    /// # Errors
    /// As [`Scenario::load`].
    pub fn parse(
        text: &str,
        file_name: &str,
        read_table: impl FnMut(&str) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        let beside = Beside::new(Path::new(file_name));
        let text = text.to_owned();
        let (loops, _) = Loops::parse(&beside, text, read_table, |_| Vec::new(), |_| None)?;
        loops.only(file_name)
    }

    /// Whether a text may be meant as a scenario: it has a key that no rig file has, or is not even TOML.
    #[must_use]
    pub fn may_be(text: &str) -> bool {
        match Document::parse(Source::new("", text), text) {
            Ok(document) => kind::is_scenario(&document),
            Err(_) => true,
        }
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
        OfRun {
            wiring,
            faults,
            has_all_faults,
        }: OfRun,
    ) -> Result<Self, Vec<Problem>> {
        let outside = match reading {
            Reading::ToPlay | Reading::Case => Outside::Registered,
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
        problems.extend(check::bench(document, &scenario));
        if has_all_faults {
            problems.extend(check::reactions(document, &scenario));
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
    /// Reads what the controller may know of the scenario of a rig with one loop; as [`Scenario::parse`].
    ///
    /// # Errors
    /// As [`Scenario::parse`], for what the controller sees.
    pub fn parse(
        text: &str,
        file_name: &str,
        read_table: impl FnMut(&str) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        let beside = Beside::new(Path::new(file_name));
        Loops::parse_view(&beside, text.to_owned(), read_table)?.only(file_name)
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
        view.wiring = wiring;
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

/// The text of a scenario's file.
///
/// # Errors
/// It cannot be read.
pub fn text_of(path: &Path) -> Result<String, ScenarioError> {
    read_text(path, SCENARIO_BYTES_MAX).map_err(|error| ScenarioError::unreadable(path, &error))
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

/// Hands a text to `parse` with a reader of the files that it names, and keeps what was read.
fn reading<T>(
    scenario: String,
    read_file: ReadTable<'_>,
    parse: impl FnOnce(&str, ReadTable<'_>) -> Result<T, ScenarioError>,
) -> Result<(T, Texts), ScenarioError> {
    let mut tables = BTreeMap::new();
    // A file that is named twice is read once.
    let read_file = &mut |name: &str| match tables.get(name) {
        Some(text) => Ok(String::clone(text)),
        None => {
            let text = read_file(name)?;
            tables.insert(name.to_owned(), text.clone());
            Ok(text)
        }
    };
    let parsed = parse(&scenario, read_file)?;
    Ok((parsed, Texts { scenario, tables }))
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
