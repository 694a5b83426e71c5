//! Scenario files in the arguments of a command line.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use miette::MietteDiagnostic;
use scenario::node::Profile;
use scenario::overrides::{overridden, set};
use scenario::rig::nodes::Rig;
use scenario::rig::shipped::{FOLDER, text as shipped_rig};
use scenario::{Beside, FileKind, read_text};

use crate::console::print_error;
use crate::exit::{Exit, Failure};
use crate::play::ValueArgs;
use crate::recorded::{holds_many_runs, unreadable};
use crate::shipped::{self, ShippedFile};
use plan::FILE_BYTES_MAX;
use plan::Plan;
use recording::run_folder::file;
use worlds::catalogue::catalogue;

/// Largest depth of folders that are searched for scenarios.
const FOLDER_DEPTH_MAX: u32 = 8;
/// Files beside the scenario of a run, of which each run folder has one.
const OF_RUN: [&str; 4] = [
    file::VERDICT,
    file::PLAYED,
    file::BUS_LOG,
    file::LONG_BUS_LOG,
];
/// Table of a law for all loops.
const ALL: &str = "all";

/// Reads and checks a scenario with other values, of one loop or of several: a file, or if there is none, the scenario that ships
/// by this name.
///
/// # Errors
/// There is no such scenario, or it is not valid.
pub fn load(path: &Path, values: &ValueArgs) -> Result<Plan, Failure> {
    load_for(path, values, &Use::default())
}

/// Loads as [`load`], to play the scenario.
///
/// # Errors
/// As [`load`], or the rig has no loop.
pub fn load_to_play(path: &Path, values: &ValueArgs) -> Result<Plan, Failure> {
    load(path, values).and_then(playable)
}

/// Returns a plan that can be played.
///
/// # Errors
/// The rig has no loop.
pub(crate) fn playable(plan: Plan) -> Result<Plan, Failure> {
    let required = plan.require_loop();
    let playable = required.map(|()| plan);
    playable.map_err(|why| Failure::invalid(MietteDiagnostic::new(why)))
}

/// Use of a scenario, which decides what it must have.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Use<'a> {
    /// Names of external nodes. A scenario that an external controller leads needs no law.
    pub(crate) external: &'a [String],
    /// Whether its limits may name unknown signals: a user who looks for the correct name has a wrong one in the file.
    pub(crate) takes_any_signal: bool,
}

/// Loads as [`load`], for a use of the scenario.
///
/// # Errors
/// As [`load`].
pub(crate) fn load_for(path: &Path, values: &ValueArgs, wanted: &Use<'_>) -> Result<Plan, Failure> {
    let place = path.display();
    let refused = |why: String, help: Option<String>| {
        let reason = MietteDiagnostic::new(why);
        Failure::invalid(MietteDiagnostic { help, ..reason })
    };
    let shipped = shipped::scenario(path);
    // It looks like the name of a scenario that ships.
    let is_bare_name = path.extension().is_none() && path.is_relative() && !path.exists();
    if shipped.is_none() && is_bare_name {
        let meant = shipped::meant(&path.to_string_lossy());
        let hint = meant.map_or_else(String::new, |meant| format!("did you mean `{meant}`? "));
        let help = format!("{hint}`canrig examples` lists those that ship");
        let why = format!("`{place}`: there is no such file, and no scenario of this name ships");
        return Err(refused(why, Some(help)));
    }
    let text = match shipped {
        Some(ShippedFile { text, .. }) => text.to_owned(),
        None => match read_text(path, FILE_BYTES_MAX) {
            Ok(text) => text,
            // `Plan::load` reports the reason.
            Err(_) => return Ok(Plan::load(path, catalogue())?),
        },
    };
    if values.program.is_empty() && is_program(path) {
        let help = format!(
            "a program that leads stands behind `--`: canrig simulate SCENARIO -- python3 {place}"
        );
        let why = format!("`{place}` is a program, not a scenario");
        return Err(refused(why, Some(help)));
    }
    let text = overridden(text, &values.all())
        .map_err(|why| refused(format!("`{place}`: {why}"), None))?;
    let (mut beside, command) =
        Beside::new(path)
            .with_program(&values.program)
            .map_err(|error| {
                let why = format!("`{place}`: the program cannot be found: {error}");
                refused(why, None)
            })?;
    if let Some(rig) = values.rig_file() {
        beside = beside.with_rig(rig);
    }
    let is_of_rig = |name: &str| Path::new(name).starts_with(FOLDER);
    let shipped_rig = values.rig_file().and_then(shipped::rig);
    let read = |name: &str| match (shipped, shipped_rig) {
        _ if beside.is_in_program(name) => beside.read(name),
        (_, Some(rig)) if is_of_rig(name) => Ok(rig.text.to_owned()),
        (Some(shipped), _) if !is_of_rig(name) => shipped.beside(name),
        _ => beside.read(name),
    };
    let text = match &command[..] {
        [] => led_from_outside(text, wanted.external, &read),
        command => led_by(text, command, &read),
    };
    let parse = if wanted.takes_any_signal {
        Plan::parse_with_any_signals
    } else {
        Plan::parse
    };
    Ok(parse(&beside, text, read, catalogue())?)
}

/// Returns the text of a scenario whose controller is a program. Errors of scenario and rig are reported when they are loaded.
fn led_by(text: String, command: &[String], read: &dyn Fn(&str) -> io::Result<String>) -> String {
    let Ok(mut document) = text.parse::<toml::Table>() else {
        return text;
    };
    let key = format!("node.{}.program", controller_name(&document, read));
    match set(&mut document, &key, command.to_vec().into()) {
        Ok(()) => document.to_string(),
        Err(_) => text,
    }
}

/// Returns the text of a scenario without a law whose controller is among the external nodes, with a law that commands nothing.
/// Errors are reported as those of [`led_by`].
fn led_from_outside(
    text: String,
    external: &[String],
    read: &dyn Fn(&str) -> io::Result<String>,
) -> String {
    let document = text.parse::<toml::Table>().ok();
    let laws = Profile::Manager.word();
    let without_law = document.filter(|document| !document.contains_key(laws));
    match without_law {
        Some(document) if external.contains(&controller_name(&document, read)) => {
            format!("{text}\n[{laws}.{ALL}.open_loop]\n")
        }
        _ => text,
    }
}

/// Returns the name of the controller in the rig of a scenario.
fn controller_name(document: &toml::Table, read: &dyn Fn(&str) -> io::Result<String>) -> String {
    let rig = document.get("rig").and_then(toml::Value::as_str);
    let rig_text = rig.and_then(|rig| match shipped_rig(rig) {
        Some(text) => Some(text.to_owned()),
        None => read(rig).ok(),
    });
    let rig = rig_text.and_then(|text| Rig::parse(&text, "").ok());
    let of_rig = rig.as_ref().and_then(Rig::controller);
    let controller = of_rig.map_or(Profile::Manager.word(), |(name, _)| name);
    controller.to_owned()
}

/// Returns the text of a rig file, or if there is none, of the one that ships by this name.
///
/// # Errors
/// There is no such rig file, or it cannot be read.
pub(crate) fn rig_text(path: &Path) -> io::Result<String> {
    let by_name = path.to_str().and_then(shipped_rig);
    let shipped = by_name.or_else(|| Some(shipped::rig(path)?.text));
    match shipped.filter(|_| !path.exists()) {
        Some(text) => Ok(text.to_owned()),
        None => read_text(path, FILE_BYTES_MAX),
    }
}

/// Returns whether a file is a program by its name.
fn is_program(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default();
    ["py", "c", "sh"].iter().any(|one| extension == *one)
}

/// Returns the intended kind of a file. One that cannot be read is taken for a scenario, whose reader reports why.
pub(crate) fn kind_of(path: &Path) -> FileKind {
    let text = read_text(path, FILE_BYTES_MAX);
    text.map_or(FileKind::Scenario, |text| FileKind::of(&text))
}

/// Returns whether a file is not a rig file; both may be in one folder.
pub(crate) fn is_to_play(path: &Path) -> bool {
    kind_of(path) != FileKind::Rig
}

/// Returns whether a file lies in the folder of a run or of a campaign, which wrote it.
pub(crate) fn is_left_by_a_play(path: &Path) -> bool {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    path.ancestors().skip(1).any(is_folder_of_a_play)
}

/// Returns whether a folder is that of a run or of a campaign.
fn is_folder_of_a_play(folder: &Path) -> bool {
    let has = |name| folder.join(name).exists();
    let is_of_run = || OF_RUN.into_iter().any(has);
    (has(file::SCENARIO) && is_of_run()) || holds_many_runs(folder)
}

/// Returns the scenario files in the arguments: files as they are, folders with every wanted file below them in order. What
/// plays have left below a folder is left out, and said.
pub(crate) fn scenario_files(
    arguments: &[PathBuf],
    is_wanted: impl Fn(&Path) -> bool,
) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for argument in arguments {
        if !argument.is_dir() {
            files.push(argument.clone());
            continue;
        }
        let folder = argument.display();
        let mut below = Below::default();
        find_scenarios(argument, FOLDER_DEPTH_MAX, &mut below).map_err(unreadable(argument))?;
        let Below { mut found, plays } = below;
        if let Some(first) = plays.first() {
            let (count, first) = (plays.len(), first.display());
            let folders = if count == 1 { "folder" } else { "folders" };
            print_error(&format!(
                "note: `{folder}`: {count} {folders} of runs left out, the first is `{first}`"
            ));
        }
        // A line is printed for each file, from which some CI systems take commands.
        let has_control = |path: &&PathBuf| path.to_string_lossy().contains(char::is_control);
        if let Some(path) = found.iter().find(has_control) {
            return Err(Exit::CannotStart.because(format!(
                "{path:?} has a line end or another control character in its name: rename it"
            )));
        }
        found.retain(|path| is_wanted(path));
        if found.is_empty() {
            let reason = format!("`{folder}` holds no scenario (*.toml)");
            return Err(Exit::CannotStart.because(reason));
        }
        files.extend(found);
    }
    Ok(files)
}

/// Contents of a folder.
#[derive(Default)]
struct Below {
    /// Files that may be scenarios.
    found: Vec<PathBuf>,
    /// Folders of runs and campaigns.
    plays: Vec<PathBuf>,
}

fn find_scenarios(folder: &Path, depth: u32, below: &mut Below) -> io::Result<()> {
    let entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    let mut paths = Vec::from_iter(entries.iter().map(fs::DirEntry::path));
    paths.sort();
    for path in paths {
        if path.is_dir() && is_folder_of_a_play(&path) {
            below.plays.push(path);
        } else if path.is_dir() && depth > 0 {
            find_scenarios(&path, depth - 1, below)?;
        } else if path.extension().is_some_and(|kind| kind == "toml") {
            below.found.push(path);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_leads_and_nodes_that_are_no_table_are_left_to_the_loader() {
        let read = |_: &str| -> io::Result<String> { unreachable!("the rig ships") };
        let led = |text: &str| led_by(text.to_owned(), &["./program".to_owned()], &read);
        let text = led("rig = \"sma_actuator\"\n");
        assert!(text.contains("program = [\"./program\"]"), "{text}");
        let wrong = "rig = \"sma_actuator\"\nnode = 3\n";
        assert_eq!(led(wrong), wrong);
    }
}
