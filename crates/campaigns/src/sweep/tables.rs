//! The rows as tables for other programs: CSV and Parquet, written group by group.

use std::fs::File;
use std::io::{self, BufWriter, Write};

use super::cases::Cases;
use super::row::SweepRow;
use super::store::Rows;
use exports::parquet::{Cells, ParquetTable};
use recording::cell::inert;

/// Names of the tables.
pub(super) const CSV: &str = "runs.csv";
pub(super) const PARQUET: &str = "runs.parquet";

/// Number of rows in memory while a table is written.
const GROUP_ROWS: usize = 10_000;

/// Content of the tables.
pub(super) struct Tables<'a> {
    pub(super) cases: &'a dyn Cases,
    /// Metrics that any row has, or that have a limit.
    pub(super) metrics: &'a [String],
    pub(super) rows: &'a Rows,
}

impl Tables<'_> {
    /// Returns the columns of some rows, by their names.
    fn columns(&self, rows: &[SweepRow]) -> Vec<(&str, Cells)> {
        let text =
            |cell: fn(&SweepRow) -> Option<String>| Cells::Text(rows.iter().map(cell).collect());
        let whole = |number: u64| i64::try_from(number).ok();
        let cases = rows.iter().map(|row| row.case as u64);
        let seeds = rows.iter().map(|row| row.seed.and_then(whole));
        let values = rows.iter().map(|row| self.cases.values(row.case));
        let values = Vec::from_iter(values);
        let mut columns = vec![
            ("case", Cells::Count(cases.collect())),
            ("id", text(|row| Some(row.id.clone()))),
        ];
        for (place, key) in self.cases.facts().keys().into_iter().enumerate() {
            // The seed has a column in every table.
            if key != "seed" {
                let column = values.iter().map(|values| values[place]);
                columns.push((key, Cells::Number(column.collect())));
            }
        }
        columns.extend([
            ("seed", Cells::Whole(seeds.collect())),
            ("verdict", text(|row| Some(row.ended.word().to_owned()))),
            ("missed_limits", text(missed)),
            ("reason", text(|row| row.reason.clone())),
        ]);
        columns.extend(self.metrics.iter().map(|name| {
            let values = rows.iter().map(|row| row.metric(name).unwrap_or(f64::NAN));
            (name.as_str(), Cells::Number(values.collect()))
        }));
        columns
    }

    /// Passes on all rows, some at a time.
    fn in_groups(&self, mut write: impl FnMut(&[SweepRow]) -> io::Result<()>) -> io::Result<()> {
        let mut rows = self.rows.iter().map_err(io::Error::other)?;
        loop {
            let group = rows.by_ref().take(GROUP_ROWS);
            let group: Vec<SweepRow> = group.collect::<Result<_, _>>().map_err(io::Error::other)?;
            if group.is_empty() {
                return Ok(());
            }
            write(&group)?;
        }
    }

    pub(super) fn write_csv(&self, output: &mut BufWriter<File>) -> io::Result<()> {
        let mut table = csv::Writer::from_writer(output);
        let columns = self.columns(&[]);
        table.write_record(columns.iter().map(|(name, _)| inert(name).into_owned()))?;
        self.in_groups(|rows| {
            let columns = self.columns(rows);
            for row in 0..rows.len() {
                table.write_record(columns.iter().map(|(_, cells)| csv_cell(cells, row)))?;
            }
            Ok(())
        })?;
        table.flush()
    }

    pub(super) fn write_parquet(&self, output: &mut BufWriter<File>) -> io::Result<()> {
        let mut table = ParquetTable::new(output, "runs", &self.columns(&[]))?;
        self.in_groups(|rows| {
            let columns = self.columns(rows).into_iter();
            Ok(table.write(columns.map(|(_, cells)| cells))?)
        })?;
        table.finish()?.flush()
    }
}

/// Returns a cell of a column for CSV; empty if it has no value.
fn csv_cell(cells: &Cells, row: usize) -> String {
    let text = match cells {
        Cells::Count(cells) => cells.get(row).map(|number| number.to_string()),
        Cells::Whole(cells) => cells[row].map(|number| number.to_string()),
        Cells::Number(cells) => {
            let number = cells.get(row).filter(|number| !number.is_nan());
            number.map(|number| number.to_string())
        }
        Cells::Text(cells) => cells[row].as_deref().map(|text| inert(text).into_owned()),
    };
    text.unwrap_or_default()
}

/// Returns the limits that a case missed, in one cell.
fn missed(row: &SweepRow) -> Option<String> {
    (!row.missed.is_empty()).then(|| row.missed.join("; "))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::sweep::Shard;
    use crate::sweep::row::Ended;
    use crate::sweep::store::tests::header;
    use crate::sweep::store::{Header, Writer};
    use crate::sweep::sweep_cases::SweepCases;
    use plan::Plan;
    use proptest::prelude::*;
    use scenario::Beside;
    use worlds::catalogue::catalogue;

    const TEXT: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n[sweep]\ndraws = 2\n\
        [[sweep.list]]\nkey = \"reference.hold[0].position_millimetres\"\nvalues = [5, 15]\n\
        [[sweep.uniform]]\nkey = \"plant.wire.mechanics.load_kilograms\"\nfrom = 0.03\nto = 0.05\n";

    proptest! {
        #[test]
        fn no_text_of_a_row_is_a_formula_and_every_number_stays_one(
            first in prop_oneof!["=", "\\+", "-", "@", "\t", "\r", "\n", "", "a", "'"],
            rest in any::<String>(),
            value in -1e9..1e9_f64,
        ) {
            let text = format!("{first}{rest}");
            let plan = Plan::parse_beside(&Beside::new(Path::new("s.toml")), TEXT.to_owned(), catalogue()).unwrap();
            let cases = SweepCases::new(&plan).unwrap();
            let metrics = [text.clone()];
            let rows = Rows::read(Path::new("/nowhere"), &header("s"), Shard::WHOLE).unwrap();
            let tables = Tables { cases: &cases, metrics: &metrics, rows: &rows };
            let mut row = SweepRow::without_verdict(1, &text, Ended::Fail, text.clone());
            (row.missed, row.metrics) = (vec![text.clone()], vec![(text.clone(), value)]);
            let mut written = csv::Writer::from_writer(Vec::new());
            let columns = tables.columns(&[row]);
            written.write_record(columns.iter().map(|(name, _)| inert(name).into_owned())).unwrap();
            written.write_record(columns.iter().map(|(_, cells)| csv_cell(cells, 0))).unwrap();
            let bytes = written.into_inner().unwrap();
            let mut read = csv::ReaderBuilder::new().has_headers(false).from_reader(&bytes[..]);
            let read: Vec<csv::StringRecord> = read.records().map(Result::unwrap).collect();
            for cell in read.iter().flatten() {
                let is_number = cell.parse::<f64>().is_ok();
                prop_assert!(is_number || !cell.starts_with(['=', '+', '-', '@', '\t', '\r', '\n']), "{cell:?}");
            }
            let last = read[1].iter().next_back().unwrap();
            prop_assert_eq!(last.parse::<f64>().unwrap().to_bits(), value.to_bits());
            let id = read[1].get(1).unwrap();
            prop_assert!(id == text || id == format!("'{text}"), "{id:?}");
        }
    }

    /// Reads the values of the keys from the scenario of a case.
    fn keys(cases: &SweepCases, case: usize) -> [f64; 2] {
        let scenario = cases
            .case(case)
            .plan()
            .unwrap()
            .only_loop()
            .unwrap()
            .trial
            .clone();
        let hold = &scenario.reference.hold[0];
        let load = scenario.plant().load_kilograms().unwrap();
        [hold.position, load]
    }

    #[test]
    fn a_row_of_either_table_has_the_keys_of_its_case() {
        let plan = Plan::parse_beside(
            &Beside::new(Path::new("s.toml")),
            TEXT.to_owned(),
            catalogue(),
        )
        .unwrap();
        let cases = SweepCases::new(&plan).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let header = Header::new(&cases).unwrap();
        let mut writer = Writer::begin(folder.path(), &header).unwrap();
        let row = |case| {
            let id = &cases.case(case).id;
            SweepRow::without_verdict(case, id, Ended::Invalid, "no".to_owned())
        };
        let rows: Vec<SweepRow> = (1..=4).map(row).collect();
        // The rows are in another order than the cases.
        let mut written = rows.iter().rev();
        written.try_for_each(|row| writer.append(row)).unwrap();
        let stored = Rows::read(folder.path(), &header, Shard::WHOLE).unwrap();
        let tables = Tables {
            cases: &cases,
            metrics: &[],
            rows: &stored,
        };

        let path = folder.path().join(CSV);
        let mut output = BufWriter::new(File::create(&path).unwrap());
        tables.write_csv(&mut output).unwrap();
        drop(output);
        let mut table = csv::Reader::from_path(path).unwrap();
        let records: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
        assert_eq!(records.len(), 4);
        for (case, record) in (1..).zip(&records) {
            let cells: [f64; 2] = [&record[2], &record[3]].map(|cell| cell.parse().unwrap());
            assert_eq!(cells, keys(&cases, case), "case {case}");
            assert_eq!(record[1], cases.case(case).id);
        }

        let columns = tables.columns(&rows);
        let [(_, Cells::Number(holds)), (_, Cells::Number(loads))] = &columns[2..4] else {
            panic!("the third and the fourth column are keys")
        };
        for (case, cells) in (1..).zip(holds.iter().zip(loads)) {
            assert_eq!([cells.0, cells.1], keys(&cases, case), "case {case}");
        }
    }
}
