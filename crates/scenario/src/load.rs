//! Reads scenario files, each with the rig that it names, and resolves both into the facts of a run.
//!
//! Checks come in an order: first syntax, then keys, types and ranges against the schema, then values that must fit each other.

mod contours;
mod expect;
mod files;
mod fmus;
mod kind;
mod nodes;
mod overlay;
mod patterns;
mod resolve;
mod sections;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::io;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;

pub(crate) use files::RigText;
pub use kind::FileKind;
pub(crate) use kind::is_scenario;
pub(crate) use patterns::{Factor, Factors, Naming};
pub use resolve::Asked;
pub(crate) use sections::{ALL, CONTROLLER};

use crate::beside::Beside;
use crate::custom::{self, Custom, Section};
use crate::document::{Document, Meaning};
use crate::error::{Problem, ScenarioError};
use crate::file::read_text;
use crate::scenario::Scenario;
use crate::trial::Trial;
use crate::{schema, structure};

/// Longest scenario file.
pub(crate) const SCENARIO_BYTES_MAX: u64 = 1 << 20;
/// Kind of the file in messages.
const KIND: &str = "scenario";

/// Problem that only the caller can know, such as a signal that the bus does not have.
#[derive(Clone, Debug, PartialEq)]
pub struct Objection {
    /// Path of the place, as in `expect.signal.0.name`.
    pub path: String,
    /// Description of the problem.
    pub message: String,
    /// Label at the place.
    pub label: String,
    /// Advice to the user.
    pub help: Option<String>,
}

impl Objection {
    /// Makes an objection without advice.
    pub fn new(
        path: impl Into<String>,
        message: impl Into<String>,
        label: impl Into<String>,
    ) -> Self {
        Self {
            path: path.into(),
            message: message.into(),
            label: label.into(),
            help: None,
        }
    }

    /// Adds advice.
    #[must_use]
    pub fn with_help(self, help: impl Into<String>) -> Self {
        let help = Some(help.into());
        Self { help, ..self }
    }

    fn problem(self, document: &Document<'_>) -> Problem {
        let problem = document.problem(&self.path, self.message, self.label);
        match self.help {
            Some(help) => problem.with_help(help),
            None => problem,
        }
    }
}

/// Purpose for which a scenario is read.
#[derive(Clone, Copy, Default, PartialEq)]
pub enum Reading {
    /// To play it.
    #[default]
    ToPlay,
    /// To play it with other values than those with which its rig was checked.
    Case,
    /// To use its recording. Tables of plants and laws from outside are kept unchecked, whether this bench has these plants and
    /// laws or not. The sweep is not checked either.
    Recorded,
}

impl Reading {
    /// Returns the schema for this purpose.
    fn schema(self, schema: &'static Value) -> Cow<'static, Value> {
        match self {
            Self::Recorded => Cow::Owned(schema::recorded(schema)),
            Self::ToPlay | Self::Case => Cow::Borrowed(schema),
        }
    }
}

impl Trial {
    /// Reads the scenario of a rig with one loop, and the files that it names.
    ///
    /// # Errors
    /// The file cannot be read, or has problems, which the error lists; or the rig has several loops.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let beside = Beside::new(path);
        let read = |name: &str| beside.read(name);
        Self::parse(&text_of(path)?, &path.display().to_string(), read)
    }

    /// Parses as [`Trial::load`], from text. `file_name` names the text in errors; `read_table` returns the text of a table by
    /// the name that the scenario uses.
    ///
    /// # Errors
    /// As [`Trial::load`].
    pub fn parse(
        text: &str,
        file_name: &str,
        mut read_table: impl FnMut(&str) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        let beside = Beside::new(Path::new(file_name));
        let text = text.to_owned();
        let scenario = Scenario::parse(&beside, text, &mut read_table, &Asked::default())?;
        let count = scenario.loops.len();
        only_one(scenario.loops).ok_or_else(|| {
            let message = format!("its rig has {count} loops, and one is played here");
            ScenarioError::in_file(file_name, message)
        })
    }
}

/// Reads the text of a scenario's file.
///
/// # Errors
/// The file cannot be read.
pub fn text_of(path: &Path) -> Result<String, ScenarioError> {
    read_text(path, SCENARIO_BYTES_MAX).map_err(|error| ScenarioError::unreadable(path, &error))
}

/// Writes out the names of a loop's keys in its problems.
pub(crate) fn in_unit(problems: Vec<Problem>, meaning: &Meaning) -> Vec<Problem> {
    let problems = problems
        .into_iter()
        .map(|problem| problem.renamed(|text| meaning.name(text)));
    problems.collect()
}

/// Builds a type from the document, together with the problems that do not prevent it, such as values out of range. `what` names
/// the whole in messages, and `schema` is the schema of the type.
pub(crate) fn build<T: DeserializeOwned>(
    document: &Document<'_>,
    what: &str,
    schema: &Value,
) -> Result<(T, Vec<Problem>), Vec<Problem>> {
    let problems = structure::check(document, what, schema);
    match document.deserialize() {
        Ok(value) => Ok((value, problems)),
        Err(problem) if problems.is_empty() => Err(vec![problem]),
        Err(_) => Err(problems),
    }
}

/// Checks the table from outside at a path of a document, which is none if nobody registered it. A problem that its Rust type
/// finds is added if there is no other: the schema may have found the same.
fn check_custom(
    document: &Document<'_>,
    section: Section,
    path: &str,
    table: &mut Option<Custom>,
    problems: &mut Vec<Problem>,
) {
    let Some(name) = table.as_ref().map(Custom::name) else {
        return;
    };
    let registered = custom::find(section, name);
    let value = document.spanned(&format!("{path}.{name}"));
    let (Some(registered), Some(value)) = (registered, value) else {
        *table = None;
        return;
    };
    if let Err(error) = (registered.check)(value.clone())
        && problems.is_empty()
    {
        let span = error.span().unwrap_or_else(|| value.span());
        let source = &document.source;
        problems.push(source.problem(span, "invalid value", error.message()));
    }
}

/// Returns the only one of some things; `None` if there are none or several.
pub(crate) fn only_one<T>(things: impl IntoIterator<Item = T>) -> Option<T> {
    let mut things = things.into_iter();
    things.next().filter(|_| things.next().is_none())
}

pub(crate) fn without_problems<T>(problems: Vec<Problem>, value: T) -> Result<T, Vec<Problem>> {
    if problems.is_empty() {
        Ok(value)
    } else {
        Err(problems)
    }
}
