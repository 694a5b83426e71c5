//! `canrig sweep`: plays the cases that are not done yet, then makes tables and a summary of all.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::Shard;
use super::finish::{FinishError, Shown, finish};
use super::plan::{PlanError, SweepPlan};
use super::row::{Ended, SweepRow};
use super::store::{Header, Recovered, Store, StoreError};
use crate::campaign::{self, Campaign, Stopped};
use recording::capture::Watch;
use recording::run_folder::{RunFolder, WriteError};
use recording::session::write_scenario;
use rig::setup::Setup;
use runner::console::{RunsBar, print, print_error};
use runner::exit::Exit;
use runner::identity::{NoIdentity, identity};
use runner::lines::EventLines;
use runner::play::ValueArgs;
use runner::run::RUNS;
use runner::scenarios;

/// Why a sweep did not come to its end.
#[derive(Debug, thiserror::Error)]
enum SweepError {
    #[error(transparent)]
    SweepPlan(#[from] PlanError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Write(#[from] WriteError),
    #[error(transparent)]
    Finish(#[from] FinishError),
    #[error(transparent)]
    NoIdentity(#[from] NoIdentity),
    #[error("interrupted: {done} of {of} runs are done; give the same command again to continue")]
    Interrupted { done: usize, of: usize },
}

impl SweepError {
    fn exit(&self) -> Exit {
        match self {
            Self::SweepPlan(_) => Exit::CannotStart,
            Self::Interrupted { .. } => Exit::Interrupted,
            Self::Store(_) | Self::Write(_) | Self::Finish(_) | Self::NoIdentity(_) => {
                Exit::BenchFailed
            }
        }
    }
}

/// Arguments of `sweep`.
#[derive(Args, Debug)]
pub struct SweepArgs {
    /// A scenario file with a [sweep] table
    pub scenario: PathBuf,
    /// Folder in which the sweep's folder is made; an interrupted sweep that is there is continued
    #[arg(long, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Play one part of the sweep, such as 2/4, the second of four, for several machines; `canrig merge` merges the parts
    #[arg(long, value_name = "PART", default_value_t = Shard::WHOLE)]
    pub shard: Shard,
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

/// Does what the command line says.
#[must_use]
pub fn sweep(args: &SweepArgs) -> Exit {
    let setups = match scenarios::load(&args.scenario, &args.values.overrides) {
        Ok(setups) => setups,
        Err(exit) => return exit,
    };
    play(args, &setups).unwrap_or_else(|error| {
        print_error(&format!("canrig: {error}"));
        error.exit()
    })
}

fn play(args: &SweepArgs, setups: &[Setup]) -> Result<Exit, SweepError> {
    let plan = SweepPlan::new(setups)?;
    let setup = &setups[0];
    let folder = open_folder(&args.output, setup, &plan, args.shard)?;
    let header = Header::new(&plan, &identity(setup)?, args.shard);
    let (mut store, found) = Store::open(folder.path(), &header)?;
    let shown = match (args.events, args.quiet) {
        (true, _) => Shown::Nothing,
        (false, true) => Shown::Failures,
        (false, false) => Shown::All,
    };
    let mut campaign = Campaign::on_all_cores(shown == Shown::All);
    campaign.threads = args.threads.map_or(campaign.threads, usize::from);
    if shown == Shown::All {
        announce(&plan, args.shard, &campaign, &store);
    }
    print_found(&found, shown != Shown::All);
    let lines = args.events.then(EventLines::default);
    let report = |event: &str, done: usize| {
        if let Some(lines) = &lines {
            let (of, folder) = (args.shard.cases(plan.runs()).len(), folder.path());
            let folder = folder.to_string_lossy();
            lines.print(&json!({"event": event, "done": done, "of": of, "folder": folder}));
        }
    };
    report("began", store.len());
    let on_done = |done: usize| report("reached", done);
    play_rest(&plan, args.shard, &campaign, &mut store, &on_done)?;
    store.finish()?;
    let exit = finish(&folder, setups, &plan, shown)?;
    report("ended", args.shard.cases(plan.runs()).len());
    Ok(exit)
}

/// The folder of a sweep, or of a part of it: the same one each time.
pub(super) fn open_folder(
    parent: &Path,
    setup: &Setup,
    plan: &SweepPlan,
    shard: Shard,
) -> Result<RunFolder, WriteError> {
    let part = match shard {
        Shard::WHOLE => String::new(),
        Shard { number, of } => format!("-{number}-of-{of}"),
    };
    let id = format!("sweep-{}{part}", plan.id());
    let folder = RunFolder::lasting(parent, &setup.scenario.name, &id)?;
    if !folder.scenario().exists() {
        write_scenario(&folder, setup)?;
    }
    Ok(folder)
}

fn announce(plan: &SweepPlan, shard: Shard, campaign: &Campaign, store: &Store) {
    let (runs, threads) = (plan.runs(), campaign.threads);
    let mut text = match shard {
        Shard::WHOLE => format!("{runs} runs"),
        part => format!("{} of {runs} runs (part {part})", part.cases(runs).len()),
    };
    text += &format!(", {threads} at a time");
    if store.len() > 0 {
        text += &format!("; {} are done", store.len());
    }
    print(&text);
}

/// Prints what was wrong with the rows that were there: a cut at the end is what a kill leaves, the rest is a failure.
pub(super) fn print_found(found: &Recovered, is_quiet: bool) {
    if found.is_torn && !is_quiet {
        print("the last row was torn; its run is played again");
    }
    if let Some(words) = &found.set_aside {
        print_error(&format!("canrig: {words}"));
    }
}

/// Plays the cases that are not done, and keeps their rows.
fn play_rest(
    plan: &SweepPlan,
    shard: Shard,
    campaign: &Campaign,
    store: &mut Store,
    on_done: &(dyn Fn(usize) + Sync),
) -> Result<(), SweepError> {
    let cases = shard.cases(plan.runs());
    let of = cases.len();
    let left: Vec<usize> = cases.filter(|case| !store.has(*case)).collect();
    let count = RunsBar::new(Some(of), campaign.is_shown).going_on_from(store.len());
    let keep = |case: usize, row: Result<SweepRow, String>| {
        // The program's own hook prints a panic; the row says in which case it was.
        let row = row.unwrap_or_else(|reason| {
            SweepRow::without_verdict(case, &plan.case(case).id, Ended::InternalError, reason)
        });
        store.append(&row)?;
        on_done(store.len());
        Ok(())
    };
    let work = |case: &usize, watch: &Watch| played(plan, *case, watch);
    let ended = campaign.each(left.into_iter(), &count, work, keep);
    drop(count);
    match ended {
        Ok(()) => Ok(()),
        Err(Stopped::Refused(error)) => Err(SweepError::Store(error)),
        Err(Stopped::Interrupted) => Err(SweepError::Interrupted {
            done: store.len(),
            of,
        }),
    }
}

/// What a case comes to.
fn played(plan: &SweepPlan, number: usize, watch: &Watch) -> Result<SweepRow, String> {
    let case = plan.case(number);
    let loops = match case.loops() {
        Ok(loops) => loops,
        Err(reason) => {
            return Ok(SweepRow::without_verdict(
                number,
                &case.id,
                Ended::Invalid,
                reason,
            ));
        }
    };
    let row = campaign::play_one(number, &loops, watch, |played| {
        SweepRow::from_verdict(number, &case.id, played.verdict)
    });
    row.map_err(|error| error.to_string())
}
