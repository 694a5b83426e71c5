//! `canrig check`: scenario and rig files, without playing them.

use std::path::{Path, PathBuf};

use clap::Args;
use scenario::Override;
use scenario::rig::RigFile;

use crate::console::{print, print_error, usage_error};
use crate::exit::Exit;
use crate::play::ValueArgs;
use crate::scenarios::{read, read_rig, scenario_files};
use crate::shipped;
use rig::FILE_BYTES_MAX;

/// Arguments of `check`.
#[derive(Args, Debug)]
pub struct CheckArgs {
    /// Scenario or rig files, or folders of them
    #[arg(required = true, value_name = "FILE")]
    pub scenarios: Vec<PathBuf>,
    #[command(flatten)]
    pub values: ValueArgs,
}

/// Checks the files and says of each whether it is valid.
#[must_use]
pub fn check(args: &CheckArgs) -> Exit {
    let paths = match scenario_files(&args.scenarios, |_| true) {
        Ok(paths) => paths,
        Err(error) => return usage_error(&error),
    };
    let mut worst = Exit::Pass;
    for path in paths {
        match checked(&path, &args.values.overrides) {
            Ok(name) => print(&format!("{}: valid ({name})", path.display())),
            Err(error) => {
                print_error(&format!("{error:?}"));
                worst = worst.max(Exit::CannotStart);
            }
        }
    }
    worst
}

/// The name of a valid scenario or rig file.
fn checked(path: &Path, overrides: &[Override]) -> miette::Result<String> {
    let text = scenario::read_text(path, FILE_BYTES_MAX).unwrap_or_default();
    if RigFile::is_meant(&text) || shipped::rig(path).is_some() {
        let loaded = read_rig(path)?;
        return Ok(format!("rig: {}", loaded.file.name));
    }
    let scenario = read(path, overrides)?.scenario;
    Ok(match &scenario.sweep {
        Some(sweep) => format!("{}, {} runs in a sweep", scenario.name, sweep.runs()),
        None => scenario.name,
    })
}
