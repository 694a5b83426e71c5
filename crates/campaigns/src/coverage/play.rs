//! One play of a scenario, read back from its folder: a run, or a sweep with all its runs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use judge::verdict::{Outcome, Verdict};
use plan::Plan;
use recording::session::read_plan;
use report::terminal;
use runner::exit::Failure;
use runner::play_record::PlayRecord;
use runner::recorded::{holds_many_runs, read_played, require_run};
use scenario::expect::ExpectedRow;
use scenario::sweep::Sweep;
use worlds::catalogue::catalogue;

use crate::sweep::Shard;
use crate::sweep::row::SweepRow;
use crate::sweep::store::{Header, Rows};

/// Play of a scenario.
#[derive(Clone, Debug)]
pub(super) struct Play {
    /// Name of the scenario, with an addition that tells this test from others of that name.
    pub(super) test: String,
    /// Folder of the play.
    pub(super) folder: PathBuf,
    /// Version of the program; `None` if it is unknown.
    pub(super) version: Option<String>,
    /// Time of the play; `None` if it is unknown.
    pub(super) at: Option<Timestamp>,
    /// Number of runs of a sweep; `None` for a single run.
    pub(super) sweep_runs: Option<usize>,
    /// Tests of each requirement, by its name.
    pub(super) tested: BTreeMap<String, Vec<Tested>>,
}

/// Outcome of a play for a requirement.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tested {
    /// Row of the verdict; `None` for the scenario as a whole.
    pub(super) row: Option<String>,
    /// Limit of the row; empty for the scenario as a whole.
    pub(super) limit: String,
    /// The value of the row, in the worst of a sweep's runs; `None` for the scenario as a whole, and where no run has a verdict.
    pub(super) measured: Option<String>,
    /// Outcome of the row, in the worst of a sweep's runs.
    pub(super) outcome: Outcome,
    /// Reason why passing proves nothing; `None` where a limit was judged.
    pub(super) uncovered: Option<&'static str>,
    /// Run of the sweep with this outcome.
    pub(super) case: Option<usize>,
}

impl Play {
    /// Reads the folder of a run or of a sweep.
    ///
    /// # Errors
    /// The folder is neither, or damaged.
    pub(super) fn read(folder: &Path) -> Result<Self, Failure> {
        if holds_many_runs(folder) {
            Self::read_sweep(folder)
        } else {
            Self::read_run(folder)
        }
    }

    fn read_run(folder: &Path) -> Result<Self, Failure> {
        require_run(folder)?;
        let (plan, verdict) = read_played(folder, catalogue())?;
        let version = verdict.as_ref().map(|verdict| verdict.version.clone());
        // Without a verdict the run is incomplete.
        let verdict = verdict.unwrap_or_default();
        let untimed = untimed(&plan, verdict.timing.is_none());
        // A run counts as a sweep with one case.
        let run = SweepRow::from_verdict(1, "", &verdict);
        let mut tested = tested(&plan);
        let uncovered = uncovered(&plan, !untimed.is_empty());
        for one in tested.values_mut().flatten() {
            one.judge(&run, &verdict, &untimed);
            one.leave_uncovered(uncovered);
        }
        let external = verdict.external.iter();
        let kind = external.map(|node| format!("external {node}"));
        Ok(Self {
            version,
            sweep_runs: None,
            tested,
            ..Self::named(folder, &plan, kind.collect())?
        })
    }

    /// Reads a sweep, which counts by its worst run. Runs that it lacks are incomplete.
    fn read_sweep(folder: &Path) -> Result<Self, Failure> {
        let plan = read_plan(folder, None, catalogue())?;
        let untimed = untimed(&plan, true);
        let mut tested = tested(&plan);
        let header = Header::read(folder)?;
        let mut is_whole = false;
        if let Some(header) = &header {
            let rows = Rows::read(folder, header, Shard::WHOLE)?;
            is_whole = rows.is_whole();
            for row in rows.iter()? {
                let row = row?;
                for one in tested.values_mut().flatten() {
                    let outcome = outcome_in(&row, one.row.as_ref(), &untimed);
                    if one.worsen(outcome, Some(row.case)) {
                        let name = one.row.as_deref().unwrap_or_default();
                        let value = row.metric(name);
                        one.measured = value.map(|value| terminal::value(name, value));
                    }
                }
            }
        }
        if !is_whole {
            let all = tested.values_mut().flatten();
            for one in all {
                one.worsen(Outcome::Incomplete, None);
            }
        }
        let uncovered = uncovered(&plan, !untimed.is_empty());
        for one in tested.values_mut().flatten() {
            one.leave_uncovered(uncovered);
        }
        let runs = header.as_ref().map_or(0, |header| header.runs);
        let version = header.map(|header| header.version);
        Ok(Self {
            version,
            sweep_runs: Some(runs),
            tested,
            ..Self::named(folder, &plan, vec!["sweep".to_owned()])?
        })
    }

    /// Returns a play without results. Other values on the command line make another test, and so does another `kind`.
    fn named(folder: &Path, plan: &Plan, kind: Vec<String>) -> Result<Self, Failure> {
        let record = PlayRecord::read(folder)?;
        let set = record.iter().flat_map(|record| &record.set);
        let kind = kind
            .into_iter()
            .chain(set.map(|set| format!("--set {set}")));
        let kind = Vec::from_iter(kind).join(", ");
        let name = &plan.shared.run.name;
        Ok(Self {
            test: match kind.as_str() {
                "" => name.clone(),
                kind => format!("{name} ({kind})"),
            },
            folder: folder.to_owned(),
            version: None,
            at: record.map(|record| record.at),
            sweep_runs: None,
            tested: BTreeMap::new(),
        })
    }
}

impl Tested {
    /// Takes outcome, value and limit from a verdict, which `run` has as the row of a sweep.
    fn judge(&mut self, run: &SweepRow, verdict: &Verdict, untimed: &[String]) {
        self.outcome = outcome_in(run, self.row.as_ref(), untimed);
        let mut metrics = verdict.metrics.iter();
        if let Some(metric) = metrics.find(|metric| self.row.as_ref() == Some(&metric.name)) {
            self.limit = terminal::limit(&metric.name, metric.limit);
            self.measured = Some(terminal::measured(metric));
            // The verdict may only report what the scenario in the folder limits.
            if self.outcome == Outcome::Pass && metric.passed.is_none() {
                self.outcome = Outcome::Inconclusive;
            }
        }
    }

    /// Takes the reason why a scenario that passes as a whole proves nothing.
    fn leave_uncovered(&mut self, why: Option<&'static str>) {
        let is_of_whole = self.row.is_none() && self.outcome == Outcome::Pass;
        self.uncovered = why.filter(|_| is_of_whole);
    }

    /// Takes an outcome that is worse, with its case. Returns whether it was worse.
    fn worsen(&mut self, outcome: Outcome, case: Option<usize>) -> bool {
        let is_worse = outcome > self.outcome;
        if is_worse {
            (self.outcome, self.case) = (outcome, case);
        }
        is_worse
    }
}

/// Returns the plays of a test that count: those with the latest date, or all if none has a date.
pub(super) fn latest(mut plays: Vec<Play>) -> Vec<Play> {
    let last = plays.iter().filter_map(|play| play.at).max();
    plays.retain(|play| play.at == last);
    plays
}

/// Returns each requirement of a scenario with its tests, which are not played yet: rows, or the scenario as a whole.
fn tested(plan: &Plan) -> BTreeMap<String, Vec<Tested>> {
    let mut tested: BTreeMap<String, Vec<Tested>> = BTreeMap::new();
    let mut add = |id: &String, row: Option<&ExpectedRow>| {
        tested.entry(id.clone()).or_default().push(Tested {
            row: row.map(|row| row.name.clone()),
            limit: row.map_or_else(String::new, |row| terminal::limit(&row.name, row.limit)),
            measured: None,
            outcome: Outcome::Pass,
            uncovered: None,
            case: None,
        });
    };
    let whole = plan.shared.run.requirements.iter();
    whole.for_each(|id| add(id, None));
    let is_timed = true;
    let mut rows = judge::expected_rows(plan, is_timed);
    rows.sort_by(|one, other| one.name.cmp(&other.name));
    for row in &rows {
        row.requirements.iter().for_each(|id| add(id, Some(row)));
    }
    tested
}

/// Returns the rows on timing, which a verdict does not have if the run was in virtual time.
fn untimed(plan: &Plan, is_untimed: bool) -> Vec<String> {
    let rows = plan.shared.run.expect.timing.rows();
    rows.filter(|_| is_untimed).collect()
}

/// Returns the reason why a play of a scenario that passes proves nothing, if no limit was judged. A sweep may vary one.
fn uncovered(plan: &Plan, is_untimed: bool) -> Option<&'static str> {
    let sweep = plan.shared.sweep.as_ref();
    let mut keys = sweep.into_iter().flat_map(Sweep::keys);
    let is_limited = !judge::limits(plan).is_empty() || keys.any(|key| key.starts_with("expect."));
    let is_timed = plan.shared.run.expect.timing.rows().next().is_some();
    match (is_limited, is_timed, is_untimed) {
        (true, ..) | (_, true, false) => None,
        (_, true, true) => Some("only timing is limited, which virtual time does not judge"),
        (_, false, _) => Some("nothing is limited"),
    }
}

/// Returns the outcome of a row, or of the whole run, according to the row of a sweep.
fn outcome_in(run: &SweepRow, row: Option<&String>, untimed: &[String]) -> Outcome {
    let outcome = run.ended.outcome();
    match row {
        Some(row) if matches!(outcome, Outcome::Pass | Outcome::Fail) => match () {
            () if run.missed.contains(row) => Outcome::Fail,
            () if untimed.contains(row) || run.undecided.contains(row) => Outcome::Inconclusive,
            // The scenario in the folder is not the one that was judged.
            () if run.metric(row).is_none() => Outcome::Incomplete,
            () => Outcome::Pass,
        },
        _ => outcome,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::row::Ended;
    use judge::verdict::Metric;
    use scenario::expect::Limit;

    #[test]
    fn a_row_has_an_outcome_unless_the_run_decides_nothing() {
        let limit = Some(Limit {
            min: None,
            max: Some(1.0),
        });
        let mut verdict = Verdict::incomplete("step", 1, "");
        verdict.metrics = vec![
            Metric::new("met", Ok(0.5), limit),
            Metric::new("missed", Ok(2.0), limit),
            Metric::not_judged("unknown", "nobody publishes it".to_owned(), limit),
            Metric::new("reported", Ok(0.5), None),
        ];
        let judged = |outcome, row: Option<&str>| {
            let verdict = Verdict {
                outcome,
                ..verdict.clone()
            };
            let run = SweepRow::from_verdict(1, "1f", &verdict);
            let mut tested = Tested {
                row: row.map(str::to_owned),
                limit: "at most 7".to_owned(),
                measured: None,
                outcome: Outcome::Pass,
                uncovered: None,
                case: None,
            };
            tested.judge(&run, &verdict, &[]);
            tested
        };
        let of = |outcome, row| judged(outcome, row).outcome;
        assert_eq!(of(Outcome::Fail, Some("met")), Outcome::Pass);
        assert_eq!(of(Outcome::Fail, Some("missed")), Outcome::Fail);
        assert_eq!(of(Outcome::Fail, Some("unknown")), Outcome::Inconclusive);
        assert_eq!(of(Outcome::Pass, Some("reported")), Outcome::Inconclusive);
        let reported = judged(Outcome::Fail, Some("reported"));
        assert_eq!(reported.outcome, Outcome::Inconclusive);
        assert_eq!(reported.limit, "");
        assert_eq!(of(Outcome::Fail, Some("gone")), Outcome::Incomplete);
        assert_eq!(of(Outcome::Fail, None), Outcome::Fail);
        assert_eq!(of(Outcome::Incomplete, Some("met")), Outcome::Incomplete);
        let none = SweepRow::from_verdict(1, "1f", &Verdict::default());
        let met = "met".to_owned();
        assert_eq!(outcome_in(&none, Some(&met), &[]), Outcome::Incomplete);
    }

    #[test]
    fn a_run_of_a_sweep_that_was_not_played_is_incomplete_and_timing_is_not_judged() {
        let run = |ended| SweepRow::without_verdict(1, "1f", ended, String::new());
        let row = "bus_round_trip".to_owned();
        for (ended, of_whole, of_row) in [
            (Ended::Pass, Outcome::Pass, Outcome::Inconclusive),
            (Ended::Invalid, Outcome::Incomplete, Outcome::Incomplete),
            (
                Ended::InternalError,
                Outcome::Incomplete,
                Outcome::Incomplete,
            ),
        ] {
            let untimed = [row.clone()];
            assert_eq!(outcome_in(&run(ended), None, &untimed), of_whole);
            assert_eq!(outcome_in(&run(ended), Some(&row), &untimed), of_row);
        }
    }

    #[test]
    fn the_latest_plays_count_and_without_dates_all_do() {
        let play = |number: i64, at: Option<i64>| Play {
            test: "step".to_owned(),
            folder: PathBuf::from(format!("run-{number}")),
            version: None,
            at: at.map(|second| Timestamp::from_second(second).unwrap()),
            sweep_runs: None,
            tested: BTreeMap::new(),
        };
        let folders = |dates: [Option<i64>; 3]| {
            let plays = (1..).zip(dates).map(|(number, at)| play(number, at));
            let latest = latest(plays.collect()).into_iter();
            let folders = latest.map(|play| play.folder.display().to_string());
            folders.collect::<Vec<_>>()
        };
        assert_eq!(folders([Some(5), Some(7), None]), ["run-2"]);
        assert_eq!(folders([Some(5), None, Some(5)]), ["run-1", "run-3"]);
        assert_eq!(folders([None; 3]), ["run-1", "run-2", "run-3"]);
    }
}
