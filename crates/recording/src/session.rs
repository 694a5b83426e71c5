//! Plan of a run in its run folder, so that the folder can be run and judged by itself: writing, and reading back.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dbc::Database;
use plan::Plan;
use plan::catalogue::{Catalogue, ambiguous_name};
use plan::named_nodes::node_sheets;
use scenario::{HASH_SUFFIX, ScenarioError, read_text};

use crate::run_folder::{RunFolder, WriteError, file, file_in};

/// Writes the files of the plan, and the meaning of its frames.
///
/// # Errors
/// If a file cannot be written.
pub fn write_plan(folder: &RunFolder, plan: &Plan) -> Result<(), WriteError> {
    folder.write(file::FRAMES, plan.database().to_dbc().as_bytes())?;
    write_scenario(folder, plan)
}

/// Writes the missing files of the plan. The scenario comes last: a folder that has it has the others.
///
/// # Errors
/// If a file cannot be written.
pub fn write_scenario(folder: &RunFolder, plan: &Plan) -> Result<(), WriteError> {
    link_files(folder, plan, "")?;
    plan_files(plan).try_for_each(|(name, text)| folder.ensure(name, text.as_bytes()))
}

/// Writes the EDS of each node of the rig.
///
/// # Errors
/// If a file cannot be written.
pub fn write_sheets(folder: &RunFolder, plan: &Plan) -> Result<(), WriteError> {
    node_sheets(plan).into_iter().try_for_each(|(node, eds)| {
        let name = format!("{}/{}.eds", file::SHEETS, node.name);
        folder.write(&name, eds.as_bytes())
    })
}

/// Writes the tables that the scenario names, for scenarios in the subfolder `place`.
///
/// # Errors
/// If a file cannot be written.
pub fn write_tables(folder: &RunFolder, plan: &Plan, place: &str) -> Result<(), WriteError> {
    link_files(folder, plan, place)?;
    let mut tables = plan.shared.tables.iter();
    tables.try_for_each(|(name, text)| folder.write(&format!("{place}/{name}"), text.as_bytes()))
}

/// Links the programs of laws and FMUs, which are not copied: next to the hash of each, a link leads to it for the nodes.
fn link_files(folder: &RunFolder, plan: &Plan, place: &str) -> Result<(), WriteError> {
    let hashes = plan.shared.tables.keys();
    let mut files = hashes.filter_map(|name| name.strip_suffix(HASH_SUFFIX));
    files.try_for_each(|file| match plan.shared.beside.place(file).canonicalize() {
        Ok(target) => folder.link(&Path::new(place).join(file), &target),
        // A node that needs it reports that it is missing.
        Err(_) => Ok(()),
    })
}

/// Returns the files of the plan, with the names of their copies in a folder: the files that the scenario names, with its rig and
/// the EDS of real drives, and the scenario.
pub fn plan_files(plan: &Plan) -> impl Iterator<Item = (&str, &str)> {
    let files = plan.shared.tables.iter();
    let tables = files.map(|(name, text)| (name.as_str(), text.as_str()));
    tables.chain([(file::SCENARIO, plan.shared.text.as_str())])
}

/// Error: the plan of a recording cannot be read back.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    #[error(transparent)]
    Scenario(Box<ScenarioError>),
    /// A file of the recording cannot be used.
    #[error("{} cannot be used: {reason}", path.display())]
    File { path: PathBuf, reason: String },
}

impl ReadError {
    /// Returns a function for `map_err` that makes the error of a file in a folder.
    fn at<E: ToString>(folder: &Path, name: &str) -> impl Fn(E) -> Self {
        let path = folder.join(name);
        move |reason| Self::File {
            path: path.clone(),
            reason: reason.to_string(),
        }
    }
}

/// Reads back the plan of a run, with its external nodes, if those are known. The folder's own `frames.dbc` gives the frames
/// their meaning; then no plant and no law of this bench is needed. With a log of another tool there is none: then the meaning
/// follows from the scenario's rig and law, which must be in the catalogue.
///
/// # Errors
/// If a file cannot be read or is not valid.
pub fn read_plan(
    folder: &Path,
    external: Option<&[String]>,
    catalogue: &Catalogue,
) -> Result<Plan, ReadError> {
    let frames = read_frames(folder)?;
    let path = file_in(folder, file::SCENARIO).map_err(ReadError::at(folder, file::SCENARIO))?;
    let plan = load(&path, frames.as_ref(), catalogue)?;
    let mut wirings = plan.loops.iter().map(|one| &one.trial.wiring);
    let ambiguous = wirings.find_map(|wiring| ambiguous_name(plan.database(), wiring));
    if let Some(name) = ambiguous.filter(|_| frames.is_some()) {
        let reason = format!("two signals that become columns are called `{name}`");
        return Err(ReadError::at(folder, file::FRAMES)(reason));
    }
    Ok(plan.recorded_external(external.unwrap_or_default()))
}

/// Returns the plan of a recording in a folder with the limits of another scenario; `None` if that has other loops.
///
/// # Errors
/// If a file cannot be read or is not valid.
pub fn with_limits(
    plan: Plan,
    folder: &Path,
    scenario: &Path,
    catalogue: &Catalogue,
) -> Result<Option<Plan>, ReadError> {
    let frames = read_frames(folder)?;
    let limits = load(scenario, frames.as_ref(), catalogue)?;
    Ok(plan.with_limits_of(&limits))
}

/// Reads a scenario. Its frames have the meaning in the database of a recording, or otherwise that of the catalogue.
fn load(
    scenario: &Path,
    frames: Option<&Arc<Database>>,
    catalogue: &Catalogue,
) -> Result<Plan, ReadError> {
    let plan = match frames {
        Some(database) => Plan::load_recorded(scenario, database),
        None => Plan::load(scenario, catalogue),
    };
    plan.map_err(|error| ReadError::Scenario(Box::new(error)))
}

/// Reads the meaning of the frames of a recording, if its folder has it.
fn read_frames(folder: &Path) -> Result<Option<Arc<Database>>, ReadError> {
    let path = file_in(folder, file::FRAMES).map_err(ReadError::at(folder, file::FRAMES))?;
    match read_text(&path, Database::TEXT_BYTES_MAX as u64) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(ReadError::at(folder, file::FRAMES)(error)),
        Ok(text) => {
            let database = Database::parse(&text).map_err(ReadError::at(folder, file::FRAMES))?;
            Ok(Some(Arc::new(database)))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use scenario::Beside;

    /// A folder with a scenario counts as complete, so a killed sweep would continue without the table.
    #[test]
    fn a_folder_without_the_files_of_its_scenario_has_no_scenario() {
        let place = tempfile::tempdir().unwrap();
        let scenario = place.path().join("t.toml");
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 2.0\n[controller.pid]\n\
            [[reference.table]]\nfrom_seconds = 0.0\nfile = \"course.csv\"\n";
        fs::write(&scenario, text).unwrap();
        let table = place.path().join("course.csv");
        fs::write(
            &table,
            "time_seconds,position_millimetres\n0.0,10.0\n1.0,12.0\n",
        )
        .unwrap();
        let database = Arc::new(Database::shipped().clone());
        let plan = Plan::load_recorded(&scenario, &database).unwrap();
        let folder = RunFolder::create(&place.path().join("runs"), "t", 1, text).unwrap();
        fs::create_dir(folder.path().join("course.csv")).unwrap();
        write_plan(&folder, &plan).unwrap_err();
        assert!(folder.path().join(file::FRAMES).exists());
        assert!(!folder.scenario().exists());
    }

    #[test]
    fn a_rig_is_read_back_from_the_folder_with_its_eds() {
        let place = tempfile::tempdir().unwrap();
        let rig = "schema = 1\nname = \"b\"\n[node.controller]\nkind = \"controller\"\nnode_id = 1\n[node.drive]\n\
            kind = \"drive\"\nnode_id = 16\neds = \"sheets/drive.eds\"\n\
            limits = { current_amperes = 0.9, min = -1.0, max = 45.0, rate_max = 400.0 }\n\
            [loop.position]\nfeedback = \"drive.position\"\noutputs = [\"drive.current\"]\n";
        fs::create_dir(place.path().join("sheets")).unwrap();
        fs::write(place.path().join("sheets/drive.eds"), dbc::DRIVE_EDS).unwrap();
        let path = place.path().join("bench.toml");
        fs::write(&path, rig).unwrap();
        let text = "schema = 1\nrig = \"rig/bench.toml\"\nname = \"t\"\nduration_seconds = 2.0\n[controller.open_loop]\n";
        let beside = Beside::new(Path::new("t.toml")).with_rig(&path);
        let plan = Plan::parse_beside(&beside, text.to_owned(), &Catalogue::shipped()).unwrap();
        let folder = RunFolder::create(&place.path().join("runs"), "t", 1, text).unwrap();
        write_plan(&folder, &plan).unwrap();
        let read = read_plan(folder.path(), None, &Catalogue::shipped()).unwrap();
        let drive = |plan: &Plan| {
            plan.only_loop()
                .unwrap()
                .real_drive
                .as_ref()
                .unwrap()
                .eds
                .clone()
        };
        assert_eq!(drive(&read), drive(&plan));
        assert_eq!(read.shared.tables, plan.shared.tables);
        // Frames whose meaning cannot be read do not get that of the catalogue.
        fs::write(folder.path().join(file::FRAMES), [0xFF]).unwrap();
        let error = read_plan(folder.path(), None, &Catalogue::shipped()).unwrap_err();
        assert!(matches!(error, ReadError::File { .. }), "{error}");
    }
}
