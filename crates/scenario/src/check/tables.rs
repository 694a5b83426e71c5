//! Reads the files that a scenario names.

use std::io;

use crate::controller::NominalModel;
use crate::document::Document;
use crate::error::Problem;
use crate::table::{self, ReadTable};
use crate::trial::Trial;

/// Reads the tables of the set-point and of the current into their rows, and the nominal model into its field.
pub(crate) fn read_tables(
    document: &Document<'_>,
    trial: &mut Trial,
    read_table: ReadTable<'_>,
) -> Vec<Problem> {
    let Trial {
        controller,
        reference,
        wiring,
        ..
    } = trial;
    let mut problems = Vec::new();
    for (index, entry) in reference.table.iter_mut().enumerate() {
        let path = format!("reference.table.{index}.file");
        let rows = read_beside(document, &path, &entry.file, read_table)
            .and_then(|text| table::parse(&entry.file, &text, wiring));
        match rows {
            Ok(rows) => entry.rows = rows,
            Err(problem) => problems.push(problem),
        }
    }
    let currents = controller
        .open_loop
        .iter_mut()
        .flat_map(|open_loop| &mut open_loop.table);
    for (index, entry) in currents.enumerate() {
        let path = format!("controller.open_loop.table.{index}.file");
        let rows = read_beside(document, &path, &entry.file, read_table).and_then(|text| {
            table::parse_current(&entry.file, &text, &entry.column, &wiring.current())
        });
        match rows {
            Ok(rows) => entry.rows = rows,
            Err(problem) => problems.push(problem),
        }
    }
    if let Some(law) = &mut controller.sliding_mode
        && let Some(file) = &law.nominal_model_file
    {
        let path = "controller.sliding_mode.nominal_model_file";
        let model = read_beside(document, path, file, read_table)
            .map_err(|problem| vec![problem])
            .and_then(|text| NominalModel::from_file_text(file, &text));
        match model {
            Ok(model) => law.nominal_model = model,
            Err(found) => problems.extend(found),
        }
    }
    problems
}

/// Reads the text of a table that the scenario names at a path.
pub(super) fn read_beside(
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
