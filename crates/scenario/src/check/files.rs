//! Finds the files that a scenario or its rig file names and that are not read as text: the programs, libraries and FMUs of laws,
//! nodes and plants. It checks where they lie, and reads their hashes.

use std::env;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use toml::Value;

use super::Check;
use crate::controller::Controller;
use crate::fingerprint::HASH_SUFFIX;
use crate::process_law::Plays;
use crate::table::{ReadTable, is_inside_folder};

const OUTSIDE: &str = "no absolute path, no `..`: it lies in this file's folder, or below it";

/// Files that a document names. Their hashes are added to the texts that were read; a recording may lack file and hash.
pub(crate) struct NamedFiles<'a, 'b> {
    /// Problems of the document.
    pub(crate) check: &'a mut Check<'b>,
    /// Name of the file that names the others, relative to the scenario; empty for the scenario itself.
    pub(crate) beside: &'a str,
    /// That file in messages: the scenario or the rig file.
    pub(crate) named_by: &'a str,
    pub(crate) is_recorded: bool,
    pub(crate) read_file: ReadTable<'a>,
}

impl NamedFiles<'_, '_> {
    /// Finds the files of a law that a process plays.
    pub(crate) fn of_law(&mut self, controller: &Controller) {
        let Some(law) = controller.process_law() else {
            return;
        };
        let (path, what) = (
            format!("controller.{}", controller.law_name()),
            "a file of the law",
        );
        match &law.plays {
            Plays::Command(words) => self.command(&format!("{path}.command"), words, what),
            Plays::Library(file) | Plays::Fmu(file) => {
                self.required(&format!("{path}.file"), file, what);
            }
        }
        let parameters = law.setup.parameters.iter();
        for (parameter, _) in parameters.filter(|(_, value)| !is_finite(value)) {
            let path = format!("{path}.parameters.{parameter}");
            let message = format!("the parameter `{parameter}` cannot be handed on");
            let label = "numbers that are finite, truths, texts, and lists and tables of them";
            self.check.at(&path, message, label);
        }
    }

    /// Finds the FMUs of plants.
    pub(crate) fn of_plants(&mut self) {
        for (plant, model) in &self.check.rig.plant {
            let Some(fmu) = &model.fmu else { continue };
            let path = format!("plant.{plant}.fmu.file");
            let what = format!("the FMU of `{plant}`");
            if fmu.file.ends_with(".fmu") {
                self.required(&path, &fmu.file, &what);
            } else {
                self.wrong(&path, &fmu.file, &what, "its name must end in .fmu");
            }
        }
    }

    /// Finds the files of a command; `what` describes each of them in messages.
    pub(crate) fn command(&mut self, path: &str, words: &[String], what: &str) {
        for (place, word) in words.iter().enumerate() {
            let path = format!("{path}.{place}");
            match place {
                0 => self.program(&path, word, what),
                _ => self.argument(&path, word, what),
            }
        }
    }

    /// Checks the first word of a command.
    fn program(&mut self, path: &str, word: &str, what: &str) {
        if word.contains('/') {
            self.required(path, word, what);
        } else if !self.is_recorded && !is_on_path(word) {
            let message = format!("no program `{word}` is on PATH");
            let label = format!("one beside this file is written `./{word}`");
            self.check.at(path, message, label);
        }
    }

    /// Checks a word that may be a file.
    fn argument(&mut self, path: &str, word: &str, what: &str) {
        match self.hash(word) {
            Ok(()) if self.is_recorded || is_inside_folder(word) => {}
            Ok(()) => self.wrong(path, word, what, OUTSIDE),
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                self.wrong(path, word, what, &error.to_string());
            }
            // The word is not a file.
            Err(_) => {}
        }
    }

    /// Checks a file that must exist.
    fn required(&mut self, path: &str, file: &str, what: &str) {
        if !is_inside_folder(file) {
            return self.wrong(path, file, what, OUTSIDE);
        }
        let Err(error) = self.hash(file) else { return };
        let label = match error.kind() {
            io::ErrorKind::NotFound => format!("there is no such file beside {}", self.named_by),
            _ => error.to_string(),
        };
        self.wrong(path, file, what, &label);
    }

    fn hash(&mut self, file: &str) -> io::Result<()> {
        // Components drop each `.`, so that a hash has one name.
        let place = Path::new(self.beside).with_file_name(file);
        let place = PathBuf::from_iter(place.components());
        match (self.read_file)(&format!("{}{HASH_SUFFIX}", place.to_string_lossy())) {
            Err(_) if self.is_recorded => Ok(()),
            read => read.map(drop),
        }
    }

    fn wrong(&mut self, path: &str, file: &str, what: &str, label: &str) {
        let message = format!("`{file}` cannot be {what}");
        self.check.at(path, message, label);
    }
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

/// Checks whether a program is found by its name alone.
fn is_on_path(name: &str) -> bool {
    let is_program = |path: &Path| {
        let metadata = path.metadata();
        metadata.is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
    };
    let folders = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&folders).any(|folder| is_program(&folder.join(name)))
}
