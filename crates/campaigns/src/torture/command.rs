//! The command.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use faults::Stream;
use scenario::ScenarioError;
use scenario::loops::Loops;
use scenario::rig::nodes::Rig;

use super::draw::{self, Nodes};
use super::invariants::{BrokenInvariant, violation};
use super::shrink::{TortureCase, from_failed_run};
use crate::campaign::Campaign;
use recording::capture::Watch;
use rig::setup::Setup;
use runner::console::{print, print_diagnostic, print_error};
use runner::exit::Exit;
use runner::run::RUNS;
use runner::run::{RunPlace, run_loops};
use runner::scenarios;
use worlds::{Played, lockstep};

/// Failing cases that are shrunk; more of them have the same cause more often than not.
const SHRUNK_MAX: usize = 5;

fn runs(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("nothing would be played; it must be at least 1".to_owned()),
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
    /// Folder in which the folders of failing cases are made
    #[arg(long, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
}

/// Draws and plays the mixes, and prints what broke.
#[must_use]
pub fn torture(args: &TortureArgs) -> Exit {
    let setups = match scenarios::load(&args.scenario, &[]) {
        Ok(setups) => setups,
        Err(exit) => return exit,
    };
    let nodes = match nodes(&setups) {
        Ok(nodes) => nodes,
        Err(error) => {
            print_diagnostic(error);
            return Exit::CannotStart;
        }
    };
    let case = |index: usize| draw_case(args, &setups[0], &nodes, index);
    // The first one shows whether the scenario is fit for this at all.
    if let Err(reason) = case(0).and_then(|case| case.loops()) {
        print_error(&format!("canrig: {}: {reason}", args.scenario.display()));
        return Exit::CannotStart;
    }
    let scenarios = (0..args.runs).map_while(|index| case(index).ok()?.loops().ok());
    // Several threads ask it: behind the end there is nothing.
    let scenarios = scenarios.fuse();
    let results = Campaign::on_all_cores(!args.quiet).play_loops(scenarios, violation);
    let Ok(results) = results else {
        return Exit::Interrupted;
    };
    let played = results.len();
    let broken: Vec<(usize, BrokenInvariant)> = results
        .into_iter()
        .enumerate()
        .filter_map(|(index, result)| {
            let violation = result.unwrap_or_else(|fault| Some(from_failed_run(&fault)));
            Some((index, violation?))
        })
        .collect();
    let shown = shrink_all(args, &broken, case);
    print(&summary(args, played, &broken));
    if played < args.runs {
        print_error(&format!(
            "canrig: run {played} could not be drawn as a valid scenario"
        ));
        return Exit::Internal;
    }
    match shown {
        Err(reason) => {
            print_error(&format!("canrig: {reason}"));
            Exit::BenchFailed
        }
        Ok(()) if broken.is_empty() => Exit::Pass,
        Ok(()) => Exit::VerdictFailed,
    }
}

/// Who can fail.
fn nodes(setups: &[Setup]) -> Result<Nodes, ScenarioError> {
    let setup = &setups[0];
    if !Loops::is_meant(&setup.text) {
        return Ok(Nodes::of_one_drive(&setup.scenario.plant));
    }
    let rig = Rig::of_scenario(&setup.text, &setup.tables)?;
    Ok(Nodes::of_rig(&rig, setups))
}

/// The scenario with a mix that follows from the seed and the number of the run alone.
fn draw_case(
    args: &TortureArgs,
    setup: &Setup,
    nodes: &Nodes,
    index: usize,
) -> Result<TortureCase, String> {
    let mut stream = Stream::named(args.seed, &format!("torture.{index}"));
    let faults = draw::mix(&mut stream, nodes, setup.scenario.duration_seconds);
    TortureCase::new(&setup.text, &setup.tables, faults, stream.bits())
}

/// Shrinks the first failing case of each invariant, then further ones.
fn shrink_all(
    args: &TortureArgs,
    broken: &[(usize, BrokenInvariant)],
    case: impl Fn(usize) -> Result<TortureCase, String>,
) -> Result<(), String> {
    let mut first_of: BTreeMap<&str, usize> = BTreeMap::new();
    for (place, (_, violation)) in broken.iter().enumerate() {
        first_of.entry(violation.invariant).or_insert(place);
    }
    for place in first_of.into_values().take(SHRUNK_MAX) {
        let (index, violation) = &broken[place];
        print(&format!(
            "run {index}: {}: {}",
            violation.invariant, violation.text
        ));
        let shrunk = case(*index)?.shrunk(violation.invariant);
        let folder = keep(&shrunk, &args.output)?;
        print(&format!("{}kept in {}\n", shrunk.text(), folder.display()));
    }
    Ok(())
}

/// Plays the case once more into a run folder, whose scenario reproduces its log.
fn keep(case: &TortureCase, output: &Path) -> Result<std::path::PathBuf, String> {
    let setups = case.loops()?;
    let (watch, taps) = (Watch::default(), Vec::new());
    let place = RunPlace {
        parent: output,
        is_long: false,
    };
    let judged = run_loops(&setups, place, &watch, taps, |_, capture| {
        lockstep::simulate_loops(&setups, capture).map(Played::in_virtual_time)
    });
    judged
        .map(|judged| judged.folder)
        .map_err(|error| error.to_string())
}

fn summary(args: &TortureArgs, played: usize, broken: &[(usize, BrokenInvariant)]) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for (_, violation) in broken {
        *counts.entry(violation.invariant).or_default() += 1;
    }
    let mut text = format!("{played} runs with seed {}: ", args.seed);
    if counts.is_empty() {
        return text + "all invariants held";
    }
    let counts = counts
        .iter()
        .map(|(invariant, count)| format!("{invariant} {count}"));
    text += &format!(
        "broken {} times ({})",
        broken.len(),
        counts.collect::<Vec<_>>().join(", ")
    );
    text
}

#[cfg(test)]
mod tests {
    use scenario::Scenario;
    use worlds::catalogue::catalogue;

    use super::*;

    #[test]
    fn seed_and_number_decide_what_is_drawn() {
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 2.0\n[controller.pid]\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let setup = Setup::new(scenario, catalogue()).from_file("t.toml", text.to_owned());
        let drawn = |seed, index| {
            let args = TortureArgs {
                scenario: "t.toml".into(),
                runs: 2,
                seed,
                output: RUNS.into(),
                quiet: true,
            };
            let nodes = nodes(std::slice::from_ref(&setup)).unwrap();
            let case = draw_case(&args, &setup, &nodes, index).unwrap();
            let case = &case.loops().unwrap()[0].scenario;
            (case.seed, format!("{:?}", case.fault))
        };
        let first = drawn(1, 0);
        assert_eq!(first, drawn(1, 0));
        for other in [drawn(2, 0), drawn(1, 1)] {
            assert!(first.0 != other.0 && first.1 != other.1, "{other:?}");
        }
    }
}
