//! The scenario files that a command line names.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::console::print_diagnostic;
use crate::exit::Exit;
use rig::rig_file::RIG_FILE;
use rig::setup::Setup;
use worlds::catalogue::catalogue;

/// Levels of folders that are searched for scenarios.
const FOLDER_DEPTH_MAX: u32 = 8;

/// Reads and checks a scenario file; prints what is wrong with it.
///
/// # Errors
/// The exit code for it.
pub fn load(path: &Path) -> Result<Setup, Exit> {
    Setup::load(path, catalogue()).map_err(|error| {
        print_diagnostic(error);
        Exit::CannotStart
    })
}

/// Rig files lie beside scenarios.
pub(crate) fn is_scenario(path: &Path) -> bool {
    !path.ends_with(RIG_FILE)
}

/// The scenario files that the arguments name: files as they are, folders with everything wanted below them in order.
pub(crate) fn scenario_files(
    arguments: &[PathBuf],
    is_wanted: impl Fn(&Path) -> bool,
) -> Result<Vec<PathBuf>, String> {
    let mut files = Vec::new();
    for argument in arguments {
        if argument.is_dir() {
            let before = files.len();
            let searched = find_scenarios(argument, FOLDER_DEPTH_MAX, &mut files);
            searched.map_err(|error| format!("{} cannot be read: {error}", argument.display()))?;
            let found = files.split_off(before);
            files.extend(found.into_iter().filter(|path| is_wanted(path)));
            if files.len() == before {
                return Err(format!("{} holds no scenario (*.toml)", argument.display()));
            }
        } else {
            files.push(argument.clone());
        }
    }
    Ok(files)
}

fn find_scenarios(folder: &Path, depth: u32, files: &mut Vec<PathBuf>) -> io::Result<()> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()?;
    paths.sort();
    for path in paths {
        if path.is_dir() && depth > 0 {
            find_scenarios(&path, depth - 1, files)?;
        } else if path
            .extension()
            .is_some_and(|extension| extension == "toml")
        {
            files.push(path);
        }
    }
    Ok(())
}
