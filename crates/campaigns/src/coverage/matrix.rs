//! Requirements and what tests them.

use std::path::PathBuf;

use jiff::Timestamp;
use serde::{Serialize, Serializer};

use super::play::{Play, Tested};
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
    /// The scenario's name, with what tells this test from others of that name.
    pub scenario: String,
    /// The worst of its rows, in the latest play.
    pub outcome: Outcome,
    /// The rows of the verdict that count; none where the scenario as a whole does.
    pub rows: Vec<String>,
    /// The folder of the play that counts.
    pub run: PathBuf,
    /// How many plays there are.
    pub plays: usize,
    /// The program's version in the play that counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// When that play was, as RFC 3339 writes it.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "written")]
    pub played_at: Option<Timestamp>,
    /// The runs of a sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep_runs: Option<usize>,
    /// The first of the worst runs of a sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub case: Option<usize>,
}

/// A time as RFC 3339 writes it.
fn written<S: Serializer>(time: &Option<Timestamp>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&time.unwrap_or_default())
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
pub(super) fn severity(outcome: Outcome) -> u8 {
    match outcome {
        Outcome::Pass => 0,
        Outcome::Inconclusive => 1,
        Outcome::Incomplete => 2,
        Outcome::Fail => 3,
    }
}

impl Requirement {
    /// Adds what a play of a test says, which is one of so many.
    pub(super) fn add(&mut self, name: &str, play: &Play, plays: usize, tested: &[Tested]) {
        let known = self.tests.iter().position(|test| test.scenario == name);
        let place = known.unwrap_or_else(|| {
            self.tests.push(RequirementTest::none(name, play, plays));
            self.tests.len() - 1
        });
        let test = &mut self.tests[place];
        for Tested { row, outcome, case } in tested {
            if severity(*outcome) > severity(test.outcome) {
                test.is_of(play);
                (test.outcome, test.case) = (*outcome, *case);
            }
            test.rows
                .extend(row.clone().filter(|row| !test.rows.contains(row)));
        }
    }
}

impl RequirementTest {
    /// A test of which no row was looked at yet.
    fn none(name: &str, play: &Play, plays: usize) -> Self {
        let mut test = Self {
            scenario: name.to_owned(),
            outcome: Outcome::Pass,
            rows: Vec::new(),
            run: PathBuf::new(),
            plays,
            version: None,
            played_at: None,
            sweep_runs: None,
            case: None,
        };
        test.is_of(play);
        test
    }

    /// Notes which play counts.
    fn is_of(&mut self, play: &Play) {
        self.run.clone_from(&play.folder);
        self.version.clone_from(&play.version);
        (self.played_at, self.sweep_runs) = (play.at, play.sweep_runs);
    }
}
