//! The course that commands on a campaign share, and the failures that several of them have.

use std::path::Path;

use plan::Plan;
use runner::console::failed;
use runner::exit::{Exit, Failure};
use runner::play::ValueArgs;
use runner::scenarios;

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
