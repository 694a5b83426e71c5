//! What a run folder holds of its setup, so that the folder can be run and judged by itself.

use std::fs;
use std::path::Path;

use rig::rig_file::LoadedRig;
use rig::setup::Setup;
use scenario::Scenario;

use crate::run_folder::{RunFolder, WriteError, file};

/// Writes the scenario with the files that it names, and the rig file with its EDS.
///
/// # Errors
/// A file cannot be read or written.
pub fn write_setup(folder: &RunFolder, setup: &Setup) -> Result<(), WriteError> {
    folder.write(file::SCENARIO, setup.text.as_bytes())?;
    copy_tables(folder, setup, "")?;
    match &setup.rig {
        Some(rig) => write_rig(folder, rig),
        None => Ok(()),
    }
}

/// Copies the files that the scenario names for scenarios in a folder of the folder, which is made.
///
/// # Errors
/// A file cannot be read or written.
pub fn copy_tables(folder: &RunFolder, setup: &Setup, place: &str) -> Result<(), WriteError> {
    let to = folder.path().join(place);
    fs::create_dir_all(&to).map_err(WriteError::at(&to))?;
    let parent = setup.path.parent().unwrap_or(Path::new("."));
    for file in tables_of(&setup.scenario) {
        folder.copy(&parent.join(file), Path::new(place).join(file))?;
    }
    Ok(())
}

/// The rig file and its EDS, so that the recording can be read by itself.
fn write_rig(folder: &RunFolder, rig: &LoadedRig) -> Result<(), WriteError> {
    folder.write(file::RIG, rig.text.as_bytes())?;
    let Some(eds) = &rig.file.drive.eds else {
        return Ok(());
    };
    let place = folder.path().join(eds);
    let beside = place.parent().unwrap_or(folder.path());
    fs::create_dir_all(beside).map_err(WriteError::at(beside))?;
    folder.write(eds, rig.eds.as_bytes())
}

/// The files that a scenario names: tables of set-points and recorded courses.
pub fn tables_of(scenario: &Scenario) -> impl Iterator<Item = &str> {
    let tables = scenario.reference.table.iter().map(|table| &table.file);
    let courses = scenario.expect.signal.iter();
    let courses = courses.filter_map(|check| check.follows.as_ref());
    let files = tables.chain(courses.map(|course| &course.file));
    files.map(String::as_str)
}
