//! What can be wrong with an FMU.

use std::path::{Path, PathBuf};
use std::time::Duration;

/// What is wrong with an FMU, and which one it is.
#[derive(Debug, thiserror::Error)]
#[error("{}: {fault}", file.display())]
pub struct FmuError {
    /// The FMU.
    pub file: PathBuf,
    /// What is wrong.
    pub fault: Fault,
}

/// What is wrong.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The file, or what is unpacked of it, cannot be read or written.
    #[error("{place}: {source}")]
    File {
        /// Which file, or what is done.
        place: String,
        /// Why not.
        source: std::io::Error,
    },
    /// No zip file that is taken.
    #[error("{0}")]
    Archive(String),
    /// The description is no XML.
    #[error("modelDescription.xml is no XML that is taken: {0}")]
    Xml(String),
    /// The description says what cannot be.
    #[error("modelDescription.xml, line {line}: {reason}")]
    Description {
        /// Line of the element.
        line: u32,
        /// What is wrong.
        reason: String,
    },
    /// It needs of FMI what is not served.
    #[error("{0}")]
    NotServed(String),
    /// A variable that is missing, or cannot be what it is to be.
    #[error("variable `{variable}` {reason}")]
    Variable {
        /// Its name.
        variable: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The table of the rig file asks for something else that cannot be.
    #[error("{0}")]
    Table(String),
    /// There is no library for this machine.
    #[error("it has no library for this machine ({wanted}); it has {found}")]
    Platform {
        /// The folder below `binaries` that would have it.
        wanted: String,
        /// The folders that there are.
        found: String,
    },
    /// The library cannot be loaded.
    #[error("its library cannot be loaded: {0}")]
    Library(String),
    /// A function is missing.
    #[error("its library has no function `{0}`, which it must have")]
    Symbol(String),
    /// A function did not do what it is for.
    #[error("{function} {outcome}{}{}", at(*.time_seconds), said(.log))]
    Call {
        /// The function.
        function: &'static str,
        /// What it returned.
        outcome: String,
        /// Time in the FMU, where there is one.
        time_seconds: Option<f64>,
        /// What the FMU said.
        log: String,
    },
    /// A value that is no finite number.
    #[error("variable `{variable}` is {value} at {time_seconds} s: {whose}")]
    NotFinite {
        /// The variable.
        variable: String,
        /// Its value.
        value: f64,
        /// Time in the FMU.
        time_seconds: f64,
        /// Who computed it.
        whose: &'static str,
    },
    /// The FMU wants no more.
    #[error("the FMU ended the simulation by itself at {time_seconds} s{}", said(.log))]
    Terminated {
        /// When.
        time_seconds: f64,
        /// What the FMU said.
        log: String,
    },
    /// The worker is gone.
    #[error("the process that had it loaded {how} while it {doing}; only this run is lost{}", said(.log))]
    Died {
        /// Such as `was ended by signal 11 (SIGSEGV)`.
        how: String,
        /// What it was asked to do.
        doing: String,
        /// What it wrote on its standard error.
        log: String,
    },
    /// The worker does not answer.
    #[error("it did not return within {patience:?} while it {doing}; its process was ended")]
    Hangs {
        /// What it was asked to do.
        doing: String,
        /// How long it had.
        patience: Duration,
    },
    /// The worker cannot be started or reached.
    #[error("the process that is to load it {0}")]
    Worker(String),
    /// A worker told of another fault.
    #[error("{text}")]
    Told {
        /// In words.
        text: String,
        /// Whether it was in the run, not before.
        in_run: bool,
    },
}

impl Fault {
    /// The same with the FMU's file.
    pub(crate) fn of(self, file: &Path) -> FmuError {
        FmuError {
            file: file.to_owned(),
            fault: self,
        }
    }

    /// The FMU failed while it played; all else is found before anything moves.
    #[must_use]
    pub fn is_of_run(&self) -> bool {
        match self {
            Self::NotFinite { .. } | Self::Terminated { .. } => true,
            Self::Call { time_seconds, .. } => time_seconds.is_some(),
            Self::Died { doing, .. } | Self::Hangs { doing, .. } => doing.starts_with("stepped"),
            Self::Told { in_run, .. } => *in_run,
            _ => false,
        }
    }

    /// A variable that cannot be what it is to be.
    pub(crate) fn variable(variable: &str, reason: impl Into<String>) -> Self {
        Self::Variable {
            variable: variable.to_owned(),
            reason: reason.into(),
        }
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
