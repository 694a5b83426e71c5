//! Reads the files that a scenario names.

use std::io;

use super::Check;
use super::signals;
use crate::controller::NominalModel;
use crate::document::Document;
use crate::error::Problem;
use crate::table::{self, ReadTable, Rows};
use crate::trial::Trial;

/// Reads the tables of the set-point and of the current, and the courses that signals must follow, into their rows, and the nominal
/// model into its field.
pub(crate) fn read_tables(check: &mut Check<'_>, trial: &mut Trial, read_table: ReadTable<'_>) {
    let document = check.document;
    let mut rows = |path: &str, file: &str, parse: &dyn Fn(&str) -> Result<Rows, Problem>| {
        let rows = read_beside(document, path, file, read_table).and_then(|text| parse(&text));
        rows.unwrap_or_else(|problem| {
            check.add([problem]);
            Rows::new()
        })
    };
    let wiring = &trial.wiring;
    for (index, entry) in trial.reference.table.iter_mut().enumerate() {
        let (path, file) = (format!("reference.table.{index}.file"), &entry.file);
        entry.rows = rows(&path, file, &|text| table::parse(file, text, wiring)).into();
    }
    let open_loop = trial.controller.open_loop.iter_mut();
    for (index, entry) in open_loop.flat_map(|one| &mut one.table).enumerate() {
        let path = format!("controller.open_loop.table.{index}.file");
        let usual = || wiring.quantities.name("{command}_{command_unit}");
        let (file, range) = (&entry.file, wiring.amplifier.range());
        let column = entry.column.clone().unwrap_or_else(usual);
        let parse = |text: &str| table::parse_command(file, text, &column, &range);
        entry.rows = rows(&path, file, &parse).into();
    }
    for (index, signal) in trial.expect.signal.iter_mut().enumerate() {
        let Some(course) = &mut signal.follows else {
            continue;
        };
        let path = format!("expect.signal.{index}.follows.file");
        let (file, column) = (&course.file, course.column_for(&signal.name));
        let in_loop = format!("{}.{column}", wiring.loop_among_several());
        let columns = [column, in_loop.as_str()];
        let parse = |text: &str| table::parse_course(file, text, columns);
        course.rows = rows(&path, file, &parse);
    }
    if let Some(law) = &mut trial.controller.sliding_mode
        && let Some(file) = &law.nominal_model_file
    {
        let path = "controller.sliding_mode.nominal_model_file";
        let model = read_beside(document, path, file, read_table)
            .map_err(|problem| vec![problem])
            .and_then(|text| NominalModel::from_file_text(file, &text));
        match model {
            Ok(model) => law.nominal_model = model,
            Err(found) => check.add(found),
        }
    }
    check.add(signals::uncovered(document, trial));
}

/// Reads the text of a table that the scenario names at a path.
fn read_beside(
    document: &Document<'_>,
    path: &str,
    file: &str,
    read_table: ReadTable<'_>,
) -> Result<String, Problem> {
    if !table::is_inside_folder(file) {
        let message = "a table must lie in the scenario's folder";
        return Err(document.problem(path, message, "no absolute path, no `..`"));
    }
    read_table(file).map_err(|error| {
        let (message, label) = match error.kind() {
            io::ErrorKind::NotFound => (
                format!("the CSV file {file} does not exist"),
                "looked for beside the scenario".to_owned(),
            ),
            _ => (
                format!("the CSV file {file} cannot be read"),
                error.to_string(),
            ),
        };
        document.problem(path, message, label)
    })
}
