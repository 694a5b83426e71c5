//! `canrig reproduce`: plays all experiments, prints their numbers, writes the page.

use clap::Args;
use std::path::PathBuf;

use serde::Serialize;

use super::experiment::{Experiment, ExperimentResult, Kept};
use super::quantity::Quantity;
use super::{cooling, material, page, response, ripple, robustness, sensitivity};
use campaigns::campaign::{Campaign, Interrupted, one_loop_plan, watched};
use recording::capture::Watch;
use recording::run_folder::{RunFolder, WriteError, file};
use runner::console::{Bar, print, print_text};
use runner::exit::{Exit, Failure};
use runner::run::RUNS;

/// Name of the file with all numbers.
const NUMBERS: &str = "reproduction.json";
/// Seed that names the folder; each experiment has its own seeds.
const SEED: u64 = 0;

/// Returns every experiment, in the order of the page; `is_reduced` ones have fewer plants, frequencies and settings, as a check
/// that all of it works.
pub fn experiments(is_reduced: bool) -> Vec<Experiment> {
    let mut experiments = material::experiments(is_reduced);
    experiments.extend(cooling::experiments());
    experiments.extend(response::experiments(is_reduced));
    experiments.push(ripple::experiment());
    experiments.extend(robustness::experiments(is_reduced));
    experiments.extend(sensitivity::experiments(is_reduced));
    experiments
}

/// Arguments of `reproduce`.
#[derive(Args, Debug)]
pub struct ReproduceArgs {
    /// Folder in which the page's folder is made
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Play fewer plants, frequencies and settings, to see that everything works
    #[arg(long)]
    pub reduced: bool,
    /// Print the numbers as JSON instead of a table
    #[arg(long)]
    pub json: bool,
    /// Print failures only
    #[arg(long, short, conflicts_with = "json")]
    pub quiet: bool,
}

/// Executes the command.
pub fn reproduce(args: &ReproduceArgs) -> Result<Exit, Failure> {
    let is_shown = !args.json && !args.quiet;
    let experiments = experiments(args.reduced);
    let Ok(runs) = played(&experiments, is_shown) else {
        return Ok(Exit::Interrupted);
    };
    let kept = runs.into_iter().collect::<Result<_, Failure>>()?;
    match evaluated(experiments, kept, is_shown) {
        Ok(results) => Ok(report(args, &results)?),
        Err(Interrupted) => Ok(Exit::Interrupted),
    }
}

/// Plays the runs of all experiments at once.
fn played(
    experiments: &[Experiment],
    is_shown: bool,
) -> Result<Vec<Result<Kept, Failure>>, Interrupted> {
    let runs = Vec::from_iter(experiments.iter().flat_map(|experiment| &experiment.runs));
    let plans = runs.iter().map(|run| one_loop_plan(run.scenario.clone()));
    Campaign::on_all_cores(is_shown).play(plans, |played| runs[played.index].keep(played))
}

/// Gives the runs to their experiments, and evaluates these; the identification takes some seconds.
fn evaluated(
    experiments: Vec<Experiment>,
    kept: Vec<Kept>,
    is_shown: bool,
) -> Result<Vec<ExperimentResult>, Interrupted> {
    let mut kept = kept.into_iter();
    let activity = Bar::spinner(is_shown);
    let evaluate = |experiment: Experiment| {
        activity.say(experiment.title);
        let runs: Vec<Kept> = kept.by_ref().take(experiment.runs.len()).collect();
        ExperimentResult {
            evaluation: (experiment.evaluate)(&runs),
            experiment,
        }
    };
    let evaluate_all = |watch: &Watch| {
        let wanted = experiments.into_iter();
        let wanted = wanted.take_while(|_| !watch.is_interrupted());
        wanted.map(evaluate).collect()
    };
    watched(evaluate_all)
}

/// Results for other programs.
#[derive(Serialize)]
struct ReproductionNumbers<'a> {
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
    numbers: &'a [Quantity],
}

fn json(is_reduced: bool, results: &[ExperimentResult]) -> String {
    let experiments = results.iter().map(|result| ExperimentNumbers {
        id: result.experiment.id,
        title: result.experiment.title,
        runs: result.experiment.runs.len(),
        passed: result.holds(),
        numbers: &result.evaluation.numbers,
    });
    let numbers = ReproductionNumbers {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        is_reduced,
        passed: results.iter().all(ExperimentResult::holds),
        experiments: experiments.collect(),
    };
    serde_json::to_string_pretty(&numbers).expect("plain data") + "\n"
}

/// Writes the folder and prints the numbers. Returns the exit code, which says whether every target is met.
fn report(args: &ReproduceArgs, results: &[ExperimentResult]) -> Result<Exit, WriteError> {
    let extent = if args.reduced { " reduced" } else { "" };
    let name = format!("reproduction{extent}");
    let numbers = json(args.reduced, results);
    let folder = RunFolder::create(&args.output, &name, SEED, &numbers)?;
    folder.write(NUMBERS, numbers.as_bytes())?;
    let page = page::to_html(args.reduced, results);
    folder.write(file::REPORT, page.as_bytes())?;
    let holds = results.iter().all(ExperimentResult::holds);
    if args.json {
        print(numbers.trim_end());
    } else if !args.quiet || !holds {
        print_text(&page::to_text(results));
        print(&format!(
            "page  {}",
            folder.path().join(file::REPORT).display()
        ));
    }
    Ok(if holds {
        Exit::Pass
    } else {
        Exit::VerdictFailed
    })
}
