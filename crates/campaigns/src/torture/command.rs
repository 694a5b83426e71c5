//! The command `canrig torture`.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;

use super::cases::{Draws, TortureCases};
use super::shrink::TortureCase;
use crate::campaign::{Campaign, caught};
use crate::sweep::Shard;
use crate::sweep::cases::Cases;
use crate::sweep::estimate::Estimate;
use crate::sweep::finish::{FinishError, Shown, finish};
use crate::sweep::part::{PartArgs, PartError, PartPlay};
use crate::sweep::row::SweepRow;
use crate::sweep::store::{Rows, StoreError};
use plan::Plan;
use recording::capture::Watch;
use runner::console::{print, print_error};
use runner::exit::Exit;
use runner::play::ValueArgs;
use runner::run::RUNS;
use runner::run::{RunPlace, run};
use runner::scenarios;
use worlds::law_process::started_by;
use worlds::programs::Hosting;
use worlds::{Played, lockstep};

/// Largest number of failing cases that are shrunk; more of them usually have the same cause.
const SHRUNK_MAX: usize = 5;

/// Reason why torture did not complete.
#[derive(Debug, thiserror::Error)]
enum TortureError {
    #[error(transparent)]
    Part(#[from] PartError),
    #[error(transparent)]
    Finish(#[from] FinishError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("a broken invariant cannot be shown by a smaller scenario: {0}")]
    Shrink(String),
}

impl TortureError {
    fn exit(&self) -> Exit {
        match self {
            Self::Part(error) => error.exit(),
            _ => Exit::BenchFailed,
        }
    }
}

fn runs(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("it must be at least 1".to_owned()),
        Ok(runs) => Ok(runs),
        Err(error) => Err(format!("{error}")),
    }
}

/// Arguments of `torture`.
#[derive(Args, Debug)]
pub struct TortureArgs {
    /// The scenario that is played with faults; its own faults and limits are left out
    pub scenario: PathBuf,
    /// Number of random combinations of faults
    #[arg(long, value_name = "COUNT", default_value_t = 1000, value_parser = runs)]
    pub runs: usize,
    /// Seed of the random combinations
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    pub seed: u64,
    /// Folder in which the folders of the torture and of shrunk cases are made; an interrupted torture that is there is
    /// continued
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    #[command(flatten)]
    pub part: PartArgs,
    /// Play some runs to estimate parts, time, memory and disk of all runs on an engine. No result is kept
    #[arg(long, conflicts_with_all = ["shard", "for_engine"])]
    pub plan: bool,
    /// Number of runs at a time; without it one for each core
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print failures only, and the summary
    #[arg(long, short)]
    pub quiet: bool,
}

/// Draws and plays the mixes, and prints the invariants that broke.
#[must_use]
pub fn torture(args: &TortureArgs) -> Exit {
    let plan = match scenarios::load(&args.scenario, &ValueArgs::default()) {
        Ok(plan) => plan,
        Err(exit) => return exit,
    };
    let draws = Draws {
        runs: args.runs,
        seed: args.seed,
    };
    let cases = TortureCases::new(&plan, draws);
    // The first case shows whether torture can play the scenario at all.
    if let Err(reason) = cases.case(1).and_then(|case| case.plan()) {
        print_error(&format!("canrig: {}: {reason}", args.scenario.display()));
        return Exit::CannotStart;
    }
    started_by(&plan).iter().for_each(|line| print_error(line));
    if args.plan {
        return print_estimate(args, &cases);
    }
    play(args, &cases, &plan).unwrap_or_else(|error| {
        print_error(&format!("canrig: {error}"));
        error.exit()
    })
}

/// Prints the estimate for all runs.
fn print_estimate(args: &TortureArgs, cases: &TortureCases) -> Exit {
    match Estimate::probe(cases, args.threads.unwrap_or(1)) {
        Ok(estimate) => {
            let (file, options) = (args.scenario.display(), estimate.options());
            let draws = format!("--torture {} --seed {}", args.runs, args.seed);
            print(&format!(
                "{estimate}\ncanrig submit {file} {draws} --engine slurm {options}"
            ));
            Exit::Pass
        }
        Err(error) => {
            print_error(&format!("canrig: {error}"));
            error.exit()
        }
    }
}

/// Plays the mixes that have no row yet, and makes tables and page. Of all mixes together, it shrinks the first that broke each
/// invariant; `canrig merge` does so for parts.
fn play(args: &TortureArgs, cases: &TortureCases, plan: &Plan) -> Result<Exit, TortureError> {
    let shard = args.part.shard().map_err(PartError::from)?;
    let is_whole = shard == Shard::WHOLE && !args.part.is_for_engine();
    let shown = if args.quiet {
        Shown::Failures
    } else {
        Shown::All
    };
    let mut campaign = Campaign::on_all_cores(!args.quiet);
    campaign.threads = args.threads.map_or(campaign.threads, usize::from);
    let part = PartPlay {
        output: &args.output,
        shard,
        is_shared: !is_whole,
        campaign,
        shown,
        lines: None,
        overrides: &[],
    };
    let (folder, rows, _writer) = part.play(cases, plan)?;
    let exit = if args.part.is_for_engine() {
        Exit::Pass
    } else {
        finish(&folder, plan, cases, &rows, shown)?
    };
    let broken = broken_in(&rows)?;
    if is_whole {
        let shrunk = shrink_all(&args.output, &broken, |number| cases.case(number));
        shrunk.map_err(TortureError::Shrink)?;
    }
    if is_whole || !args.quiet {
        let played = shard.cases(cases.runs()).len();
        print(&summary(args.seed, played, &broken));
    }
    Ok(exit)
}

/// Broken invariants by name. No more is kept of the runs in memory, of which there may be millions.
#[derive(Default)]
struct Broken(BTreeMap<String, FirstBroken>);

/// Number of times that an invariant was broken, and the first case that broke it.
struct FirstBroken {
    count: usize,
    case: usize,
    text: String,
}

impl Broken {
    /// Adds the broken invariant of a row, if there is one.
    fn add(&mut self, row: SweepRow) {
        let Some(invariant) = row.missed.into_iter().next() else {
            return;
        };
        let first = self.0.entry(invariant).or_insert_with(|| FirstBroken {
            count: 0,
            case: row.case,
            text: row.reason.unwrap_or_default(),
        });
        first.count += 1;
    }
}

/// Returns the invariants that the rows broke.
fn broken_in(rows: &Rows) -> Result<Broken, StoreError> {
    let mut broken = Broken::default();
    for row in rows.iter()? {
        broken.add(row?);
    }
    Ok(broken)
}

/// Shrinks the first case of each invariant that the rows of torture broke.
pub(crate) fn shrink_first(rows: &Rows, cases: &TortureCases, output: &Path) -> Result<(), String> {
    let broken = broken_in(rows).map_err(|error| error.to_string())?;
    shrink_all(output, &broken, |number| cases.case(number))
}

/// Shrinks the first failing case of each invariant.
fn shrink_all(
    output: &Path,
    broken: &Broken,
    case: impl Fn(usize) -> Result<TortureCase, String>,
) -> Result<(), String> {
    for (invariant, first) in broken.0.iter().take(SHRUNK_MAX) {
        let FirstBroken {
            case: number, text, ..
        } = first;
        print(&format!("run {number}: {invariant}: {text}"));
        let shrunk = case(*number)?.shrunk(invariant);
        let folder = keep(&shrunk, output)?;
        print(&format!("{}kept in {}\n", shrunk.text(), folder.display()));
    }
    Ok(())
}

/// Plays the case once more into a run folder with a scenario that reproduces the log. Of a case that panics, only the scenario
/// remains.
fn keep(case: &TortureCase, output: &Path) -> Result<PathBuf, String> {
    let plan = case.plan()?;
    let (watch, taps) = (Watch::default(), Vec::new());
    let place = RunPlace {
        parent: output,
        is_long: false,
        overrides: &[],
        is_strict: false,
    };
    let folder = RefCell::new(output.to_owned());
    let judged = caught(|| {
        let judged = run(&plan, place, &watch, taps, |created, capture| {
            created.path().clone_into(&mut folder.borrow_mut());
            let hosting = Hosting {
                logs: Some(created.path()),
                ..Hosting::default()
            };
            lockstep::simulate(&plan, &hosting, capture).map(Played::in_virtual_time)
        });
        Ok(judged.map(|_| ()))
    });
    match judged {
        Ok(Err(error)) => Err(error.to_string()),
        Ok(Ok(())) | Err(_) => Ok(folder.into_inner()),
    }
}

fn summary(seed: u64, played: usize, broken: &Broken) -> String {
    let mut text = format!("{played} runs with seed {seed}: ");
    if broken.0.is_empty() {
        return text + "all invariants held";
    }
    let times: usize = broken.0.values().map(|first| first.count).sum();
    let counts = broken
        .0
        .iter()
        .map(|(invariant, first)| format!("{invariant} {}", first.count));
    text += &format!(
        "broken {times} times ({})",
        counts.collect::<Vec<_>>().join(", ")
    );
    text
}
