//! Functions for several test files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Returns the root of the checkout.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("canrig lies in the root")
        .to_owned()
}

/// Returns the path of a shipped scenario.
pub(crate) fn scenario(name: &str) -> PathBuf {
    root().join("scenarios").join(name)
}

/// Returns the program, with its runs in `folder`.
pub(crate) fn canrig(folder: &Path, command: &str) -> Command {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig
        .arg(command)
        .arg("--output")
        .arg(folder)
        .env("NO_COLOR", "1");
    // A test looks at one play, also where stalls of the machine spoil it.
    if command == "run" {
        canrig.args(["--tries", "1"]);
    }
    canrig
}

/// Runs a command to its end; returns exit code, standard output and standard error.
pub(crate) fn output(command: &mut Command) -> (Option<i32>, String, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = command.output().unwrap();
    (
        status.code(),
        String::from_utf8(stdout).unwrap(),
        String::from_utf8(stderr).unwrap(),
    )
}

/// Returns the only run folder below a folder.
pub(crate) fn only_run(folder: &Path) -> PathBuf {
    let runs = runs(folder);
    assert_eq!(runs.len(), 1, "{runs:?}");
    runs[0].clone()
}

/// Returns all runs below a folder.
pub(crate) fn runs(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().path()).collect()
}

/// Writes a short scenario into `folder`: a warm hold.
pub(crate) fn short_scenario(folder: &Path, duration_seconds: f64) -> PathBuf {
    hold_scenario(folder, duration_seconds, 1.0)
}

/// Writes a warm hold with so much time between SYNCs that its nodes do not lose each other on a slow or busy machine.
pub(crate) fn unhurried_scenario(folder: &Path, duration_seconds: f64) -> PathBuf {
    hold_scenario(folder, duration_seconds, 100.0)
}

fn hold_scenario(folder: &Path, duration_seconds: f64, sync_period_milliseconds: f64) -> PathBuf {
    let path = folder.join("short.toml");
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"short\"\nduration_seconds = {duration_seconds:.1}\n\n\
         [bus]\nsync_period_milliseconds = {sync_period_milliseconds:.1}\n\n[controller.sliding_mode]\n\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n"
    );
    fs::write(&path, text).unwrap();
    path
}
