//! Scenario files in the arguments of a command line.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use miette::MietteDiagnostic;
use scenario::node::Part;
use scenario::overrides::{overridden, set};
use scenario::rig::nodes::Rig;
use scenario::rig::shipped::{FOLDER, text as shipped_rig};
use scenario::{Beside, read_text};

use crate::exit::{Exit, Failure};
use crate::play::ValueArgs;
use crate::recorded::unreadable;
use crate::shipped::{self, ShippedFile};
use plan::FILE_BYTES_MAX;
use plan::Plan;
use worlds::catalogue::catalogue;

/// Largest depth of folders that are searched for scenarios.
const FOLDER_DEPTH_MAX: u32 = 8;

/// Reads and checks a scenario with other values, of one loop or of several: a file, or if there is none, the scenario that ships
/// by this name.
///
/// # Errors
/// There is no such scenario, or it is not valid.
pub fn load(path: &Path, values: &ValueArgs) -> Result<Plan, Failure> {
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
    let text = if command.is_empty() {
        text
    } else {
        led_by(text, &command, &read)
    };
    Ok(Plan::parse(&beside, text, read, catalogue())?)
}

/// Returns the text of a scenario whose controller is a program. Errors of scenario and rig are reported when they are loaded.
fn led_by(text: String, command: &[String], read: &dyn Fn(&str) -> io::Result<String>) -> String {
    let Ok(mut document) = text.parse::<toml::Table>() else {
        return text;
    };
    let rig = document.get("rig").and_then(toml::Value::as_str);
    let rig_text = rig.and_then(|rig| match shipped_rig(rig) {
        Some(text) => Some(text.to_owned()),
        None => read(rig).ok(),
    });
    let rig = rig_text.and_then(|text| Rig::parse(&text, "").ok());
    let of_rig = rig.as_ref().and_then(Rig::controller);
    let controller = of_rig.map_or(Part::Controller.word(), |(name, _)| name);
    let key = format!("node.{controller}.program");
    match set(&mut document, &key, command.to_vec().into()) {
        Ok(()) => document.to_string(),
        Err(_) => text,
    }
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

/// Returns whether a file is a scenario and not a rig file; both may be in one folder.
pub(crate) fn is_scenario(path: &Path) -> bool {
    let text = read_text(path, FILE_BYTES_MAX);
    !text.is_ok_and(|text| Rig::is_meant(&text))
}

/// Returns the scenario files in the arguments: files as they are, folders with every wanted file below them in order.
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
        let mut found = Vec::new();
        find_scenarios(argument, FOLDER_DEPTH_MAX, &mut found).map_err(unreadable(argument))?;
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

fn find_scenarios(folder: &Path, depth: u32, files: &mut Vec<PathBuf>) -> io::Result<()> {
    let entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    let mut paths = Vec::from_iter(entries.iter().map(fs::DirEntry::path));
    paths.sort();
    for path in paths {
        if path.is_dir() && depth > 0 {
            find_scenarios(&path, depth - 1, files)?;
        } else if path.extension().is_some_and(|kind| kind == "toml") {
            files.push(path);
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
