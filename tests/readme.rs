//! The README: its command prints what it shows, and its first screen is short.

use std::fs;
use std::process::Command;

use crate::support::{only_run, output, root};

/// Largest number of lines above the first table.
const FIRST_SCREEN_LINES_MAX: usize = 40;
/// Largest number of rows of "Common tasks".
const TASKS_MAX: usize = 10;

fn readme() -> String {
    fs::read_to_string(root().join("README.md")).unwrap()
}

/// Returns the lines of a table on a terminal.
fn table(text: &str) -> Vec<&str> {
    let lines = text.lines().map(str::trim);
    let lines = lines.filter(|line| line.starts_with(['┌', '│', '╞', '└']));
    lines.collect()
}

/// The numbers are those of lock-step, which are the same on every machine. The moving picture
/// shows the same run.
#[test]
fn the_command_prints_the_numbers_of_the_readme() {
    let readme = readme();
    let prefix = "cargo run --release -- ";
    let mut commands = readme.lines().filter_map(|line| line.strip_prefix(prefix));
    let words = commands.next().unwrap().split_whitespace();
    assert!(
        words
            .clone()
            .eq(["run", "scenarios/step.toml", "--clock", "lockstep"])
    );
    let folder = tempfile::tempdir().unwrap();
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let canrig = canrig.args(words).arg("--output").arg(folder.path());
    let (code, stdout, stderr) = output(canrig.current_dir(root()).env("NO_COLOR", "1"));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert_eq!(table(&readme), table(&stdout));
    let run = only_run(folder.path());
    let name = run.file_name().unwrap().to_string_lossy().into_owned();
    let version_independent = name.rsplit_once('-').unwrap().0;
    assert!(readme.contains(&format!("run folder  runs/{version_independent}-")));

    let (code, picture, stderr) = output(
        Command::new("python3")
            .arg(root().join("docs/draw_step"))
            .arg(&run),
    );
    assert_eq!(code, Some(0), "{stderr}");
    let committed = fs::read_to_string(root().join("docs/step.svg")).unwrap();
    assert!(committed.len() < 1 << 20);
    assert!(
        picture == committed,
        "docs/step.svg is not the picture of this run: write it anew with docs/draw_step"
    );
}

#[test]
fn the_first_screen_and_the_tasks_are_short() {
    let readme = readme();
    let is_table = |line: &str| line.trim_start().starts_with(['┌', '|']);
    let above = readme.lines().take_while(|line| !is_table(line)).count();
    assert!(above <= FIRST_SCREEN_LINES_MAX, "{above} lines");
    let first: Vec<&str> = readme.lines().take(above).collect();
    for shown in [
        "docs/step.svg",
        "--clock lockstep",
        "cargo test --release --workspace",
    ] {
        assert!(first.iter().any(|line| line.contains(shown)), "{shown}");
    }
    let (_, tasks) = readme
        .split_once("| task | command |\n|---|---|\n")
        .unwrap();
    let tasks = tasks
        .lines()
        .take_while(|line| line.starts_with('|'))
        .count();
    assert!((1..=TASKS_MAX).contains(&tasks), "{tasks} tasks");
}
