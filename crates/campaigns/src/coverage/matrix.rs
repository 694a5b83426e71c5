//! Requirements and the scenarios that test them.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::PathBuf;

use jiff::Timestamp;
use serde::Serialize;

use super::play::{Play, Tested};
use judge::verdict::Outcome;

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
    /// Worst outcome of the rows, in the latest play; `None` if no limit was judged.
    pub outcome: Option<Outcome>,
    /// Reason why the test does not cover the requirement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncovered: Option<&'static str>,
    /// Rows of the verdict that count; empty if the scenario counts as a whole.
    pub rows: Vec<String>,
    /// Of rows the measured value and the limit, each in the play with the worst outcome of the row, which may be another than `run`.
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

    /// Returns the worst outcome of the tests; `None` if none covers the requirement.
    pub(super) fn outcome(&self) -> Option<Outcome> {
        self.tests.iter().filter_map(|test| test.outcome).max()
    }
}

impl RequirementTest {
    /// Returns the test by its results in the plays that count, of which there is one at least; it was played `plays` times.
    pub(super) fn new(scenario: &str, plays: usize, results: &[(&Play, &Tested)]) -> Self {
        let mut worst_first = results.to_vec();
        worst_first.sort_by_key(|(_, one)| (one.uncovered.is_some(), Reverse(one.outcome)));
        let (play, worst) = worst_first[0];
        let mut rows = Vec::new();
        for row in results.iter().filter_map(|(_, one)| one.row.as_ref()) {
            if !rows.contains(row) {
                rows.push(row.clone());
            }
        }
        // The worst one is last, and so replaces the others.
        let values = worst_first.iter().rev();
        let measured = values.filter_map(|(_, one)| {
            let measured = (one.measured.clone()?, one.limit.clone());
            Some((one.row.clone()?, measured))
        });
        Self {
            scenario: scenario.to_owned(),
            outcome: worst.uncovered.is_none().then_some(worst.outcome),
            uncovered: worst.uncovered,
            rows,
            measured: measured.collect(),
            run: play.folder.clone(),
            plays,
            version: play.version.clone(),
            played_at: play.at,
            sweep_runs: play.sweep_runs,
            case: worst.case,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_row_is_measured_in_the_play_with_its_worst_outcome() {
        use Outcome::{Fail, Inconclusive, Pass};
        let play = |folder: &str| Play {
            test: "step".to_owned(),
            folder: folder.into(),
            version: None,
            at: None,
            sweep_runs: None,
            tested: BTreeMap::new(),
        };
        let measured = |value: &str| (value.to_owned(), "10".to_owned());
        let tested = |row: &str, value: &str, outcome| Tested {
            row: Some(row.to_owned()),
            limit: "10".to_owned(),
            measured: Some(value.to_owned()),
            outcome,
            uncovered: None,
            case: None,
        };
        let (first, second) = (play("first"), play("second"));
        let results = [
            (&first, &tested("overshoot", "11", Fail)),
            (&first, &tested("settling", "1", Pass)),
            (&second, &tested("overshoot", "2", Pass)),
            (&second, &tested("settling", "12", Inconclusive)),
        ];
        let test = RequirementTest::new("step", 2, &results);
        assert_eq!((test.outcome, test.run), (Some(Fail), "first".into()));
        assert_eq!(test.rows, ["overshoot", "settling"]);
        let expected = [("overshoot", "11"), ("settling", "12")]
            .map(|(row, value)| (row.to_owned(), measured(value)));
        assert_eq!(test.measured, BTreeMap::from(expected));
    }
}
