//! Requirements and the scenarios that test them.

use std::collections::BTreeMap;
use std::path::PathBuf;

use jiff::Timestamp;
use serde::Serialize;

use super::play::{Play, Tested};
use judge::verdict::Outcome;
use report::overview::urgency;

/// Requirement with all its tests.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Requirement {
    /// Name of the requirement.
    pub id: String,
    /// Text of the requirement; `None` if no list has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// Whether the list has the requirement; true without a list.
    pub is_listed: bool,
    /// Tests of the requirement, each by the name of its scenario; empty if it is never tested.
    pub tests: Vec<RequirementTest>,
}

/// Scenario that tests a requirement, with its outcome.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct RequirementTest {
    /// Name of the scenario, with an addition that tells this test from others of that name.
    pub scenario: String,
    /// Worst outcome of the rows, in the latest play.
    pub outcome: Outcome,
    /// Rows of the verdict that count; empty if the scenario counts as a whole.
    pub rows: Vec<String>,
    /// Of rows the measured value and the limit.
    #[serde(skip)]
    pub measured: BTreeMap<String, (String, String)>,
    /// Folder of the play that counts.
    pub run: PathBuf,
    /// Number of plays.
    pub plays: usize,
    /// Version of the program in the play that counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// Time of that play, as RFC 3339 writes it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub played_at: Option<Timestamp>,
    /// Number of runs, if the play is a sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep_runs: Option<usize>,
    /// First of the worst runs, if the play is a sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub case: Option<usize>,
}

impl Requirement {
    /// Returns a requirement without tests.
    pub(super) fn new(id: String, is_listed: bool) -> Self {
        Self {
            id,
            text: None,
            is_listed,
            tests: Vec::new(),
        }
    }

    /// Returns the worst outcome of the tests; `None` if there are no tests.
    pub(super) fn outcome(&self) -> Option<Outcome> {
        let outcomes = self.tests.iter().map(|test| test.outcome);
        outcomes.min_by_key(|outcome| urgency(*outcome))
    }

    /// Adds the outcomes of one play of a test, which has been played `plays` times.
    pub(super) fn add(&mut self, name: &str, play: &Play, plays: usize, tested: &[Tested]) {
        let known = self.tests.iter().position(|test| test.scenario == name);
        let place = known.unwrap_or_else(|| {
            self.tests.push(RequirementTest::none(name, play, plays));
            self.tests.len() - 1
        });
        let test = &mut self.tests[place];
        for one in tested {
            let Tested { row, outcome, .. } = one;
            let is_worse = urgency(*outcome) < urgency(test.outcome);
            if is_worse {
                test.add(play);
                (test.outcome, test.case) = (*outcome, one.case);
            }
            if let (Some(row), Some(measured)) = (row, &one.measured)
                && (is_worse || !test.measured.contains_key(row))
            {
                test.measured.insert(row.clone(), measured.clone());
            }
            test.rows
                .extend(row.clone().filter(|row| !test.rows.contains(row)));
        }
    }
}

impl RequirementTest {
    /// Returns a test that has no rows yet.
    fn none(name: &str, play: &Play, plays: usize) -> Self {
        let mut test = Self {
            scenario: name.to_owned(),
            outcome: Outcome::Pass,
            rows: Vec::new(),
            measured: BTreeMap::new(),
            run: PathBuf::new(),
            plays,
            version: None,
            played_at: None,
            sweep_runs: None,
            case: None,
        };
        test.add(play);
        test
    }

    /// Makes `play` the one that counts.
    fn add(&mut self, play: &Play) {
        self.run.clone_from(&play.folder);
        self.version.clone_from(&play.version);
        (self.played_at, self.sweep_runs) = (play.at, play.sweep_runs);
    }
}
