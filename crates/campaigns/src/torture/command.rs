//! The command `canrig torture`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;

use super::cases::{Draws, TortureCases};
use super::shrink::TortureCase;
use crate::campaign::caught;
use crate::sweep::estimate::Estimate;
use crate::sweep::finish::Shown;
use crate::sweep::part::{PartArgs, PartPlay};
use crate::sweep::store::Rows;
use recording::capture::Watch;
use runner::console::{print, print_error};
use runner::exit::{Exit, Failure};
use runner::play::ValueArgs;
use runner::run::{self, RUNS, RunPlace};
use runner::scenarios::load_to_play;
use worlds::law_process::started_by;
use worlds::programs::Hosting;
use worlds::{Played, lockstep};

/// Largest number of failing cases that are shrunk; more of them usually have the same cause.
const SHRUNK_MAX: usize = 5;

/// Arguments of `torture`.
#[derive(Args, Debug)]
pub struct TortureArgs {
    /// The scenario that is played with faults; its own faults and limits are left out
    pub scenario: PathBuf,
    #[command(flatten)]
    pub draws: Draws,
    /// Folder in which the folders of the torture and of shrunk cases are made; an interrupted torture that is there is
    /// continued
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    #[command(flatten)]
    pub part: PartArgs,
    /// Print failures only, and the summary
    #[arg(long, short)]
    pub quiet: bool,
}

/// Draws and plays the mixes that have no row yet, makes tables and page, and prints the invariants that broke. Of all mixes
/// together, it shrinks the first that broke each invariant; `canrig merge` does so for parts.
pub fn torture(args: &TortureArgs) -> Result<Exit, Failure> {
    let plan = load_to_play(&args.scenario, &ValueArgs::default())?;
    let cases = TortureCases::new(&plan, args.draws);
    // The first case shows whether torture can play the scenario at all.
    if let Err(reason) = cases.case(1).plan() {
        let path = args.scenario.display();
        return Err(Exit::CannotStart.because(format!("{path}: {reason}")));
    }
    started_by(&plan).iter().for_each(|line| print_error(line));
    if args.part.plan {
        let (file, Draws { runs, seed }) = (args.scenario.display(), args.draws);
        let submit = format!("{file} --torture {runs} --seed {seed}");
        return Estimate::print(&cases, args.part.threads, &submit);
    }
    let part = PartPlay {
        args: &args.part,
        shard: args.part.shard()?,
        output: &args.output,
        shown: Shown::unless(args.quiet),
        overrides: &[],
    };
    let (exit, rows) = part.play(&cases)?;
    if part.is_whole() || !args.quiet {
        let broken = broken_in(&rows)?;
        print(&summary(args.draws.seed, rows.len(), &broken));
    }
    Ok(exit)
}

/// Broken invariants by name. No more is kept of the runs in memory, of which there may be millions.
#[derive(Default)]
pub(super) struct Broken(BTreeMap<String, FirstBroken>);

/// Number of times that an invariant was broken, and the first case that broke it.
struct FirstBroken {
    count: usize,
    case: usize,
    text: String,
}

/// Returns the invariants that the rows broke.
pub(super) fn broken_in(rows: &Rows) -> Result<Broken, Failure> {
    let mut broken = Broken::default();
    for row in rows.iter()? {
        let row = row?;
        let Some(invariant) = row.missed.into_iter().next() else {
            continue;
        };
        let first = broken.0.entry(invariant).or_insert_with(|| FirstBroken {
            count: 0,
            case: row.case,
            text: row.reason.unwrap_or_default(),
        });
        first.count += 1;
    }
    Ok(broken)
}

/// Shrinks the first failing case of each invariant.
pub(super) fn shrink_all(
    output: &Path,
    broken: &Broken,
    cases: &TortureCases,
) -> Result<(), Failure> {
    for (invariant, first) in broken.0.iter().take(SHRUNK_MAX) {
        print(&format!("run {}: {invariant}: {}", first.case, first.text));
        let case = cases.case(first.case);
        let shrunk = case.shrunk(invariant).map_err(|interrupted| {
            let text = "before a broken run was made small; the runs are kept: give the same command again";
            Exit::Interrupted.because(format!("{interrupted} {text}"))
        })?;
        let folder = keep(&shrunk, output).map_err(|reason| {
            let text = "a broken invariant cannot be shown by a smaller scenario";
            Exit::BenchFailed.because(format!("{text}: {reason}"))
        })?;
        print(&format!("{}kept in {}\n", shrunk.text(), folder.display()));
    }
    Ok(())
}

/// Plays the case once more into a run folder with a scenario that reproduces the log. Of a case that panics, only the scenario
/// remains.
fn keep(case: &TortureCase<'_>, output: &Path) -> Result<PathBuf, String> {
    let plan = case.plan()?;
    let (watch, taps) = (Watch::default(), Vec::new());
    let place = RunPlace {
        parent: output,
        is_long: false,
        overrides: &[],
        is_strict: false,
        tries: None,
    };
    let mut folder = output.to_owned();
    let judged = caught(|| {
        let judged = run::run(&plan, place, &watch, taps, |created, capture| {
            created.path().clone_into(&mut folder);
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
        Ok(Ok(())) | Err(_) => Ok(folder),
    }
}

fn summary(seed: u64, played: usize, broken: &Broken) -> String {
    let mut text = format!("{played} runs with seed {seed}: ");
    if broken.0.is_empty() {
        return text + "all invariants held";
    }
    let times: usize = broken.0.values().map(|first| first.count).sum();
    let invariants = broken.0.iter();
    let counts = invariants.map(|(invariant, first)| format!("{invariant} {}", first.count));
    text += &format!(
        "broken {times} times ({})",
        counts.collect::<Vec<_>>().join(", ")
    );
    text
}
