//! Where the files are that a scenario names.

use std::io;
use std::path::{Path, PathBuf};

use crate::file::read_text;
use crate::fingerprint::{HASH_SUFFIX, hash_line};
use crate::rig::shipped;

/// Longest file that is named.
const BYTES_MAX: u64 = 64 << 20;

/// The place of a scenario, and that of the rig file which takes the place of the scenario's.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct Beside {
    scenario: PathBuf,
    rig: Option<PathBuf>,
}

impl Beside {
    /// The files beside a scenario.
    #[must_use]
    pub fn new(scenario: &Path) -> Self {
        Self {
            scenario: scenario.to_owned(),
            rig: None,
        }
    }

    /// The same with another rig file, whose name and those of the files beside it begin with [`shipped::FOLDER`].
    #[must_use]
    pub fn with_rig(self, rig: &Path) -> Self {
        let rig = Some(rig.to_owned());
        Self { rig, ..self }
    }

    /// The files beside another scenario in the same place.
    #[must_use]
    pub fn of_case(&self) -> Self {
        let scenario = self.scenario.with_file_name("case");
        Self {
            scenario,
            rig: self.rig.clone(),
        }
    }

    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &Path {
        &self.scenario
    }

    /// Where a file is.
    #[must_use]
    pub fn place(&self, name: &str) -> PathBuf {
        let (folder, name) = self.folder_of(name);
        folder.join(name)
    }

    fn folder_of<'a>(&'a self, name: &'a str) -> (&'a Path, &'a Path) {
        let of_rig = Path::new(name).strip_prefix(shipped::FOLDER).ok();
        match (&self.rig, of_rig) {
            (Some(rig), Some(name)) => {
                let own = rig.file_name().unwrap_or_default();
                let copy = shipped::copy_of(&own.to_string_lossy());
                let is_own = Path::new(&copy).file_name() == Some(name.as_os_str());
                (folder_of(rig), if is_own { Path::new(own) } else { name })
            }
            _ => (folder_of(&self.scenario), Path::new(name)),
        }
    }

    /// The text of a file, or the line with the hash of one that is no text.
    ///
    /// # Errors
    /// It cannot be read, or lies outside the folder.
    pub fn read(&self, name: &str) -> io::Result<String> {
        match name.strip_suffix(HASH_SUFFIX) {
            Some(file) => {
                let (folder, file) = self.folder_of(file);
                hash_line(folder, &file.to_string_lossy())
            }
            None => self.read_text(name),
        }
    }

    /// The text of a file.
    ///
    /// # Errors
    /// It cannot be read, or a link leads out of the folder.
    pub fn read_text(&self, name: &str) -> io::Result<String> {
        let (folder, name) = self.folder_of(name);
        let folder = match folder.as_os_str().is_empty() {
            true => Path::new("."),
            false => folder,
        };
        let path = folder.join(name).canonicalize()?;
        if !path.starts_with(folder.canonicalize()?) {
            return Err(io::Error::other("it lies outside the scenario's folder"));
        }
        read_text(&path, BYTES_MAX)
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}
