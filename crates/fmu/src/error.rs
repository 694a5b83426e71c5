//! Errors of FMUs.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

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
    /// A file, or one unpacked from it, cannot be read or written.
    #[error("{place}: {source}")]
    File {
        /// Path of the file, or the action.
        place: String,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The description is no XML.
    #[error("modelDescription.xml cannot be read as XML: {0}")]
    Xml(String),
    /// The library cannot be loaded.
    #[error("its library cannot be loaded: {0}")]
    Library(String),
    /// A function failed.
    #[error("{function} {outcome}{}{}", at(*.time_seconds), said(.log))]
    Call {
        /// Name of the function.
        function: &'static str,
        /// Result of the function.
        outcome: String,
        /// Time in the FMU, if it has begun.
        time_seconds: Option<f64>,
        /// Messages of the FMU.
        log: String,
    },
    /// A value is no finite number.
    #[error("variable `{variable}` is {value} at {time_seconds} s: {whose}")]
    NotFinite {
        /// Name of the variable.
        variable: String,
        /// Value of the variable.
        value: f64,
        /// Time in the FMU.
        time_seconds: f64,
        /// Source of the value.
        whose: &'static str,
    },
    /// The FMU ended the simulation.
    #[error("the FMU ended the simulation by itself at {time_seconds} s{}", said(.log))]
    Terminated {
        /// Time in the FMU.
        time_seconds: f64,
        /// Messages of the FMU.
        log: String,
    },
    /// The worker has ended.
    #[error("the process that had it loaded {how} while it {doing}; only this run is lost{}", said(.log))]
    Died {
        /// End of the process, such as `was ended by signal 11 (SIGSEGV)`.
        how: String,
        /// Operation that was requested.
        doing: String,
        /// Text on its standard error.
        log: String,
    },
    /// The worker does not answer.
    #[error("it did not return within {patience:?} while it {doing}; its process was ended")]
    Hangs {
        /// Operation that was requested.
        doing: String,
        /// Time limit of the operation.
        patience: Duration,
    },
    /// The worker cannot be started or reached.
    #[error("the process that is to load it {0}")]
    Worker(String),
    /// File, description, library, variable or table is invalid in another way.
    #[error("{0}")]
    Invalid(String),
    /// A worker reported another error.
    #[error("{text}")]
    Told {
        /// Text of the error.
        text: String,
        /// Whether it occurred in the run, not before.
        in_run: bool,
    },
}

impl Fault {
    /// Adds the FMU's file.
    pub(crate) fn of(self, file: &Path) -> FmuError {
        FmuError {
            file: file.to_owned(),
            fault: self,
        }
    }

    /// Returns whether the FMU failed during the run. Every other error is found before motion begins.
    pub fn is_of_run(&self) -> bool {
        match self {
            Self::NotFinite { .. } | Self::Terminated { .. } => true,
            Self::Call { time_seconds, .. } => time_seconds.is_some(),
            Self::Died { doing, .. } | Self::Hangs { doing, .. } => doing.starts_with("stepped"),
            Self::Told { in_run, .. } => *in_run,
            _ => false,
        }
    }

    /// Makes the error of a missing or unsuitable variable.
    pub(crate) fn variable(variable: &str, reason: impl fmt::Display) -> Self {
        Self::Invalid(format!("variable `{variable}` {reason}"))
    }
}

fn at(time_seconds: Option<f64>) -> String {
    time_seconds.map_or_else(String::new, |time| format!(" at {time} s"))
}

fn said(log: &str) -> String {
    match log.trim() {
        "" => String::new(),
        log => format!("; it said: {log}"),
    }
}
