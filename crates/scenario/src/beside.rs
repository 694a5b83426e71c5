//! Locations of the files that a scenario names.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use crate::file::{is_sheet, read_sheet, read_text};
use crate::fingerprint::{HASH_SUFFIX, hash_line};
use crate::rig::shipped;

/// Longest file that a scenario may name.
const BYTES_MAX: u64 = 64 << 20;

/// Folder under which a scenario names the files of a program of the command line.
const PROGRAM_FOLDER: &str = "program";

/// Locations of a scenario, of the rig file that replaces the scenario's own, and of the files of a program of the command line.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct Beside {
    scenario: PathBuf,
    rig: Option<PathBuf>,
    program: BTreeMap<String, PathBuf>,
}

impl Beside {
    /// Returns the files in the folder of a scenario.
    pub fn new(scenario: &Path) -> Self {
        Self {
            scenario: scenario.to_owned(),
            ..Self::default()
        }
    }

    /// Replaces the rig file. Its name, and the names of the files in its folder, begin with [`shipped::FOLDER`].
    #[must_use]
    pub fn with_rig(self, rig: &Path) -> Self {
        let rig = Some(rig.to_owned());
        Self { rig, ..self }
    }

    /// Adds a program of the command line, and returns its command as the scenario has it: each file is named below `program/`.
    ///
    /// # Errors
    /// A file cannot be found any more.
    pub fn with_program(mut self, words: &[String]) -> io::Result<(Self, Vec<String>)> {
        let mut named = Vec::new();
        for (place, word) in words.iter().enumerate() {
            let is_searched = place == 0 && !word.contains('/');
            if is_searched || !Path::new(word).is_file() {
                named.push(word.clone());
                continue;
            }
            // Of a link: the interpreter of a virtual environment is one.
            let path = std::path::absolute(word)?;
            let file = path.file_name().unwrap_or_default().to_string_lossy();
            let name = match format!("{PROGRAM_FOLDER}/{file}") {
                taken if self.program.contains_key(&taken) => {
                    format!("{PROGRAM_FOLDER}/{place}-{file}")
                }
                name => name,
            };
            self.program.insert(name.clone(), path);
            named.push(name);
        }
        Ok((self, named))
    }

    /// Checks whether a file, or the hash of a file, belongs to the program of the command line.
    pub fn is_in_program(&self, name: &str) -> bool {
        let file = name.strip_suffix(HASH_SUFFIX).unwrap_or(name);
        self.program.contains_key(file)
    }

    /// Returns the command that starts a program, and the folder in which it starts; `named_in` is the file that names the
    /// program.
    pub fn command(&self, words: &[String], named_in: &str) -> (Vec<String>, PathBuf) {
        let file = |word: &String| self.program.get(word);
        let placed = words.iter().map(|word| match file(word) {
            Some(path) => path.to_string_lossy().into_owned(),
            None => word.clone(),
        });
        let names_file = words.iter().any(|word| file(word).is_some());
        let file = match named_in {
            "" => self.scenario.clone(),
            rig => self.place(rig),
        };
        let own = Some(folder_of(&file)).filter(|_| !names_file);
        let folder = own.map_or(Path::new("."), or_here);
        (placed.collect(), folder.to_owned())
    }

    /// Returns the files of another scenario in the same folder.
    pub fn for_case(&self) -> Self {
        let scenario = self.scenario.with_file_name("case");
        Self {
            scenario,
            ..self.clone()
        }
    }

    /// Returns the path of the scenario.
    pub fn scenario(&self) -> &Path {
        &self.scenario
    }

    /// Returns the path of a file.
    pub fn place(&self, name: &str) -> PathBuf {
        let (folder, name) = self.folder_of(name);
        folder.join(name)
    }

    fn folder_of<'a>(&'a self, name: &'a str) -> (&'a Path, &'a Path) {
        if let Some(path) = self.program.get(name) {
            return (
                folder_of(path),
                Path::new(path.file_name().unwrap_or_default()),
            );
        }
        let in_folder = Path::new(name).strip_prefix(shipped::FOLDER).ok();
        match (&self.rig, in_folder) {
            (Some(rig), Some(name)) => {
                let file_name = rig.file_name().unwrap_or_default();
                let copy = shipped::copied_name(&file_name.to_string_lossy());
                let is_rig = Path::new(&copy).file_name() == Some(name.as_os_str());
                (
                    folder_of(rig),
                    if is_rig { Path::new(file_name) } else { name },
                )
            }
            _ => (folder_of(&self.scenario), Path::new(name)),
        }
    }

    /// Reads the text of a file, or the line with the hash of a file that is not text.
    ///
    /// # Errors
    /// The file cannot be read, or lies outside the folder.
    pub fn read(&self, name: &str) -> io::Result<String> {
        match name.strip_suffix(HASH_SUFFIX) {
            Some(file) => {
                let (folder, file) = self.folder_of(file);
                hash_line(folder, &file.to_string_lossy())
            }
            None => self.read_text(name),
        }
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// The file cannot be read, or a link leads out of the folder.
    pub fn read_text(&self, name: &str) -> io::Result<String> {
        let (folder, name) = self.folder_of(name);
        let folder = or_here(folder);
        let path = folder.join(name).canonicalize()?;
        if !path.starts_with(folder.canonicalize()?) {
            return Err(io::Error::other("it lies outside the scenario's folder"));
        }
        if is_sheet(name) {
            return read_sheet(&path, BYTES_MAX);
        }
        read_text(&path, BYTES_MAX)
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

/// Returns the path by which a folder without a name is opened.
fn or_here(folder: &Path) -> &Path {
    if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    }
}
