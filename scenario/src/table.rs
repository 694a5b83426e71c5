//! The CSV tables of set-points: two columns of numbers under a fixed header.

use std::ops::Range;
use std::path::{Component, Path};

use crate::error::{Problem, Source};

/// The only header.
const HEADER: [&str; 2] = ["time_seconds", "position_millimetres"];
const ROWS_MAX: usize = 1_000_000;
/// The wire's travel.
const POSITION_MILLIMETRES: Range<f64> = 0.0..60.0;

/// True when the path stays inside the folder that it is relative to.
pub(crate) fn is_inside_folder(path: &str) -> bool {
    let mut components = Path::new(path).components();
    let stays = |component| matches!(component, Component::Normal(_) | Component::CurDir);
    !path.is_empty() && components.all(stays)
}

/// Reads the rows `(time_seconds, position_millimetres)`; times increase.
///
/// The first problem ends the reading: a table that is wrong is mostly wrong in every row.
pub(crate) fn parse(name: &str, text: &str) -> Result<Vec<(f64, f64)>, Problem> {
    let reader = Reader {
        source: &Source::new(name, text),
        text,
    };
    let mut lines = text.lines().enumerate();
    let header = lines.next().map_or("", |(_, line)| line);
    let columns = header
        .trim_start_matches('\u{feff}')
        .split(',')
        .map(str::trim);
    if !columns.eq(HEADER) {
        let label = format!("expected `{}`", HEADER.join(","));
        return Err(reader.problem(header, 1, "has the wrong header", label));
    }
    let mut rows: Vec<(f64, f64)> = Vec::new();
    for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        if rows.len() == ROWS_MAX {
            let label = format!("at most {ROWS_MAX} rows are admitted");
            return Err(reader.problem(line, index + 1, "is too long", label));
        }
        rows.push(reader.row(index + 1, line, rows.last())?);
    }
    if rows.is_empty() {
        return Err(reader.problem(header, 1, "has no rows", "rows are missing below"));
    }
    Ok(rows)
}

struct Reader<'text> {
    source: &'text Source,
    text: &'text str,
}

impl<'text> Reader<'text> {
    fn row(
        &self,
        number: usize,
        line: &'text str,
        last: Option<&(f64, f64)>,
    ) -> Result<(f64, f64), Problem> {
        let mut fields = line.split(',');
        let (Some(time), Some(position), None) = (fields.next(), fields.next(), fields.next())
        else {
            let count = line.split(',').count();
            let label = format!("{count} instead of 2 columns");
            return Err(self.problem(
                line,
                number,
                "has a row with the wrong number of columns",
                label,
            ));
        };
        let time_seconds = self.number(number, HEADER[0], time)?;
        let position_millimetres = self.number(number, HEADER[1], position)?;
        let earliest = last.map_or(0.0, |row| row.0);
        if time_seconds < 0.0 || last.is_some_and(|row| time_seconds <= row.0) {
            let what = format!("has times out of order in column {}", HEADER[0]);
            let label = format!("must be after {earliest} s");
            return Err(self.problem(time, number, &what, label));
        }
        if !(POSITION_MILLIMETRES.start..=POSITION_MILLIMETRES.end).contains(&position_millimetres)
        {
            let Range { start, end } = POSITION_MILLIMETRES;
            let what = format!("leaves the travel in column {}", HEADER[1]);
            let label = format!("must be from {start} to {end}");
            return Err(self.problem(position, number, &what, label));
        }
        Ok((time_seconds, position_millimetres))
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

    /// A problem at a part of the text.
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
        let start = (part.as_ptr().addr()).saturating_sub(self.text.as_ptr().addr());
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
