//! Exit codes, on which a caller may rely.

use std::process::ExitCode;

use dbc::SignalMissing;
use judge::verdict::Outcome;
use plan::data_sheet::DataSheetError;
use platform::bus::BusError;
use recording::run_folder::WriteError;
use recording::session::ReadError;
use scenario::ScenarioError;

/// End of a command, from best to worst in the order that decides between several scenarios.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[must_use = "it is the exit code of the program"]
pub enum Exit {
    /// Everything passed.
    Pass,
    /// The timing was not trustworthy, or a limit is on a value that no node publishes.
    Inconclusive,
    /// A limit was not met, or a node under test ended the run.
    VerdictFailed,
    /// The command cannot begin: a file is invalid, a program or a plant cannot be started, the pre-flight fails.
    CannotStart,
    /// A part of canrig failed, or the bus.
    BenchFailed,
    /// The program itself is at fault.
    Internal,
    /// The command line is wrong.
    Usage,
    /// The user stopped the command.
    Interrupted,
}

impl Exit {
    /// Returns the failure with this exit code, from an error or a text.
    pub fn because(self, reason: impl ToString) -> Failure {
        Failure {
            exit: self,
            reason: reason.to_string(),
            diagnostic: None,
        }
    }

    /// Returns the exit code of the process.
    pub fn code(self) -> u8 {
        match self {
            Self::Pass => 0,
            Self::VerdictFailed => 1,
            Self::Usage => 2,
            Self::CannotStart => 3,
            Self::BenchFailed => 4,
            Self::Inconclusive => 5,
            Self::Internal => 70,
            Self::Interrupted => 130,
        }
    }
}

/// Converts an outcome; a run that broke off is a failure of the bench.
impl From<Outcome> for Exit {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Pass => Self::Pass,
            Outcome::Fail => Self::VerdictFailed,
            Outcome::Inconclusive => Self::Inconclusive,
            Outcome::Incomplete => Self::BenchFailed,
        }
    }
}

/// Reason why a command did not complete, and its exit code.
#[derive(Debug, thiserror::Error)]
#[error("{reason}")]
pub struct Failure {
    pub exit: Exit,
    pub reason: String,
    /// The same reason as it is printed, with places in a file and advice; `None` if it is printed in one line.
    pub diagnostic: Option<miette::Report>,
}

impl Failure {
    /// Returns the failure of a scenario or rig file that cannot be used.
    pub fn invalid(error: impl Into<miette::Report>) -> Self {
        let report = error.into();
        Self {
            exit: Exit::CannotStart,
            reason: report.to_string(),
            diagnostic: Some(report),
        }
    }
}

impl From<ScenarioError> for Failure {
    fn from(error: ScenarioError) -> Self {
        Self::invalid(error)
    }
}

impl From<ReadError> for Failure {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Scenario(error) => (*error).into(),
            file @ ReadError::File { .. } => Exit::CannotStart.because(file),
        }
    }
}

impl From<SignalMissing> for Failure {
    fn from(error: SignalMissing) -> Self {
        Exit::CannotStart.because(error)
    }
}

impl From<DataSheetError> for Failure {
    fn from(error: DataSheetError) -> Self {
        Exit::Usage.because(error)
    }
}

impl From<BusError> for Failure {
    fn from(error: BusError) -> Self {
        Exit::BenchFailed.because(error)
    }
}

impl From<WriteError> for Failure {
    fn from(error: WriteError) -> Self {
        Exit::BenchFailed.because(error)
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_of_several_scenarios_decides() {
        // 70 > 4 > 3 > 1 > 5 > 0
        let order = [
            Exit::Internal,
            Exit::BenchFailed,
            Exit::CannotStart,
            Exit::VerdictFailed,
            Exit::Inconclusive,
        ];
        assert!(order.windows(2).all(|pair| pair[0] > pair[1]));
        assert!(Exit::Inconclusive > Exit::Pass);
    }
}
