//! Errors of FMUs.

use std::fmt;
use std::path::{Path, PathBuf};

/// Error of an FMU.
#[derive(Debug, thiserror::Error)]
#[error("{}: {fault}", file.display())]
pub struct FmuError {
    /// File of the FMU.
    pub file: PathBuf,
    /// The error.
    pub fault: Fault,
}

/// Error of an FMU, without its file.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// A file, or one unpacked from it, cannot be read or written, or the worker cannot be started.
    #[error("{place}: {source}")]
    File {
        /// Path of the file, or the action.
        place: String,
        /// Error of the system.
        source: std::io::Error,
    },
    /// File, description, library, variable or table is invalid, or the worker cannot be reached.
    #[error("{0}")]
    Invalid(String),
    /// The FMU failed during the run. Every other error is found before motion begins.
    #[error("{0}")]
    InRun(String),
}

impl Fault {
    /// Adds the FMU's file.
    pub(crate) fn of(self, file: &Path) -> FmuError {
        FmuError {
            file: file.to_owned(),
            fault: self,
        }
    }

    /// Returns whether the FMU failed during the run.
    pub fn is_of_run(&self) -> bool {
        matches!(self, Self::InRun(_))
    }

    /// Makes the error of a description that is no XML.
    pub(crate) fn xml(reason: impl fmt::Display) -> Self {
        Self::Invalid(format!(
            "modelDescription.xml cannot be read as XML: {reason}"
        ))
    }

    /// Makes the error of a library that cannot be loaded.
    pub(crate) fn library(reason: impl fmt::Display) -> Self {
        Self::Invalid(format!("its library cannot be loaded: {reason}"))
    }

    /// Makes the error of a failed function, with the messages of the FMU; it has a time if the FMU has begun.
    pub(crate) fn call(
        function: &str,
        outcome: &str,
        time_seconds: Option<f64>,
        log: &str,
    ) -> Self {
        let said = said(log);
        match time_seconds {
            None => Self::Invalid(format!("{function} {outcome}{said}")),
            Some(time) => Self::InRun(format!("{function} {outcome} at {time} s{said}")),
        }
    }

    /// Makes the error of a missing or unsuitable variable.
    pub(crate) fn variable(variable: &str, reason: impl fmt::Display) -> Self {
        Self::Invalid(format!("variable `{variable}` {reason}"))
    }
}

/// Returns the messages of an FMU as the end of a sentence.
pub fn said(log: &str) -> String {
    match log.trim() {
        "" => String::new(),
        log => format!("; it said: {log}"),
    }
}
