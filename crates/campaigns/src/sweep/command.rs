//! `canrig sweep`: plays the remaining cases, then writes tables and a summary of all.

use std::path::PathBuf;

use clap::Args;

use super::estimate::Estimate;
use super::finish::Shown;
use super::part::{PartArgs, PartPlay};
use super::sweep_cases::SweepCases;
use runner::console::print_error;
use runner::exit::{Exit, Failure};
use runner::play::ValueArgs;
use runner::run::RUNS;
use runner::scenarios::load_to_play;
use worlds::law_process::started_by;

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
    /// Print what happens as lines of JSON, for another program
    #[arg(long, conflicts_with = "plan")]
    pub events: bool,
    /// Print failures only
    #[arg(long, short, conflicts_with = "events")]
    pub quiet: bool,
    #[command(flatten)]
    pub values: ValueArgs,
}

/// Runs the command.
pub fn sweep(args: &SweepArgs) -> Result<Exit, Failure> {
    let plan = load_to_play(&args.scenario, &args.values)?;
    let cases = SweepCases::new(&plan)?;
    started_by(&plan).iter().for_each(|line| print_error(line));
    if args.part.plan {
        let submit = args.scenario.display().to_string();
        return Estimate::print(&cases, args.part.threads, &submit);
    }
    let part = PartPlay {
        args: &args.part,
        shard: args.part.shard()?,
        output: &args.output,
        shown: if args.events {
            Shown::Events
        } else {
            Shown::unless(args.quiet)
        },
        overrides: &args.values.all(),
    };
    part.play(&cases).map(|(exit, _)| exit)
}
