//! Cases of torture, each by its number: a mix of faults that follows from the seed, and the invariant that it breaks.

use std::path::Path;

use clap::Args;
use faults::Stream;
use plan::Plan;
use recording::capture::Watch;
use runner::exit::{Exit, Failure};
use runner::play_record::read_json;
use serde::{Deserialize, Serialize};

use super::command::{broken_in, shrink_all};
use super::draw::{self, DrawnFault, Nodes};
use super::invariants::{BrokenInvariant, violation};
use super::shrink::{PANIC, TortureCase};
use crate::campaign::play_one;
use crate::sweep::cases::{Cases, Facts};
use crate::sweep::row::{Ended, SweepRow};
use crate::sweep::store::Rows;
use crate::sweep::sweep_cases::id;

/// Name of the file with the draws; a folder that has it is one of torture.
const FILE: &str = "torture.json";
/// Criterion of the runs, for the page.
const CRITERION: &str = "The limits of the scenario are left out: each run is held against invariants, such as that no current flows once \
    the SYNC is missing for longer than the drive waits for it.";

/// Returns whether a folder is one of torture.
pub(crate) fn is_torture(folder: &Path) -> bool {
    folder.join(FILE).exists()
}

/// Parameters of the draws.
#[derive(Args, Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
pub struct Draws {
    /// Number of random combinations of faults
    #[arg(long, value_name = "COUNT", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) runs: u32,
    /// Seed of the random combinations
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    pub(crate) seed: u64,
}

/// Random mixes of faults in a scenario.
pub(crate) struct TortureCases {
    facts: Facts,
}

impl TortureCases {
    /// Returns the mixes in the scenario of a plan.
    pub(crate) fn new(plan: &Plan, draws: Draws) -> Self {
        let text = format!(
            "{} {} {} {}",
            env!("CARGO_PKG_VERSION"),
            draws.seed,
            draws.runs,
            plan.shared.text
        );
        let counted = |kind| (kind, "the number of such faults in a mix".to_owned());
        let written = serde_json::to_string(&draws).expect("plain data") + "\n";
        let facts = Facts {
            kind: "torture",
            id: id(&text, &plan.shared.tables),
            seed: draws.seed,
            runs: draws.runs as usize,
            variations: draw::kinds(&Nodes(plan)).into_iter().map(counted).collect(),
            limits: Vec::new(),
            criterion: Some(CRITERION),
            files: vec![(FILE, written)],
            plan: plan.clone(),
        };
        Self { facts }
    }

    /// Reads the cases of a part's folder; `None` if it is not one of torture.
    pub(crate) fn read(folder: &Path, plan: &Plan) -> Result<Option<Self>, Failure> {
        let draws = read_json(folder, FILE)?;
        Ok(draws.map(|draws| Self::new(plan, draws)))
    }

    /// Returns the scenario with the mix of a case, numbered from 1.
    pub(super) fn case(&self, number: usize) -> TortureCase<'_> {
        let mut stream = self.stream(number);
        let faults = draw::mix(&mut stream, &Nodes(&self.facts.plan));
        TortureCase::new(&self.facts.plan, faults, stream.bits())
    }

    /// Returns the stream of a case, which follows from the seed and the number alone.
    fn stream(&self, number: usize) -> Stream {
        Stream::named(self.facts.seed, &format!("torture.{}", number - 1))
    }

    fn row(&self, number: usize, seed: Option<u64>, broken: Option<BrokenInvariant>) -> SweepRow {
        let id = id(&self.text(number), &self.facts.plan.shared.tables);
        let ended = match &broken {
            Some(_) => Ended::Fail,
            None => Ended::Pass,
        };
        let missed = broken.iter().map(|broken| broken.invariant.to_owned());
        SweepRow {
            case: number,
            id,
            seed,
            ended,
            missed: missed.collect(),
            undecided: Vec::new(),
            reason: broken.map(|broken| broken.text),
            metrics: Vec::new(),
        }
    }
}

impl Cases for TortureCases {
    fn facts(&self) -> &Facts {
        &self.facts
    }

    fn values(&self, number: usize) -> Vec<f64> {
        let mix = draw::mix(&mut self.stream(number), &Nodes(&self.facts.plan));
        let count = |key: &str| {
            let is_it = |fault: &&DrawnFault| key == format!("{}.{}", fault.group, fault.kind);
            mix.iter().filter(is_it).count() as f64
        };
        self.facts.keys().into_iter().map(count).collect()
    }

    fn values_text(&self, number: usize, _: fn(f64) -> String) -> String {
        let values = self.facts.keys().into_iter().zip(self.values(number));
        let drawn = values.filter_map(|(key, count)| match count {
            0.0 => None,
            1.0 => Some(key.to_owned()),
            _ => Some(format!("{count} × {key}")),
        });
        drawn.collect::<Vec<_>>().join(", ")
    }

    fn show_more(&self, rows: &Rows, output: &Path) -> Result<(), Failure> {
        shrink_all(output, &broken_in(rows)?, self)
    }

    fn text(&self, number: usize) -> String {
        self.case(number).text()
    }

    fn play(&self, number: usize, watch: &Watch) -> Result<SweepRow, Failure> {
        let planned = self.case(number).plan();
        let plan = planned.map_err(|reason| Exit::Internal.because(reason))?;
        let broken = play_one(number, &plan, watch, violation)?;
        Ok(self.row(number, Some(plan.shared.run.seed), broken))
    }

    fn faulty(&self, number: usize, reason: String) -> SweepRow {
        let broken = BrokenInvariant {
            invariant: PANIC,
            text: reason,
        };
        self.row(number, None, Some(broken))
    }
}

#[cfg(test)]
mod tests {
    use scenario::Beside;
    use worlds::catalogue::catalogue;

    use super::*;

    fn cases(seed: u64) -> TortureCases {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 2.0\n[controller.pid]\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        let plan = Plan::parse_beside(
            &Beside::new(Path::new("t.toml")),
            text.to_owned(),
            catalogue(),
        )
        .unwrap();
        TortureCases::new(&plan, Draws { runs: 2, seed })
    }

    #[test]
    fn seed_and_number_decide_what_is_drawn() {
        let drawn = |seed, number| {
            let cases = cases(seed);
            let case = cases.case(number);
            let case = &case.plan().unwrap().only_loop().unwrap().trial.clone();
            (case.run.seed, format!("{:?}", case.run.faults))
        };
        let first = drawn(1, 1);
        assert_eq!(first, drawn(1, 1));
        for other in [drawn(2, 1), drawn(1, 2)] {
            assert!(first.0 != other.0 && first.1 != other.1, "{other:?}");
        }
    }

    #[test]
    fn the_values_count_the_faults_of_the_mix() {
        let cases = cases(1);
        for number in 1..=20 {
            let values = cases.values(number);
            let case = cases.case(number);
            let faults = case.plan().unwrap().shared.run.faults.clone();
            let counted: f64 = values.iter().sum();
            // A fault of the boot has no window.
            let at_boot = faults.iter().len() as f64 - counted;
            assert!(
                counted >= 1.0 && at_boot.abs() <= 1.0,
                "{}",
                cases.values_text(number, |count| count.to_string())
            );
        }
    }
}
