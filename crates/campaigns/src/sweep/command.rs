//! `canrig sweep`: plays the remaining cases, then writes tables and a summary of all.

use std::path::PathBuf;

use clap::Args;

use super::Shard;
use super::cases::Cases;
use super::estimate::Estimate;
use super::finish::{FinishError, Shown, finish};
use super::part::{PartArgs, PartError, PartPlay};
use super::sweep_cases::{NoSweep, SweepCases};
use crate::campaign::Campaign;
use plan::Plan;
use runner::console::{print, print_error};
use runner::exit::Exit;
use runner::lines::EventLines;
use runner::play::ValueArgs;
use runner::run::RUNS;
use runner::scenarios;
use worlds::law_process::started_by;

/// Reason why a sweep did not complete.
#[derive(Debug, thiserror::Error)]
enum SweepError {
    #[error(transparent)]
    NoSweep(#[from] NoSweep),
    #[error(transparent)]
    Part(#[from] PartError),
    #[error(transparent)]
    Finish(#[from] FinishError),
}

impl SweepError {
    fn exit(&self) -> Exit {
        match self {
            Self::NoSweep(_) => Exit::CannotStart,
            Self::Part(error) => error.exit(),
            Self::Finish(_) => Exit::BenchFailed,
        }
    }
}

/// Arguments of `sweep`.
#[derive(Args, Debug)]
pub struct SweepArgs {
    /// A scenario file with a [sweep] table
    pub scenario: PathBuf,
    /// Folder in which the sweep's folder is made; an interrupted sweep that is there is continued
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    #[command(flatten)]
    pub part: PartArgs,
    /// Play some runs to estimate parts, time, memory and disk of all runs on an engine. No result is
    /// kept
    #[arg(long, conflicts_with_all = ["shard", "for_engine", "events"])]
    pub plan: bool,
    /// Number of runs at a time; without it one for each core
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print what happens as lines of JSON, for another program
    #[arg(long)]
    pub events: bool,
    /// Print failures only
    #[arg(long, short, conflicts_with = "events")]
    pub quiet: bool,
    #[command(flatten)]
    pub values: ValueArgs,
}

/// Runs the command.
#[must_use]
pub fn sweep(args: &SweepArgs) -> Exit {
    let plan = match scenarios::load(&args.scenario, &args.values) {
        Ok(plan) => plan,
        Err(exit) => return exit,
    };
    play(args, &plan).unwrap_or_else(|error| {
        print_error(&format!("canrig: {error}"));
        error.exit()
    })
}

fn play(args: &SweepArgs, plan: &Plan) -> Result<Exit, SweepError> {
    let cases = SweepCases::new(plan)?;
    started_by(plan).iter().for_each(|line| print_error(line));
    if args.plan {
        let cores = args.threads.unwrap_or(1);
        let estimate = Estimate::probe(&cases, cores)?;
        let (file, options) = (args.scenario.display(), estimate.options());
        print(&format!(
            "{estimate}\ncanrig submit {file} --engine slurm {options}"
        ));
        return Ok(Exit::Pass);
    }
    let shard = args.part.shard().map_err(PartError::from)?;
    let shown = match (args.events, args.quiet) {
        (true, _) => Shown::Nothing,
        (false, true) => Shown::Failures,
        (false, false) => Shown::All,
    };
    let mut campaign = Campaign::on_all_cores(shown == Shown::All);
    campaign.threads = args.threads.map_or(campaign.threads, usize::from);
    let lines = args.events.then(EventLines::default);
    let part = PartPlay {
        output: &args.output,
        shard,
        is_shared: args.part.is_for_engine() || shard != Shard::WHOLE,
        campaign,
        shown,
        lines: lines.as_ref(),
        overrides: &args.values.all(),
    };
    let (folder, rows, _writer) = part.play(&cases, plan)?;
    let exit = if args.part.is_for_engine() {
        Exit::Pass
    } else {
        finish(&folder, plan, &cases, &rows, shown)?
    };
    part.report(
        "ended",
        &cases,
        shard.cases(Cases::runs(&cases)).len(),
        &folder,
    );
    Ok(exit)
}
