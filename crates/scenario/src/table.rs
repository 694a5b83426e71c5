//! CSV tables: set-points, with two columns under a fixed header, and recorded courses of signals and currents, which are one
//! column of many.

use std::io;
use std::ops::RangeInclusive;
use std::path::{Component, Path};

use crate::error::{Problem, Source};
use crate::nearest::nearest;
use crate::wiring::Wiring;
use dbc::CommandRange;

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

/// Reads the rows of a set-point, time in seconds and value; times increase.
///
/// The first problem ends the reading: most problems of a table repeat in every row.
pub(crate) fn parse(name: &str, text: &str, wiring: &Wiring) -> Result<Rows, Problem> {
    let position = wiring.quantities.name(HEADER[1]);
    let [min, max] = wiring.feedback.range();
    let mut reader = Reader::new(name, text, &position);
    (reader.range, reader.outside) = (min..=max, "leaves the travel");
    let columns = reader.columns();
    if columns != reader.names {
        let label = format!("expected `{}`", reader.names.join(","));
        return Err(reader.problem(reader.header, 1, "has the wrong header", label));
    }
    reader.is_complete = true;
    reader.rows(&columns, [0, 1])
}

/// Reads the course of a signal, one column of a table next to its `time_seconds`, as [`parse`]; rows without a value are left
/// out. A table of several loops has the column under its name with the loop's, `in_loop`.
pub(crate) fn parse_course(
    name: &str,
    text: &str,
    [column, in_loop]: [&str; 2],
) -> Result<Rows, Problem> {
    let of_loop = Reader::new(name, text, in_loop);
    if of_loop.columns().contains(&in_loop) {
        return of_loop.named_columns();
    }
    Reader::new(name, text, column).named_columns()
}

/// Reads the course of a command, as [`parse_course`].
pub(crate) fn parse_command(
    name: &str,
    text: &str,
    column: &str,
    range: &CommandRange,
) -> Result<Rows, Problem> {
    let mut reader = Reader::new(name, text, column);
    (reader.range, reader.outside) = (range.min..=range.max, "leaves the range of the amplifier");
    reader.named_columns()
}

/// Reader of two columns of a table: times, and values within a range.
struct Reader<'a> {
    source: Source,
    text: &'a str,
    header: &'a str,
    /// Names of the two columns.
    names: [&'a str; 2],
    range: RangeInclusive<f64>,
    /// Problem of a table with a value outside the range.
    outside: &'static str,
    /// Whether each row must have a value.
    is_complete: bool,
}

impl<'a> Reader<'a> {
    /// Makes a reader of a column with any numbers.
    fn new(name: &str, text: &'a str, column: &'a str) -> Self {
        Self {
            source: Source::new(name, text),
            text,
            header: text.lines().next().unwrap_or_default(),
            names: [HEADER[0], column],
            range: f64::NEG_INFINITY..=f64::INFINITY,
            outside: "",
            is_complete: false,
        }
    }

    fn columns(&self) -> Vec<&'a str> {
        let header = self.header.trim_start_matches('\u{feff}');
        header.split(',').map(str::trim).collect()
    }

    /// Reads the rows of a table that may have other columns, too.
    fn named_columns(&self) -> Result<Rows, Problem> {
        let columns = self.columns();
        let mut places = [0; 2];
        for (place, name) in places.iter_mut().zip(self.names) {
            *place = columns
                .iter()
                .position(|column| *column == name)
                .ok_or_else(|| self.no_column(name, &columns))?;
        }
        self.rows(&columns, places)
    }

    fn no_column(&self, name: &str, columns: &[&str]) -> Problem {
        let label = match nearest(name, columns.iter().copied()) {
            Some(meant) => format!("did you mean `{meant}`?"),
            None => format!("`{name}` is missing"),
        };
        let what = format!("has no column `{name}`");
        let problem = self.problem(self.header, 1, &what, label);
        let listed = &columns[..columns.len().min(COLUMNS_LISTED_MAX)];
        problem.with_help(format!(
            "columns of the table: {}; `column = \"…\"` beside `file` names the one that is meant",
            listed.join(", ")
        ))
    }

    /// Reads the rows below the header, of whose columns two are at these places.
    fn rows(&self, columns: &[&str], places: [usize; 2]) -> Result<Rows, Problem> {
        let mut rows = Rows::new();
        let lines = self.text.lines().enumerate().skip(1);
        for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
            let number = index + 1;
            if rows.len() == ROWS_MAX {
                let label = format!("at most {ROWS_MAX} rows are admitted");
                return Err(self.problem(line, number, "is too long", label));
            }
            let count = line.split(',').count();
            if count != columns.len() {
                let label = format!("{count} instead of {} columns", columns.len());
                let what = "has a row with the wrong number of columns";
                return Err(self.problem(line, number, what, label));
            }
            let fields = places.map(|place| line.split(',').nth(place).unwrap_or_default());
            rows.extend(self.row(number, fields, rows.last())?);
        }
        if rows.is_empty() {
            return Err(self.problem(self.header, 1, "has no rows", "rows are missing below"));
        }
        Ok(rows)
    }

    fn row(
        &self,
        number: usize,
        [time, value]: [&'a str; 2],
        last: Option<&(f64, f64)>,
    ) -> Result<Option<(f64, f64)>, Problem> {
        if !self.is_complete && value.trim().is_empty() {
            return Ok(None);
        }
        let [time_name, value_name] = self.names;
        let time_seconds = self.number(number, time_name, time)?;
        let found = self.number(number, value_name, value)?;
        let earliest = last.map_or(0.0, |row| row.0);
        if time_seconds < 0.0 || last.is_some_and(|row| time_seconds <= row.0) {
            let what = format!("has times out of order in column {time_name}");
            let label = format!("must be after {earliest} s");
            return Err(self.problem(time, number, &what, label));
        }
        if !self.range.contains(&found) {
            let what = format!("{} in column {value_name}", self.outside);
            let label = format!(
                "must be from {} to {}",
                self.range.start(),
                self.range.end()
            );
            return Err(self.problem(value, number, &what, label));
        }
        Ok(Some((time_seconds, found)))
    }

    fn number(&self, row: usize, column: &str, field: &'a str) -> Result<f64, Problem> {
        let number = field.trim().parse::<f64>().ok();
        let parsed = number.filter(|number| number.is_finite());
        parsed.ok_or_else(|| {
            let what = format!("has no number in column {column}");
            self.problem(field, row, &what, "not a finite number")
        })
    }

    /// Makes a problem at a part of the text.
    fn problem(&self, part: &'a str, row: usize, what: &str, label: impl Into<String>) -> Problem {
        let part = part.trim();
        // `part` is a slice of `text`, so the difference of the addresses is its place.
        let start = part
            .as_ptr()
            .addr()
            .saturating_sub(self.text.as_ptr().addr());
        let message = format!("the table {what}, line {row}");
        self.source
            .problem(start..start + part.len(), message, label)
    }
}
