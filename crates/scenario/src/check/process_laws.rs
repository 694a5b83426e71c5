//! Finds the files of programs, of laws and of nodes: checks where they lie, and reads their hashes.

use std::env;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use toml::Value;

use crate::controller::Controller;
use crate::document::Document;
use crate::error::Problem;
use crate::fingerprint::HASH_SUFFIX;
use crate::process_law::Plays;
use crate::table::{ReadTable, is_inside_folder};

const OUTSIDE: &str = "no absolute path, no `..`: it lies in this file's folder, or below it";

/// Finds the files of a law that a process plays, and adds their hashes to the texts that were read. A recording may lack file
/// and hash.
pub(crate) fn read_files(
    document: &Document<'_>,
    controller: &Controller,
    is_recorded: bool,
    read_file: ReadTable<'_>,
) -> Vec<Problem> {
    let Some(law) = controller.process_law() else {
        return Vec::new();
    };
    let name = controller.law_name();
    let mut files = Files {
        document,
        beside: "",
        whose: "the law",
        is_recorded,
        read_file,
    };
    let mut problems = Vec::new();
    match &law.plays {
        Plays::Command(words) => {
            problems.extend(files.command(&format!("controller.{name}.command"), words));
        }
        Plays::Library(file) | Plays::Fmu(file) => {
            let path = format!("controller.{name}.file");
            problems.extend(files.required(&path, file));
        }
    }
    for (parameter, value) in &law.parameters {
        if !is_finite(value) {
            let path = format!("controller.{name}.parameters.{parameter}");
            let message = format!("the parameter `{parameter}` cannot be handed on");
            let label = "numbers that are finite, truths, texts, and lists and tables of them";
            problems.push(document.problem(&path, message, label));
        }
    }
    problems
}

/// Finds the files of the programs that play nodes, as [`read_files`] does. `beside` is the name, in the scenario, of the file
/// that names them.
pub(crate) fn read_programs<'a>(
    document: &Document<'_>,
    programs: impl IntoIterator<Item = (&'a String, &'a Vec<String>)>,
    beside: &str,
    is_recorded: bool,
    read_file: ReadTable<'_>,
) -> Vec<Problem> {
    let mut files = Files {
        document,
        beside,
        whose: "the node",
        is_recorded,
        read_file,
    };
    let mut problems = Vec::new();
    for (node, words) in programs {
        problems.extend(files.command(&format!("node.{node}.program"), words));
    }
    problems
}

/// Checks whether a value has a form in JSON.
fn is_finite(value: &Value) -> bool {
    match value {
        Value::Float(number) => number.is_finite(),
        Value::Datetime(_) => false,
        Value::Array(values) => values.iter().all(is_finite),
        Value::Table(values) => values.values().all(is_finite),
        Value::String(_) | Value::Integer(_) | Value::Boolean(_) => true,
    }
}

struct Files<'a, 'b> {
    document: &'a Document<'b>,
    /// Name of the file that names the others, relative to the scenario; empty for the scenario itself.
    beside: &'a str,
    /// Owner of the files in messages.
    whose: &'static str,
    is_recorded: bool,
    read_file: ReadTable<'a>,
}

impl Files<'_, '_> {
    fn command(&mut self, path: &str, words: &[String]) -> Vec<Problem> {
        let words = words.iter().enumerate();
        let problems = words.filter_map(|(place, word)| {
            let path = format!("{path}.{place}");
            match place {
                0 => self.program(&path, word),
                _ => self.argument(&path, word),
            }
        });
        problems.collect()
    }

    /// Checks the first word of a command.
    fn program(&mut self, path: &str, word: &str) -> Option<Problem> {
        if word.contains('/') {
            return self.required(path, word);
        }
        if self.is_recorded || is_on_path(word) {
            return None;
        }
        let message = format!("no program `{word}` is on PATH");
        let label = format!("one beside this file is written `./{word}`");
        Some(self.document.problem(path, message, label))
    }

    /// Checks a word that may be a file.
    fn argument(&mut self, path: &str, word: &str) -> Option<Problem> {
        match self.hash(word) {
            Ok(()) if self.is_recorded || is_inside_folder(word) => None,
            Ok(()) => Some(self.wrong(path, word, OUTSIDE)),
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                Some(self.wrong(path, word, &error.to_string()))
            }
            // The word is not a file.
            Err(_) => None,
        }
    }

    /// Checks a file that must exist.
    fn required(&mut self, path: &str, file: &str) -> Option<Problem> {
        if !is_inside_folder(file) {
            return Some(self.wrong(path, file, OUTSIDE));
        }
        let error = self.hash(file).err()?;
        let label = match (error.kind(), self.beside) {
            (io::ErrorKind::NotFound, "") => "there is no such file beside the scenario".to_owned(),
            (io::ErrorKind::NotFound, _) => "there is no such file beside the rig file".to_owned(),
            _ => error.to_string(),
        };
        Some(self.wrong(path, file, &label))
    }

    fn hash(&mut self, file: &str) -> io::Result<()> {
        let file = beside(self.beside, file);
        let read = (self.read_file)(&format!("{file}{HASH_SUFFIX}"));
        match read {
            Err(_) if self.is_recorded => Ok(()),
            read => read.map(drop),
        }
    }

    fn wrong(&self, path: &str, file: &str, label: &str) -> Problem {
        let message = format!("`{file}` cannot be a file of {}", self.whose);
        self.document.problem(path, message, label)
    }
}

/// Returns the name that the scenario has for a file that another file names; `of` is that file, or empty for the scenario.
fn beside(of: &str, file: &str) -> String {
    let place = match of {
        "" => PathBuf::from(file),
        of => Path::new(of).with_file_name(file),
    };
    // Components drop each `.`, so that a hash has one name.
    let place = PathBuf::from_iter(place.components());
    place.to_string_lossy().into_owned()
}

/// Checks whether a program is found by its name alone.
fn is_on_path(name: &str) -> bool {
    let is_program = |path: &Path| {
        let metadata = path.metadata();
        metadata.is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
    };
    let folders = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&folders).any(|folder| is_program(&folder.join(name)))
}
