//! Reason why a command on a campaign did not complete, and the course that such commands share.

use std::path::{Path, PathBuf};

use plan::Plan;
use recording::run_folder::WriteError;
use runner::console::print_error;
use runner::exit::Exit;
use runner::identity::NoIdentity;
use runner::play::ValueArgs;
use runner::recorded::RecordedError;
use runner::scenarios;

use crate::campaign::Interrupted;
use crate::engine::EngineError;
use crate::sweep::part::NoPart;
use crate::sweep::store::StoreError;
use crate::sweep::sweep_cases::NoSweep;
use crate::sweep::uncopied::Changed;

/// Reason why a command did not complete.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CampaignError {
    #[error(transparent)]
    NoSweep(#[from] NoSweep),
    #[error(transparent)]
    NoPart(#[from] NoPart),
    #[error(transparent)]
    Record(#[from] RecordedError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Write(#[from] WriteError),
    #[error(transparent)]
    NoIdentity(#[from] NoIdentity),
    #[error(transparent)]
    Changed(#[from] Changed),
    #[error(transparent)]
    Engine(#[from] EngineError),
    #[error(
        "run {case} could not be played on this machine: {reason}. What is done is kept, that run is not: give the same command again"
    )]
    Machine { case: usize, reason: String },
    #[error("interrupted: {done} of {of} runs are done; give the same command again to continue")]
    Interrupted { done: usize, of: usize },
    #[error(
        "{0} before a broken run was made small; the runs are kept: give the same command again"
    )]
    Shrinking(#[from] Interrupted),
    #[error("a broken invariant cannot be shown by a smaller scenario: {0}")]
    Shrink(String),
    #[error("nothing was submitted from here that could be resumed ({} is not there); submit it with --engine", path.display())]
    NothingToResume { path: PathBuf },
    #[error(
        "this campaign was submitted already ({engine}, job {job}): --resume waits for it; `{cancel}` takes it away, then --resume submits the rest again"
    )]
    Submitted {
        engine: String,
        job: String,
        cancel: String,
    },
    #[error("this campaign was submitted by another canrig; go on with the one that did, {}, or move its folder away", program.display())]
    Program { program: PathBuf },
    #[error("this campaign has {found} parts, not {wanted}: leave out --parts, or move {} away", path.display())]
    Parts {
        found: usize,
        wanted: usize,
        path: PathBuf,
    },
    #[error(
        "{missing} of {of} parts were lost, and were submitted {rounds} times. What they did is kept: look at what their tasks printed in {}, then give the command again with --resume",
        logs.display()
    )]
    Lost {
        missing: usize,
        of: usize,
        rounds: u32,
        logs: PathBuf,
    },
    #[error(
        "the job goes on without this command: give it again with --resume and without --engine and --parts, or take the job away with `{cancel}`"
    )]
    LeftToEngine { cancel: String },
}

impl CampaignError {
    pub(crate) fn exit(&self) -> Exit {
        match self {
            Self::Store(error) => error.exit(),
            Self::Interrupted { .. } | Self::Shrinking(_) | Self::LeftToEngine { .. } => {
                Exit::Interrupted
            }
            Self::NoSweep(_)
            | Self::NoPart(_)
            | Self::Record(_)
            | Self::NothingToResume { .. }
            | Self::Submitted { .. }
            | Self::Program { .. }
            | Self::Parts { .. } => Exit::CannotStart,
            _ => Exit::BenchFailed,
        }
    }
}

/// Runs a command on the plan of a scenario, and prints the error that ends it.
pub(crate) fn run(
    scenario: &Path,
    values: &ValueArgs,
    command: impl FnOnce(&Plan) -> Result<Exit, CampaignError>,
) -> Exit {
    match scenarios::load(scenario, values) {
        Ok(plan) => command(&plan).unwrap_or_else(|error| {
            print_error(&format!("canrig: {error}"));
            error.exit()
        }),
        Err(exit) => exit,
    }
}
