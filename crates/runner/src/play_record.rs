//! Time and place of a play, and values of the command line: `played.json` in its folder.
//!
//! Of a play in virtual time no other file may contain them: log, signals, verdict and page of two plays are the same to the byte,
//! and the times of the file system are lost when a file is copied.

use std::io;
use std::path::Path;

use jiff::Timestamp;
use platform::clock::Clock;
use recording::run_folder::{RunFolder, WriteError, file, file_in};
use scenario::Override;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::exit::Failure;
use crate::machine;
use crate::recorded::unreadable;

/// Largest file that is read, more than the record of a campaign of 10 000 parts needs.
const BYTES_MAX: u64 = 4 << 20;

/// Record of a scenario's play.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct PlayRecord {
    /// Begin of the play; for a sweep that was interrupted or merged, the time of its last continuation.
    pub at: Timestamp,
    /// Name of the machine; `None` if an older canrig played it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub host: Option<String>,
    /// Values of `--set`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub set: Vec<String>,
}

impl PlayRecord {
    /// Returns the record of a play that begins now.
    pub fn now(overrides: &[Override]) -> Self {
        let since_1970 = Clock::start().wall_epoch();
        Self {
            at: (Timestamp::UNIX_EPOCH.checked_add(since_1970)).unwrap_or_default(),
            host: Some(machine::name()),
            set: overrides.iter().map(Override::to_string).collect(),
        }
    }

    /// Returns the date as a text, to the minute.
    pub fn date(&self) -> String {
        self.at.strftime("%Y-%m-%d %H:%M UTC").to_string()
    }

    /// Returns date and host as a text.
    pub fn place(&self) -> String {
        let date = self.date();
        match &self.host {
            Some(host) => format!("{date} on {host}"),
            None => date,
        }
    }

    /// Writes the record into the folder of the play.
    ///
    /// # Errors
    /// The file cannot be written.
    ///
    /// # Panics
    /// Never: the record is plain data.
    pub fn write(&self, folder: &RunFolder) -> Result<(), WriteError> {
        let text = serde_json::to_string_pretty(self).expect("plain data");
        folder.write(file::PLAYED, format!("{text}\n").as_bytes())
    }

    /// Reads the record of a folder; `None` if an older canrig played it.
    ///
    /// # Errors
    /// The file cannot be read, or is damaged.
    pub fn read(folder: &Path) -> Result<Option<Self>, Failure> {
        read_json(folder, file::PLAYED)
    }
}

/// Reads a file of JSON in a folder that may be foreign; `None` if it is not there.
///
/// # Errors
/// The file cannot be read, or is damaged.
pub fn read_json<T: DeserializeOwned>(folder: &Path, name: &str) -> Result<Option<T>, Failure> {
    let read = || {
        let text = scenario::read_text(&file_in(folder, name)?, BYTES_MAX)?;
        serde_json::from_str(&text)
            .map_err(|error| io::Error::other(format!("it is damaged: {error}")))
    };
    match read() {
        Ok(record) => Ok(Some(record)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(unreadable(folder.join(name))(error)),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn what_is_written_reads_back_and_what_is_damaged_is_refused() {
        let parent = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(parent.path(), "run", 1, "").unwrap();
        assert_eq!(PlayRecord::read(folder.path()).unwrap(), None);
        let set = "name=a b".parse().unwrap();
        let record = PlayRecord::now(&[set]);
        assert_eq!(record.set, ["name=\"a b\""]);
        record.write(&folder).unwrap();
        assert_eq!(PlayRecord::read(folder.path()).unwrap(), Some(record));
        let path = folder.path().join(file::PLAYED);
        let plain = "{\"at\": \"2026-07-01T12:34:56Z\"}";
        fs::write(&path, plain).unwrap();
        let read = PlayRecord::read(folder.path()).unwrap().unwrap();
        assert_eq!((read.at.as_second(), read.set.len()), (1_782_909_296, 0));
        for damaged in ["", "{}", "{\"at\": \"yesterday\"}"] {
            fs::write(&path, damaged).unwrap();
            let error = PlayRecord::read(folder.path()).unwrap_err().to_string();
            assert!(
                error.contains("played.json` cannot be read: it is damaged"),
                "{error}"
            );
        }
    }
}
