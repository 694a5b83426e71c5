//! A TOML document that keeps the place of each value.

use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::error::{Problem, Source};
use crate::wiring::Measured;
use dbc::{CommandRange, Quantities};

/// Largest number of syntax errors that are shown; more follow from the first one, or the file is no TOML.
const SYNTAX_ERRORS_MAX: usize = 3;
/// Message of the parser on a key that it has read before.
const DUPLICATE: &str = "duplicate key";

/// The document as a tree with spans.
pub(crate) struct Document<'text> {
    pub(crate) source: Source,
    root: Spanned<DeTable<'text>>,
    /// Meaning of the keys, which are patterns: that of the loop whose tables these are.
    pub(crate) meaning: Meaning,
}

/// Meaning of the keys of a loop or a drive: its quantities fill their patterns, and its ranges limit their values.
#[derive(Clone, Debug, Default)]
pub(crate) struct Meaning {
    pub(crate) quantities: Quantities,
    pub(crate) measured: Measured,
    pub(crate) commands: CommandRange,
}

impl Meaning {
    /// Writes out the patterns in a text.
    pub(crate) fn name(&self, text: &str) -> String {
        self.quantities.name(text)
    }

    /// Returns the range of the values at a key with this pattern; `None` if its schema alone limits them.
    pub(crate) fn range_of(&self, pattern: &str) -> Option<[f64; 2]> {
        let ([lowest, highest], commands) = (self.measured.range(), &self.commands);
        match pattern {
            "{signal}_{unit}" | "centre_{unit}" => Some([lowest, highest]),
            "amplitude_{unit}" => Some([0.0, (highest - lowest) / 2.0]),
            "{command}_{command_unit}" => Some([commands.min, commands.max]),
            "{command}_{command_unit}_max" => Some([0.0, commands.max]),
            _ => None,
        }
    }
}

impl<'text> Document<'text> {
    /// Parses the text; only syntax errors are errors.
    pub(crate) fn parse(source: Source, text: &'text str) -> Result<Self, Vec<Problem>> {
        let (root, errors) = DeTable::parse_recoverable(text);
        let document = Self {
            source,
            root,
            meaning: Meaning::default(),
        };
        match errors.as_slice() {
            [] => Ok(document),
            errors => Err(document.syntax_problems(text, errors)),
        }
    }

    /// Returns the problems of the parser. A table that is given twice is one problem, not one for each of its keys.
    fn syntax_problems(&self, text: &str, errors: &[toml::de::Error]) -> Vec<Problem> {
        // An error at the end is shown at the last character, since there is no character after it to underline.
        let letters = text.trim_end().char_indices();
        let last = letters.last().map_or(0, |(at, _)| at);
        let headings = headings(text);
        let mut second_table = 0..0;
        let mut problems = Vec::new();
        let span = |error: &toml::de::Error| {
            let span = error.span().filter(|span| span.start <= last);
            span.unwrap_or(last..last)
        };
        let is_syntax = |error: &&toml::de::Error| error.message() != DUPLICATE;
        let mut syntax = errors.iter().filter(is_syntax);
        if let Some(first) = syntax.next()
            && let others @ SYNTAX_ERRORS_MAX.. = syntax.count()
        {
            let help = format!("{others} more lines are no TOML, perhaps because of this one");
            return vec![self.syntax_error(span(first), first).with_help(help)];
        }
        for error in errors {
            let span = span(error);
            let is_duplicate = error.message() == DUPLICATE;
            if is_duplicate && second_table.contains(&span.start) {
                continue;
            }
            let next = headings.partition_point(|(heading, _)| heading.start <= span.start);
            let heading = next.checked_sub(1).map(|place| &headings[place]);
            let is_it = |(heading, _): &&(Range<usize>, _)| heading.contains(&span.start);
            let Some((heading, path)) = heading.filter(is_it).filter(|_| is_duplicate) else {
                problems.push(self.syntax_error(span, error));
                continue;
            };
            let end = headings.get(next);
            second_table = heading.start..end.map_or(text.len(), |(next, _)| next.start);
            let message = format!("[{path}] stands twice");
            let mut problem = self.source.problem(span, message, "for the second time");
            let mut before = headings.iter().take(next - 1);
            if let Some((first, _)) = before.find(|(_, other)| other == path) {
                let first = first.start..first.start + text[first.clone()].trim_end().len();
                problem = problem.with_place(first, "here for the first time");
            }
            problems.push(problem.with_help("keep one of them"));
        }
        problems
    }

    fn syntax_error(&self, span: Range<usize>, error: &toml::de::Error) -> Problem {
        self.source
            .problem(span, "TOML syntax error", error.message())
    }

    /// Makes a document of parts of this one, whose problems point into its text.
    pub(crate) fn with_root(&self, root: DeTable<'text>) -> Self {
        Self {
            source: self.source.clone(),
            root: Spanned::new(self.root.span(), root),
            meaning: self.meaning.clone(),
        }
    }

    /// Makes a document of the values at some keys, as [`Document::with_root`].
    pub(crate) fn only(&self, keys: &[&str]) -> Self {
        let values = self
            .root()
            .iter()
            .filter(|(key, _)| keys.contains(&key.get_ref().as_ref()));
        let copies = values.map(|(key, value)| (key.clone(), value.clone()));
        self.with_root(copies.collect())
    }

    /// Makes a document of the tables of a loop, as [`Document::with_root`].
    pub(crate) fn with_loop(&self, root: DeTable<'text>, meaning: Meaning) -> Self {
        Self {
            meaning,
            ..self.with_root(root)
        }
    }

    /// Changes the tree; moved and copied values keep their places.
    pub(crate) fn rewrite(&mut self, change: impl FnOnce(&mut DeTable<'text>)) {
        change(self.root.get_mut());
    }

    /// Returns the whole document as a table.
    pub(crate) fn root(&self) -> &DeTable<'text> {
        self.root.get_ref()
    }

    /// Builds a type from the document without the faults, which have a reader of their own.
    pub(crate) fn deserialize<T: DeserializeOwned>(&self) -> Result<T, Problem> {
        let mut root = self.root.clone();
        root.get_mut().remove("fault");
        let deserializer = toml::Deserializer::from(root);
        T::deserialize(deserializer).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            self.source.problem(span, "invalid value", error.message())
        })
    }

    /// Returns the place of the value at a path such as `reference.step.1.at_seconds`; if it is absent, the place of the nearest
    /// table that would hold it.
    pub(crate) fn span(&self, path: &str) -> Range<usize> {
        self.walk(path).0
    }

    /// Returns the place of the key at a path; if it is absent, the place of the nearest table that would hold it.
    pub(crate) fn key_span(&self, path: &str) -> Range<usize> {
        self.walk(path).1
    }

    /// Returns the keys of the table at a path, in the order of the text.
    pub(crate) fn keys(&self, path: &str) -> Vec<&str> {
        let Some(table) = self.value(path).and_then(DeValue::as_table) else {
            return Vec::new();
        };
        let mut keys: Vec<_> = table.keys().collect();
        keys.sort_by_key(|key| key.span().start);
        keys.into_iter().map(|key| key.get_ref().as_ref()).collect()
    }

    /// Returns the entries of the array at a path.
    pub(crate) fn entries(&self, path: &str) -> &[Spanned<DeValue<'text>>] {
        let array = self.value(path).and_then(DeValue::as_array);
        array.map_or(&[], |array| array)
    }

    /// Makes a problem at the value at a path.
    pub(crate) fn problem(
        &self,
        path: &str,
        message: impl Into<String>,
        label: impl Into<String>,
    ) -> Problem {
        self.source.problem(self.span(path), message, label)
    }

    /// Makes a problem at the key at a path.
    pub(crate) fn key_problem(
        &self,
        path: &str,
        message: impl Into<String>,
        label: impl Into<String>,
    ) -> Problem {
        self.source.problem(self.key_span(path), message, label)
    }

    /// Checks whether there is a value at a path.
    pub(crate) fn has(&self, path: &str) -> bool {
        self.value(path).is_some()
    }

    fn value(&self, path: &str) -> Option<&DeValue<'text>> {
        self.spanned(path).map(Spanned::get_ref)
    }

    /// Returns the value at a path, with its place.
    pub(crate) fn spanned(&self, path: &str) -> Option<&Spanned<DeValue<'text>>> {
        self.steps(path).last()?.map(|(_, value)| value)
    }

    /// Returns the spans of value and key of the deepest part of the path that exists.
    fn walk(&self, path: &str) -> (Range<usize>, Range<usize>) {
        let deepest = self.steps(path).flatten().last();
        deepest.map_or((0..0, 0..0), |(key, value)| (value.span(), key))
    }

    /// Returns the values at each part of a path; `None` from the first part on that does not exist.
    fn steps<'a>(&'a self, path: &str) -> impl Iterator<Item = Option<Child<'a, 'text>>> {
        let mut names = path.split('.');
        let root = names.next().and_then(|name| {
            let (key, value) = self.root().get_key_value(name)?;
            Some((key.span(), value))
        });
        let below = names.scan(root.clone(), |above, name| {
            *above = above
                .take()
                .and_then(|(_, value)| child(value.get_ref(), name));
            Some(above.clone())
        });
        [root].into_iter().chain(below)
    }
}

/// Returns the lines of a text that begin a table, each with the table's path: `[controller.pid]` has `controller.pid`.
fn headings(text: &str) -> Vec<(Range<usize>, &str)> {
    let mut end = 0;
    let lines = text.split_inclusive('\n').map(|line| {
        let start = end;
        end += line.len();
        (start..end, line.trim_start_matches([' ', '\t']))
    });
    let headings = lines.filter_map(|(place, line)| {
        let path = line.strip_prefix('[')?.trim_start_matches('[');
        Some((place, path.split(']').next()?.trim()))
    });
    headings.collect()
}

type Child<'tree, 'text> = (Range<usize>, &'tree Spanned<DeValue<'text>>);

/// Returns a member of a table or an element of an array, with the span that names it.
fn child<'tree, 'text>(value: &'tree DeValue<'text>, name: &str) -> Option<Child<'tree, 'text>> {
    match value {
        DeValue::Table(table) => {
            let (key, value) = table.get_key_value(name)?;
            Some((key.span(), value))
        }
        DeValue::Array(array) => {
            let element = array.get(name.parse::<usize>().ok()?)?;
            Some((element.span(), element))
        }
        _ => None,
    }
}
