//! Problems of a scenario file, as diagnostics that underline the place.

use std::fmt;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use miette::{
    Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource, SourceCode,
    SourceSpan,
};
use thiserror::Error;

/// Largest number of problems that are shown; further ones are only counted.
const PROBLEMS_SHOWN_MAX: usize = 50;

/// Longest line of a text that is shown. In a longer line no reader finds the place, and the renderer cannot underline that far.
const LINE_BYTES_SHOWN_MAX: usize = 1000;

/// All problems of one scenario or rig file. A single problem has the heading of the whole.
#[derive(Debug)]
pub struct ScenarioError {
    /// Kind of the file: "scenario".
    kind: &'static str,
    file_name: String,
    problems_total: usize,
    problems: Vec<Problem>,
}

impl ScenarioError {
    pub(crate) fn new(kind: &'static str, file_name: &str, mut problems: Vec<Problem>) -> Self {
        problems.sort_by_key(|problem| problem.offset);
        // A key that holds for several loops is read once for each of them.
        problems.dedup_by(|second, first| second.is_same(first));
        let problems_total = problems.len();
        problems.truncate(PROBLEMS_SHOWN_MAX);
        Self {
            kind,
            file_name: file_name.to_owned(),
            problems_total,
            problems,
        }
    }

    /// Makes the error of a scenario that does not exist or cannot be read.
    pub fn unreadable(path: &Path, error: &io::Error) -> Self {
        let message = match error.kind() {
            io::ErrorKind::NotFound => "there is no such file".to_owned(),
            _ => error.to_string(),
        };
        Self::in_file(&path.display().to_string(), message)
    }

    /// Makes the error of a scenario with a problem that has no place in its text.
    pub(crate) fn in_file(file_name: &str, message: String) -> Self {
        let problem = Problem {
            offset: None,
            underlined: None,
            ..Source::new(file_name, "").problem(0..0, message, "")
        };
        Self::new("scenario", file_name, vec![problem])
    }

    /// Returns the problems in the order of the file; at least one, at most 50.
    pub fn problems(&self) -> &[Problem] {
        &self.problems
    }

    /// Returns the problem if there is only one.
    fn single(&self) -> Option<&Problem> {
        self.problems.first().filter(|_| self.problems_total == 1)
    }
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kind, file_name) = (self.kind, &self.file_name);
        if let Some(problem) = self.single() {
            let is_named_below = problem.underlined.is_some() && problem.file_name() == file_name;
            return match problem.offset {
                None => write!(
                    formatter,
                    "the {kind} `{file_name}` cannot be read: {problem}"
                ),
                Some(_) if is_named_below => write!(formatter, "{problem}"),
                Some(_) => write!(formatter, "`{file_name}`: {problem}"),
            };
        }
        let (total, shown) = (self.problems_total, self.problems.len());
        write!(
            formatter,
            "`{file_name}` is not a valid {kind}: {total} problems"
        )?;
        if total > shown {
            write!(formatter, ", the first {shown} of them")?;
        }
        Ok(())
    }
}

impl std::error::Error for ScenarioError {}

impl Diagnostic for ScenarioError {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.single()?.help()
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.single()?.source_code()
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        self.single()?.labels()
    }

    fn related<'a>(&'a self) -> Option<Box<dyn Iterator<Item = &'a dyn Diagnostic> + 'a>> {
        let problems = self.problems.iter();
        let related = problems.map(|problem| problem as &dyn Diagnostic);
        self.single().is_none().then(|| Box::new(related) as _)
    }
}

/// Renders an error without colours, with the places that it underlines. An escape sequence in it can only come from a file. No
/// line is wrapped, so programs find messages and paths whole.
///
/// # Panics
/// Never: writing to memory does not fail.
pub fn without_colours(error: &dyn Diagnostic) -> String {
    let handler = GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor())
        .with_wrap_lines(false);
    let mut text = String::new();
    let rendered = handler.render_report(&mut text, error);
    rendered.expect("memory takes all that is written");
    text
}

/// A problem with its place.
#[derive(Clone, Debug, Diagnostic, Error)]
#[error("{message}")]
pub struct Problem {
    message: Box<str>,
    label: Box<str>,
    #[help]
    help: Option<Box<str>>,
    /// Start of the underlined place, even in a text that is not shown.
    offset: Option<usize>,
    #[label("{label}")]
    underlined: Option<SourceSpan>,
    /// Related places, each with a label.
    #[label(collection)]
    others: Vec<LabeledSpan>,
    #[source_code]
    source_text: Arc<NamedSource<String>>,
}

impl Problem {
    /// Returns the start of the place in its text, and the label there.
    pub(crate) fn place_and_label(&self) -> (Option<usize>, String) {
        (self.offset, self.label.to_string())
    }

    /// Replaces names in the message.
    pub(crate) fn renamed(self, rename: impl Fn(&str) -> String) -> Self {
        Self {
            message: rename(&self.message).into(),
            label: rename(&self.label).into(),
            help: self.help.map(|help| rename(&help).into()),
            ..self
        }
    }

    fn is_same(&self, other: &Self) -> bool {
        (self.offset, &self.message, &self.label) == (other.offset, &other.message, &other.label)
    }

    /// Returns the name of the file with the problem: the scenario, or a table that it names.
    pub fn file_name(&self) -> &str {
        self.source_text.name()
    }

    /// Returns line and column of the underlined place, counted from 1 in characters; `None` if the file could not be read.
    pub fn line_and_column(&self) -> Option<(usize, usize)> {
        let before = self.source_text.inner().get(..self.offset?)?;
        let line = before.rsplit('\n').next().unwrap_or(before);
        Some((before.matches('\n').count() + 1, line.chars().count() + 1))
    }

    pub(crate) fn with_help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into().into_boxed_str());
        self
    }

    /// Adds a related second place of the text.
    pub(crate) fn with_place(mut self, span: Range<usize>, label: &str) -> Self {
        if self.underlined.is_some() {
            let label = Some(label.to_owned());
            self.others.push(LabeledSpan::new_with_span(label, span));
        }
        self
    }
}

/// A named text in which problems have their places; clones share the text.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    text: Arc<NamedSource<String>>,
    is_shown: bool,
}

impl Source {
    pub(crate) fn new(name: &str, text: &str) -> Self {
        Self {
            text: Arc::new(NamedSource::new(name, text.to_owned())),
            is_shown: text.lines().all(|line| line.len() <= LINE_BYTES_SHOWN_MAX),
        }
    }

    /// Returns the text at a place.
    pub(crate) fn text(&self, place: &Range<usize>) -> &str {
        self.text.inner().get(place.clone()).unwrap_or_default()
    }

    /// Makes a problem at a place of this text: `message` describes it, and `label` is printed at the place.
    pub(crate) fn problem(
        &self,
        span: Range<usize>,
        message: impl Into<String>,
        label: impl Into<String>,
    ) -> Problem {
        let span = SourceSpan::from(span);
        let mut problem = Problem {
            message: message.into().into_boxed_str(),
            label: label.into().into_boxed_str(),
            help: None,
            offset: Some(span.offset()),
            underlined: self.is_shown.then_some(span),
            others: Vec::new(),
            source_text: self.text.clone(),
        };
        if !self.is_shown
            && let Some((line, column)) = problem.line_and_column()
        {
            let label = &problem.label;
            let message = &problem.message;
            problem.message =
                format!("{message} (line {line}, column {column}: {label})").into_boxed_str();
        }
        problem
    }
}
