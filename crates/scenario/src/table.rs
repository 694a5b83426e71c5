//! CSV tables: set-points, with two columns under a fixed header, and recorded courses of signals and currents, which are one
//! column of many.

use std::io;
use std::ops::RangeInclusive;
use std::path::{Component, Path};

use crate::current::CurrentRange;
use crate::error::{Problem, Source};
use crate::nearest::nearest;
use crate::wiring::Wiring;

/// Required header of a set-point; its second name has the unit of its loop.
const HEADER: [&str; 2] = ["time_seconds", "{signal}_{unit}"];
const ROWS_MAX: usize = 1_000_000;
/// Largest number of columns that are listed if a column is missing.
const COLUMNS_LISTED_MAX: usize = 50;
/// Reader of the text of a table, by the name that a scenario uses.
pub(crate) type ReadTable<'a> = &'a mut dyn FnMut(&str) -> io::Result<String>;

/// Rows `(time_seconds, value)`.
pub(crate) type Rows = Vec<(f64, f64)>;

/// Checks whether a path stays inside the folder that it is relative to.
pub(crate) fn is_inside_folder(path: &str) -> bool {
    let mut components = Path::new(path).components();
    let stays = |component| matches!(component, Component::Normal(_) | Component::CurDir);
    !path.is_empty() && components.all(stays)
}

/// Reads the rows of a set-point, `(time_seconds, position_millimetres)`; times increase.
///
/// The first problem ends the reading: most problems of a table repeat in every row.
pub(crate) fn parse(name: &str, text: &str, wiring: &Wiring) -> Result<Rows, Problem> {
    let reader = Reader::new(name, text);
    let position = wiring.feedback.measurand.name(HEADER[1]);
    let [min, max] = wiring.feedback.range();
    let travel = Values {
        what: "leaves the travel",
        range: min..=max,
    };
    let names = [HEADER[0], position.as_str()];
    if reader.columns() != names {
        let label = format!("expected `{}`", names.join(","));
        return Err(reader.problem(reader.header, 1, "has the wrong header", label));
    }
    reader.rows(&Columns {
        names,
        places: [0, 1],
        count: 2,
        values: Some(travel),
        is_complete: true,
    })
}

/// Reads the course of a signal, one column of a table next to its `time_seconds`, as [`parse`]; rows without a value are left
/// out.
pub(crate) fn parse_course(name: &str, text: &str, column: &str) -> Result<Rows, Problem> {
    parse_column(name, text, column, None)
}

/// Reads the course of a current, as [`parse_course`].
pub(crate) fn parse_current(
    name: &str,
    text: &str,
    column: &str,
    range: &CurrentRange,
) -> Result<Rows, Problem> {
    let values = Values {
        what: "leaves the range of the current",
        range: range.min..=range.max,
    };
    parse_column(name, text, column, Some(values))
}

fn parse_column(
    name: &str,
    text: &str,
    column: &str,
    values: Option<Values>,
) -> Result<Rows, Problem> {
    let reader = Reader::new(name, text);
    let known = reader.columns();
    let names = [HEADER[0], column];
    let mut places = [0; 2];
    for (place, name) in places.iter_mut().zip(names) {
        let Some(found) = known.iter().position(|known| *known == name) else {
            let label = match nearest(name, known.iter().copied()) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => format!("`{name}` is missing"),
            };
            let what = format!("has no column `{name}`");
            let listed = &known[..known.len().min(COLUMNS_LISTED_MAX)];
            let problem = reader.problem(reader.header, 1, &what, label);
            let help = format!(
                "columns of the table: {}; `column = \"…\"` beside `file` names the one that is meant",
                listed.join(", ")
            );
            return Err(problem.with_help(help));
        };
        *place = found;
    }
    reader.rows(&Columns {
        names,
        places,
        count: known.len(),
        values,
        is_complete: false,
    })
}

/// Columns that are read of each row.
struct Columns<'a> {
    names: [&'a str; 2],
    places: [usize; 2],
    /// Number of all columns of the table.
    count: usize,
    /// Allowed values; any number if absent.
    values: Option<Values>,
    /// Whether each row must have a value.
    is_complete: bool,
}

/// Allowed values.
struct Values {
    range: RangeInclusive<f64>,
    /// Problem of a table with another value.
    what: &'static str,
}

struct Reader<'text> {
    source: Source,
    text: &'text str,
    header: &'text str,
}

impl<'text> Reader<'text> {
    fn new(name: &str, text: &'text str) -> Self {
        Self {
            source: Source::new(name, text),
            text,
            header: text.lines().next().unwrap_or_default(),
        }
    }

    fn columns(&self) -> Vec<&'text str> {
        let header = self.header.trim_start_matches('\u{feff}');
        header.split(',').map(str::trim).collect()
    }

    /// Reads the rows below the header.
    fn rows(&self, columns: &Columns<'_>) -> Result<Rows, Problem> {
        let mut rows = Rows::new();
        let lines = self.text.lines().enumerate().skip(1);
        for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
            if rows.len() == ROWS_MAX {
                let label = format!("at most {ROWS_MAX} rows are admitted");
                return Err(self.problem(line, index + 1, "is too long", label));
            }
            rows.extend(self.row(columns, index + 1, line, rows.last())?);
        }
        if rows.is_empty() {
            return Err(self.problem(self.header, 1, "has no rows", "rows are missing below"));
        }
        Ok(rows)
    }

    fn row(
        &self,
        columns: &Columns<'_>,
        number: usize,
        line: &'text str,
        last: Option<&(f64, f64)>,
    ) -> Result<Option<(f64, f64)>, Problem> {
        let count = line.split(',').count();
        if count != columns.count {
            let label = format!("{count} instead of {} columns", columns.count);
            let what = "has a row with the wrong number of columns";
            return Err(self.problem(line, number, what, label));
        }
        let [time, value] = columns
            .places
            .map(|place| line.split(',').nth(place).unwrap_or_default());
        if !columns.is_complete && value.trim().is_empty() {
            return Ok(None);
        }
        let [time_name, value_name] = columns.names;
        let time_seconds = self.number(number, time_name, time)?;
        let found = self.number(number, value_name, value)?;
        let earliest = last.map_or(0.0, |row| row.0);
        if time_seconds < 0.0 || last.is_some_and(|row| time_seconds <= row.0) {
            let what = format!("has times out of order in column {time_name}");
            let label = format!("must be after {earliest} s");
            return Err(self.problem(time, number, &what, label));
        }
        if let Some(Values { range, what }) = &columns.values
            && !range.contains(&found)
        {
            let what = format!("{what} in column {value_name}");
            let label = format!("must be from {} to {}", range.start(), range.end());
            return Err(self.problem(value, number, &what, label));
        }
        Ok(Some((time_seconds, found)))
    }

    fn number(&self, row: usize, column: &str, field: &'text str) -> Result<f64, Problem> {
        let parsed = field
            .trim()
            .parse::<f64>()
            .ok()
            .filter(|number| number.is_finite());
        parsed.ok_or_else(|| {
            let what = format!("has no number in column {column}");
            self.problem(field, row, &what, "not a finite number")
        })
    }

    /// Makes a problem at a part of the text.
    fn problem(
        &self,
        part: &'text str,
        row: usize,
        what: &str,
        label: impl Into<String>,
    ) -> Problem {
        let blank = part.len() - part.trim_start().len();
        let part = part.trim();
        // `part` is a slice of `text`, so the difference of the addresses is its place.
        let start = part
            .as_ptr()
            .addr()
            .saturating_sub(self.text.as_ptr().addr());
        let start = if part.is_empty() {
            start.saturating_sub(blank)
        } else {
            start
        };
        let message = format!("the table {what}, line {row}");
        self.source
            .problem(start..start + part.len(), message, label)
    }
}
