//! The rows as tables for other programs: CSV and Parquet, both written row by row or group by group.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use super::plan::SweepPlan;
use super::row::SweepRow;
use super::store::{self, StoreError};
use exports::parquet::{Cells, ColumnKind, ParquetTable};

/// Names of the tables.
pub(super) const CSV: &str = "runs.csv";
pub(super) const PARQUET: &str = "runs.parquet";

/// Rows that are held in memory while the Parquet table is written.
const GROUP_ROWS: usize = 10_000;

/// What the tables are made of.
pub(super) struct Tables<'a> {
    pub(super) plan: &'a SweepPlan,
    /// The metrics that any row has, or that have a limit.
    pub(super) metrics: &'a [String],
    /// The folder with the rows.
    pub(super) folder: &'a Path,
}

impl Tables<'_> {
    /// The columns and what they hold.
    fn columns(&self) -> Vec<(&str, ColumnKind)> {
        let number = |name| (name, ColumnKind::Number);
        let text = |name| (name, ColumnKind::Text);
        let mut columns = vec![("case", ColumnKind::Count), text("id")];
        columns.extend(self.plan.keys().filter(is_no_seed).map(number));
        columns.push(("seed", ColumnKind::Whole));
        columns.extend(["verdict", "missed_limits", "reason"].map(text));
        columns.extend(self.metrics.iter().map(String::as_str).map(number));
        columns
    }

    /// The numbers of a row: the keys' values.
    fn values(&self, case: usize) -> impl Iterator<Item = f64> {
        let values = self.plan.keys().zip(self.plan.values(case));
        values
            .filter(|(key, _)| is_no_seed(key))
            .map(|(_, value)| value)
    }

    fn rows(&self) -> io::Result<impl Iterator<Item = io::Result<SweepRow>>> {
        let (_, rows) = store::read(self.folder).map_err(io::Error::other)?;
        Ok(rows.map(|row: Result<SweepRow, StoreError>| row.map_err(io::Error::other)))
    }

    /// Writes the CSV table.
    pub(super) fn write_csv(&self, output: &mut BufWriter<File>) -> io::Result<()> {
        let mut table = csv::Writer::from_writer(output);
        table.write_record(self.columns().iter().map(|(name, _)| name))?;
        for row in self.rows()? {
            table.write_record(self.cells(&row?))?;
        }
        table.flush()
    }

    fn cells(&self, row: &SweepRow) -> Vec<String> {
        let mut cells = vec![row.case.to_string(), row.id.clone()];
        cells.extend(self.values(row.case).map(|value| value.to_string()));
        cells.push(row.seed.map_or_else(String::new, |seed| seed.to_string()));
        cells.push(row.ended.word().to_owned());
        cells.push(missed(row).unwrap_or_default());
        cells.push(row.reason.clone().unwrap_or_default());
        let metrics = self.metrics.iter().map(|name| row.metric(name));
        cells
            .extend(metrics.map(|value| value.map_or_else(String::new, |value| value.to_string())));
        cells
    }

    /// Writes the Parquet table.
    pub(super) fn write_parquet(&self, output: &mut BufWriter<File>) -> io::Result<()> {
        let mut table = ParquetTable::new(output, "runs", &self.columns())?;
        let mut rows = self.rows()?;
        loop {
            let group: Vec<SweepRow> = rows.by_ref().take(GROUP_ROWS).collect::<io::Result<_>>()?;
            if group.is_empty() {
                break;
            }
            table.write(&self.group(&group))?;
        }
        table.finish()?.flush()
    }

    /// The columns of some rows.
    fn group(&self, rows: &[SweepRow]) -> Vec<Cells> {
        let whole = |number: u64| i64::try_from(number).ok();
        let text =
            |cell: fn(&SweepRow) -> Option<String>| Cells::Text(rows.iter().map(cell).collect());
        let cases = rows
            .iter()
            .map(|row| i64::try_from(row.case).unwrap_or(i64::MAX));
        let mut columns = vec![
            Cells::Count(cases.collect()),
            text(|row| Some(row.id.clone())),
        ];
        let values: Vec<Vec<f64>> = rows
            .iter()
            .map(|row| self.values(row.case).collect())
            .collect();
        let keys = self.plan.keys().filter(is_no_seed).count();
        let column = |place: usize| values.iter().map(|values| values[place]).collect();
        columns.extend((0..keys).map(|place| Cells::Number(column(place))));
        let seeds = rows.iter().map(|row| row.seed.and_then(whole));
        columns.push(Cells::Whole(seeds.collect()));
        columns.push(text(|row| Some(row.ended.word().to_owned())));
        columns.push(text(missed));
        columns.push(text(|row| row.reason.clone()));
        columns.extend(self.metrics.iter().map(|name| {
            let values = rows.iter().map(|row| row.metric(name).unwrap_or(f64::NAN));
            Cells::Number(values.collect())
        }));
        columns
    }
}

/// The limits that a case missed, in one cell.
fn missed(row: &SweepRow) -> Option<String> {
    (!row.missed.is_empty()).then(|| row.missed.join("; "))
}

/// The seed has a column in every table.
fn is_no_seed(key: &&str) -> bool {
    *key != "seed"
}
