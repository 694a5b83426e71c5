//! Requirements and what tests them.

use std::path::{Path, PathBuf};

use serde::Serialize;

use judge::verdict::Outcome;

/// One requirement with all that tests it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Requirement {
    /// Its name.
    pub id: String,
    /// What it says; none where no list says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// Whether the list has it; true without a list.
    pub is_listed: bool,
    /// What tests it, by the scenario's name; empty for one that is never tested.
    pub tests: Vec<RequirementTest>,
}

/// What a scenario says of a requirement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct RequirementTest {
    /// The scenario's name.
    pub scenario: String,
    /// The worst of its runs and rows.
    pub outcome: Outcome,
    /// The rows of the verdict that count; none where the scenario as a whole does.
    pub rows: Vec<String>,
    /// The run with this outcome.
    pub run: PathBuf,
    /// How many runs there are.
    pub runs: usize,
}

impl Requirement {
    /// A requirement that nothing tests yet.
    pub(super) fn new(id: String, is_listed: bool) -> Self {
        Self {
            id,
            text: None,
            is_listed,
            tests: Vec::new(),
        }
    }

    /// The worst of its tests; none for one that is never tested.
    #[must_use]
    pub(super) fn outcome(&self) -> Option<Outcome> {
        let outcomes = self.tests.iter().map(|test| test.outcome);
        outcomes.max_by_key(|outcome| severity(*outcome))
    }
}

/// What is worse counts.
fn severity(outcome: Outcome) -> u8 {
    match outcome {
        Outcome::Pass => 0,
        Outcome::Inconclusive => 1,
        Outcome::Incomplete => 2,
        Outcome::Fail => 3,
    }
}

impl Requirement {
    /// Adds what the rows of one run say.
    pub(super) fn add(&mut self, scenario: &str, rows: &[(Option<String>, Outcome)], run: &Path) {
        let place = self
            .tests
            .iter()
            .position(|test| test.scenario == scenario)
            .unwrap_or_else(|| {
                self.tests.push(RequirementTest::none(scenario, run));
                self.tests.len() - 1
            });
        let test = &mut self.tests[place];
        test.runs += 1;
        for (row, outcome) in rows {
            if severity(*outcome) > severity(test.outcome) {
                (test.outcome, test.run) = (*outcome, run.to_owned());
            }
            test.rows
                .extend(row.clone().filter(|row| !test.rows.contains(row)));
        }
    }
}

impl RequirementTest {
    /// A scenario of which no row was looked at yet.
    fn none(scenario: &str, run: &Path) -> Self {
        Self {
            scenario: scenario.to_owned(),
            outcome: Outcome::Pass,
            rows: Vec::new(),
            run: run.to_owned(),
            runs: 0,
        }
    }
}
