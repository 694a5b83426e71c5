//! `canrig reproduce`: plays all experiments, prints their numbers, writes the page.

use clap::Args;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use super::experiment::{Effort, Experiment, Kept};
use super::finding::Finding;
use super::number::Number;
use super::{material, page, response, robustness, sensitivity};
use campaigns::campaign::{Campaign, Fault, Interrupted};
use recording::run_folder::{RunFolder, WriteError, file};
use runner::console::{Activity, complain, say};
use runner::exit::Exit;
use runner::observer::observed;

/// Name of the file with all numbers.
const NUMBERS: &str = "reproduction.json";
/// The experiments have seeds of their own; this one names the folder.
const SEED: u64 = 0;

/// Every experiment, in the order of the page.
#[must_use]
pub fn experiments(effort: Effort) -> Vec<Experiment> {
    let rooms = [
        material::experiments,
        response::experiments,
        robustness::experiments,
        sensitivity::experiments,
    ];
    rooms.into_iter().flat_map(|room| room(effort)).collect()
}

/// Arguments of `reproduce`.
#[derive(Args, Debug)]
pub struct ReproduceArgs {
    /// Where the folder with the page is made
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Fewer plants, frequencies and settings: to see that everything works
    #[arg(long)]
    pub reduced: bool,
    /// Print the numbers as JSON instead of a table
    #[arg(long)]
    pub json: bool,
    /// Print nothing but failures
    #[arg(long, short, conflicts_with = "json")]
    pub quiet: bool,
}

/// Does what the command line says.
#[must_use]
pub fn reproduce(args: &ReproduceArgs) -> Exit {
    let effort = if args.reduced {
        Effort::Reduced
    } else {
        Effort::Full
    };
    let experiments = experiments(effort);
    let is_shown = !args.json && !args.quiet;
    let Ok(runs) = play(&experiments, is_shown) else {
        return Exit::Interrupted;
    };
    let kept: Vec<Kept> = match runs.into_iter().collect::<Result<_, Fault>>() {
        Ok(kept) => kept,
        Err(fault) => {
            complain(&format!("canrig: {fault}"));
            return Exit::Internal;
        }
    };
    let Ok(findings) = evaluated(experiments, kept, is_shown) else {
        return Exit::Interrupted;
    };
    if let Err(error) = report(args, effort, &findings) {
        complain(&format!("canrig: {error}"));
        return Exit::BenchFailed;
    }
    if findings.iter().all(Finding::holds) {
        Exit::Pass
    } else {
        Exit::VerdictFailed
    }
}

/// Plays the runs of all experiments at once.
fn play(
    experiments: &[Experiment],
    is_shown: bool,
) -> Result<Vec<Result<Kept, Fault>>, Interrupted> {
    let runs: Vec<_> = experiments
        .iter()
        .flat_map(|experiment| &experiment.runs)
        .collect();
    let scenarios = runs.iter().map(|run| run.scenario.clone());
    Campaign::on_all_cores(is_shown).play(scenarios, |played| runs[played.index].keep(played))
}

/// Gives each experiment its runs back and has it make something of them; the identification takes some seconds.
fn evaluated(
    experiments: Vec<Experiment>,
    kept: Vec<Kept>,
    is_shown: bool,
) -> Result<Vec<Finding>, Interrupted> {
    let (activity, is_interrupted) = (Activity::new(is_shown), AtomicBool::new(false));
    let mut kept = kept.into_iter();
    let evaluate = |experiment: Experiment| {
        if is_interrupted.load(Ordering::Relaxed) {
            return Err(Interrupted);
        }
        activity.show(experiment.title);
        let runs: Vec<Kept> = kept.by_ref().take(experiment.runs.len()).collect();
        Ok(Finding {
            evaluation: (experiment.evaluate)(&runs),
            experiment,
        })
    };
    let mut experiments = experiments.into_iter().map(evaluate);
    observed(
        || is_interrupted.store(true, Ordering::Relaxed),
        || {},
        || experiments.by_ref().collect(),
    )
}

/// What other programs read.
#[derive(Serialize)]
struct Numbers<'a> {
    schema: u32,
    version: &'static str,
    is_reduced: bool,
    passed: bool,
    experiments: Vec<ExperimentNumbers<'a>>,
}

#[derive(Serialize)]
struct ExperimentNumbers<'a> {
    id: &'static str,
    title: &'static str,
    runs: usize,
    passed: bool,
    numbers: &'a [Number],
}

fn json(effort: Effort, findings: &[Finding]) -> String {
    let experiments = findings.iter().map(|finding| ExperimentNumbers {
        id: finding.experiment.id,
        title: finding.experiment.title,
        runs: finding.experiment.runs.len(),
        passed: finding.holds(),
        numbers: &finding.evaluation.numbers,
    });
    let numbers = Numbers {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        is_reduced: effort == Effort::Reduced,
        passed: findings.iter().all(Finding::holds),
        experiments: experiments.collect(),
    };
    serde_json::to_string_pretty(&numbers).expect("plain data") + "\n"
}

/// Writes the folder and prints the numbers.
fn report(args: &ReproduceArgs, effort: Effort, findings: &[Finding]) -> Result<(), WriteError> {
    let name = match effort {
        Effort::Full => "reproduction",
        Effort::Reduced => "reproduction reduced",
    };
    let numbers = json(effort, findings);
    let folder = RunFolder::create(&args.output, name, SEED, &numbers)?;
    folder.write(NUMBERS, numbers.as_bytes())?;
    let page = page::to_html(effort, findings);
    folder.write(file::REPORT, page.as_bytes())?;
    if args.json {
        say(numbers.trim_end());
    } else if !args.quiet || !findings.iter().all(Finding::holds) {
        say(&page::to_text(findings));
        say(&format!(
            "page  {}",
            folder.path().join(file::REPORT).display()
        ));
    }
    Ok(())
}
