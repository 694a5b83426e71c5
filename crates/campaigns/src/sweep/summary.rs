//! Summary of a sweep: the number of cases for each way to end, and the distribution of each metric.

use std::collections::BTreeMap;

use recording::run_folder::file;
use report::terminal;
use runner::exit::Failure;
use scenario::expect::Limit;

use super::cases::Cases;
use super::drivers::{Driven, Sampler};
use super::row::{Ended, SweepRow};
use super::store::Rows;
use crate::distribution::{quantile, staircase};

/// Folder of the scenarios of cases that do not pass.
pub(super) const FAILING: &str = "failing";
/// Largest number of cases that do not pass and are written as scenarios and listed.
pub(super) const FAILING_MAX: usize = 100;
/// Largest number of values in memory; metrics are processed in groups of that size.
const VALUES_MAX: usize = 4_000_000;
/// Largest number of values of a distribution that are drawn.
const DRAWN_MAX: usize = 1000;

/// Summary of a sweep.
pub(super) struct Summary<'a> {
    /// Cases of the whole sweep.
    pub cases: &'a dyn Cases,
    /// Number of cases that were played.
    pub runs: usize,
    /// Number of cases for each way to end.
    pub ended: BTreeMap<Ended, usize>,
    /// Distribution of each metric that any case has, or that has a limit.
    pub spreads: Vec<MetricSpread>,
    /// Sensitivity of each metric with a limit, or of each broken invariant.
    pub driven: Vec<Driven>,
    /// First cases that do not pass.
    pub failing: Vec<Failing>,
}

/// Case that does not pass.
pub(super) struct Failing {
    /// Number of the case.
    pub case: usize,
    /// Hash of the case's content.
    pub id: String,
    /// End of the case.
    pub ended: Ended,
    /// Limits that were not met, or the reason.
    pub why: String,
    /// Values of the keys, in four digits.
    pub values: String,
}

impl Failing {
    /// Returns the place of the case's scenario in the folder.
    pub(super) fn place(&self) -> String {
        format!("{FAILING}/case-{}-{}.toml", self.case, self.id)
    }
}

/// Distribution of a metric.
pub(super) struct MetricSpread {
    /// Name of the metric, which contains the unit.
    pub name: String,
    /// Limit of the metric in the scenario.
    pub limit: Option<Limit>,
    /// Number of cases that missed the limit.
    pub missed: usize,
    /// Number of cases that have a value.
    pub count: usize,
    /// Least value, median, p95 and greatest value; NaN if no case has a value.
    pub quantiles: [f64; 4],
    /// Range from the p1 to the p99.
    pub bulk: (f64, f64),
    /// Percentage of the cases up to each value.
    pub curve: (Vec<f64>, Vec<f64>),
}

/// Returns the limits that a case missed, each with the value.
fn missed(row: &SweepRow, limits: &BTreeMap<String, Limit>) -> String {
    let texts = row.missed.iter().map(|name| {
        // An invariant of torture has no limit.
        let Some(limit) = limits.get(name) else {
            return name.clone();
        };
        let value = terminal::reached(name, row.metric(name));
        let limit = terminal::limit(name, Some(*limit));
        format!("{name} {}", terminal::with_limit(&value, &limit))
    });
    Vec::from_iter(texts).join(", ")
}

impl<'a> Summary<'a> {
    /// Summarizes the rows of all cases.
    pub(super) fn read(cases: &'a dyn Cases, rows: &Rows) -> Result<Self, Failure> {
        let limited = &cases.facts().limits;
        let limits = BTreeMap::from_iter(limited.iter().cloned());
        let mut sampler = Sampler::new(cases, &limits);
        let mut summary = Self {
            cases,
            runs: 0,
            ended: BTreeMap::new(),
            spreads: Vec::new(),
            driven: Vec::new(),
            failing: Vec::new(),
        };
        let (mut metrics, mut missed) = (Vec::new(), BTreeMap::new());
        for row in rows.iter()? {
            let row = row?;
            sampler.add(&row);
            for name in &row.missed {
                *missed.entry(name.clone()).or_default() += 1;
            }
            add_new(&mut metrics, row.metrics.iter().map(|(name, _)| name));
            summary.add(row, &limits);
        }
        add_new(&mut metrics, limited.iter().map(|(name, _)| name));
        summary.driven = sampler.driven();
        summary.spreads = spreads(&metrics, summary.runs, &limits, &missed, rows)?;
        Ok(summary)
    }

    fn add(&mut self, row: SweepRow, limits: &BTreeMap<String, Limit>) {
        self.runs += 1;
        *self.ended.entry(row.ended).or_default() += 1;
        if row.ended != Ended::Pass && self.failing.len() < FAILING_MAX {
            self.failing.push(Failing {
                case: row.case,
                ended: row.ended,
                why: row.reason.clone().unwrap_or_else(|| missed(&row, limits)),
                values: self.cases.values_text(row.case, terminal::rounded),
                id: row.id,
            });
        }
    }

    /// Returns the command that plays a case alone, in the folder of the campaign; `None` if none does.
    pub(super) fn command(&self, case: usize) -> Option<String> {
        let mut failing = self.failing.iter();
        if let Some(one) = failing.find(|one| one.case == case) {
            let place = one.place();
            return (one.ended != Ended::Invalid).then(|| format!("canrig simulate {place}"));
        }
        let options = self.cases.options(case)?;
        Some(format!("canrig simulate {}{options}", file::SCENARIO))
    }

    /// Returns the worst way in which a case ended.
    pub(super) fn worst(&self) -> Ended {
        let worst = self.ended.keys().max_by_key(|ended| ended.exit());
        worst.copied().unwrap_or(Ended::Pass)
    }

    /// Returns the number of cases that do not pass.
    pub(super) fn failing_total(&self) -> usize {
        self.runs - self.ended.get(&Ended::Pass).copied().unwrap_or_default()
    }
}

/// Adds the names that are not there yet.
fn add_new<'n>(names: &mut Vec<String>, new: impl IntoIterator<Item = &'n String>) {
    for name in new {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
}

/// Returns the number of metrics whose values are in memory at the same time.
fn metrics_at_a_time(runs: usize) -> usize {
    (VALUES_MAX / runs.max(1)).max(1)
}

/// Returns the distributions of all metrics, by as many passes over the rows as the bound on memory needs.
fn spreads(
    metrics: &[String],
    runs: usize,
    limits: &BTreeMap<String, Limit>,
    missed: &BTreeMap<String, usize>,
    rows: &Rows,
) -> Result<Vec<MetricSpread>, Failure> {
    let mut spreads = Vec::new();
    for names in metrics.chunks(metrics_at_a_time(runs)) {
        let mut columns = vec![Vec::new(); names.len()];
        for row in rows.iter()? {
            let row = row?;
            for (column, name) in columns.iter_mut().zip(names) {
                column.extend(row.metric(name));
            }
        }
        for (name, mut values) in names.iter().zip(columns) {
            values.sort_unstable_by(f64::total_cmp);
            let missed = missed.get(name).copied().unwrap_or_default();
            let limit = limits.get(name).copied();
            spreads.push(MetricSpread::new(name, limit, missed, &values));
        }
    }
    Ok(spreads)
}

impl MetricSpread {
    pub(super) fn new(name: &str, limit: Option<Limit>, missed: usize, sorted: &[f64]) -> Self {
        let at = |percent| quantile(sorted, percent).unwrap_or(f64::NAN);
        Self {
            name: name.to_owned(),
            limit,
            missed,
            count: sorted.len(),
            quantiles: [at(0), at(50), at(95), at(100)],
            bulk: (at(1), at(99)),
            curve: staircase(&decimated(sorted)),
        }
    }

    /// Returns whether the metric has different values, so that there is something to draw.
    pub(super) fn varies(&self) -> bool {
        self.quantiles[0] < self.quantiles[3]
    }
}

/// Thins out sorted values without a visible change of the drawing; keeps the first and the last.
fn decimated(sorted: &[f64]) -> Vec<f64> {
    let Some(last) = sorted
        .len()
        .checked_sub(1)
        .filter(|last| *last >= DRAWN_MAX)
    else {
        return sorted.to_vec();
    };
    let places = (0..DRAWN_MAX).map(|number| number * last / (DRAWN_MAX - 1));
    places.map(|place| sorted[place]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distribution_of_many_is_drawn_by_few() {
        let many: Vec<f64> = (0..100_000).map(f64::from).collect();
        let few = decimated(&many);
        assert_eq!((few.len(), few[0], few[999]), (1000, 0.0, 99_999.0));
        assert!(few.windows(2).all(|pair| pair[1] - pair[0] <= 101.0));
        assert_eq!(decimated(&many[..1000]), many[..1000]);
        assert_eq!(decimated(&[]), [] as [f64; 0]);
        let spread = MetricSpread::new("m", None, 0, &many);
        assert_eq!(spread.quantiles, [0.0, 49_999.0, 94_999.0, 99_999.0]);
        let never = MetricSpread::new("m", None, 3, &[]);
        assert!(never.count == 0 && never.quantiles.iter().all(|one| one.is_nan()));
        assert!(!never.varies());
        let groups = [0, 60, 900_000, 10_000_000].map(metrics_at_a_time);
        assert_eq!(groups, [4_000_000, 66_666, 4, 1]);
    }

    #[test]
    fn a_case_that_fails_is_listed_with_what_it_missed() {
        let limit = Limit {
            min: None,
            max: Some(10.0),
        };
        let limits = ["overshoot_percent", "settling_time_seconds"];
        let limits = BTreeMap::from(limits.map(|name| (name.to_owned(), limit)));
        let mut row = SweepRow::without_verdict(1, "id", Ended::Fail, String::new());
        row.missed = limits.keys().cloned().chain(["panic".to_owned()]).collect();
        row.metrics = vec![("overshoot_percent".to_owned(), 12.5)];
        assert_eq!(
            missed(&row, &limits),
            "overshoot_percent 12.50 (limit ≤ 10), settling_time_seconds never (limit ≤ 10), panic"
        );
    }
}
