//! The course that commands on a campaign share, and the failures that several of them have.

use std::path::Path;

use crate::campaign::NoResult;
use crate::sweep::cases::Cases;
use crate::sweep::row::SweepRow;
use plan::Plan;
use runner::console::failed;
use runner::exit::{Exit, Failure};
use runner::play::ValueArgs;
use runner::scenarios;

/// Returns the row of a case, also of one in which the program is at fault.
///
/// # Errors
/// The machine could not play the run.
pub(crate) fn row_of(
    cases: &dyn Cases,
    case: usize,
    played: Result<SweepRow, NoResult>,
) -> Result<SweepRow, Failure> {
    match played {
        Ok(row) => Ok(row),
        // The panic hook of the program prints the panic; the row says in which case it happened.
        Err(NoResult::Fault(reason)) => Ok(cases.faulty(case, reason)),
        Err(NoResult::Machine(reason)) => Err(Exit::BenchFailed.because(format!(
            "run {case} could not be played on this machine: {reason}. What is done is kept, that run is not: give the same command again"
        ))),
    }
}

/// Returns the failure of a campaign that the user stopped.
pub(crate) fn interrupted(done: usize, of: usize) -> Failure {
    Exit::Interrupted.because(format!(
        "interrupted: {done} of {of} runs are done; give the same command again to continue"
    ))
}

/// Runs a command on the plan of a scenario, and prints the error that ends it.
pub(crate) fn run(
    scenario: &Path,
    values: &ValueArgs,
    command: impl FnOnce(&Plan) -> Result<Exit, Failure>,
) -> Exit {
    match scenarios::load(scenario, values) {
        Ok(plan) => command(&plan).unwrap_or_else(|error| failed(error.exit, error)),
        Err(exit) => exit,
    }
}
