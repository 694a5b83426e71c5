//! Sensitivity of the metrics to the keys: how closely the ranks of a metric follow the ranks of each key, and the worst runs.
//!
//! Ranks are computed from an even sample of the runs, so a million runs need no more memory than some thousand. With 20 000 runs
//! in it, a correlation is off by 0.007 (one standard deviation).

use std::collections::BTreeMap;

use scenario::expect::Limit;

use super::cases::Cases;
use super::row::SweepRow;

/// Approximate number of runs in the sample.
const SAMPLE: usize = 20_000;
/// Number of worst runs of each metric that are drawn, and divisor of the number of all runs that bounds it.
const WORST: usize = 25;
const WORST_ONE_IN: usize = 4;
/// Number of points of the sample that are drawn.
const DRAWN: usize = 1000;
/// Number of keys that are named for each metric.
const NAMED: usize = 3;
/// Smallest correlation that counts: ranks of 1000 runs exceed it by chance once in a thousand.
const CORRELATION_MIN: f64 = 0.1;

/// Sensitivity of a metric with a limit, or of an invariant.
pub(super) struct Driven {
    /// Name of the metric or the invariant.
    pub name: String,
    /// Its limit; `None` for an invariant.
    pub limit: Option<Limit>,
    /// Keys that it follows most, with their rank correlations from -1 to 1, the strongest first.
    pub keys: Vec<(String, f64)>,
    /// Runs of the sample: values of the first key and the metric. Runs without a value are left out.
    pub sample: Vec<(f64, f64)>,
    /// Worst of all runs: case, and values of the first key and the metric.
    pub worst: Vec<(usize, f64, f64)>,
    /// Number of runs from which the correlations are computed.
    pub of: usize,
}

/// Collects the sample and the worst runs while the rows are read.
pub(super) struct Sampler<'a> {
    cases: &'a dyn Cases,
    /// Metrics with a limit.
    limits: &'a BTreeMap<String, Limit>,
    /// Number of runs of which one is in the sample.
    one_in: u64,
    sample: Vec<Sampled>,
    worst_max: usize,
    worst: BTreeMap<String, Vec<Worst>>,
}

/// Run of the sample.
struct Sampled {
    /// Values of the keys.
    keys: Vec<f64>,
    /// Values by name. A metric that missed its limit without a value lies beyond the limit.
    values: BTreeMap<String, f64>,
}

/// Run among the worst.
struct Worst {
    /// Distance beyond the limit; the greater, the worse.
    badness: f64,
    case: usize,
    value: f64,
}

impl<'a> Sampler<'a> {
    pub(super) fn new(cases: &'a dyn Cases, limits: &'a BTreeMap<String, Limit>) -> Self {
        let runs = cases.facts().runs;
        Self {
            cases,
            limits,
            one_in: runs.div_ceil(SAMPLE).max(1) as u64,
            sample: Vec::new(),
            worst_max: WORST.min(runs.div_ceil(WORST_ONE_IN)),
            worst: BTreeMap::new(),
        }
    }

    pub(super) fn add(&mut self, row: &SweepRow) {
        // Torture has no limits; its invariants take their place.
        let missed = row.missed.iter();
        let broken = missed.filter(|name| !self.limits.contains_key(*name));
        let broken: Vec<(String, f64)> = broken.map(|name| (name.clone(), 1.0)).collect();
        let values = self.limits.iter().filter_map(|(name, limit)| {
            let value = row.metric(name);
            let is_missed = row.missed.contains(name);
            let value = value.or_else(|| is_missed.then(|| beyond(*limit)))?;
            Some((name.clone(), value))
        });
        let values: BTreeMap<String, f64> = values.chain(broken.clone()).collect();
        for (name, value) in &values {
            let limit = self.limits.get(name);
            let badness = limit.map_or(1.0, |limit| -limit.margin(*value));
            let worst = self.worst.entry(name.clone()).or_default();
            let place = worst.partition_point(|one| one.badness >= badness);
            let one = Worst {
                badness,
                case: row.case,
                value: *value,
            };
            worst.insert(place, one);
            worst.truncate(self.worst_max);
        }
        // Invariants are rarely broken: all such runs are in the sample, as far as there is room.
        let is_rare = !broken.is_empty() && self.sample.len() < 2 * SAMPLE;
        if is_rare || mixed(row.case).is_multiple_of(self.one_in) {
            let keys = self.cases.values(row.case);
            self.sample.push(Sampled { keys, values });
        }
    }

    /// Returns the sensitivity of each metric with a limit, without those that follow no key.
    pub(super) fn driven(&self) -> Vec<Driven> {
        let names = self.worst.keys();
        names.filter_map(|name| self.driven_by(name)).collect()
    }

    fn driven_by(&self, name: &str) -> Option<Driven> {
        let keys = self.cases.facts().keys();
        let is_limited = self.limits.contains_key(name);
        let value = |one: &Sampled| match one.values.get(name) {
            None if !is_limited => Some(0.0),
            value => value.copied(),
        };
        let runs = self.sample.iter();
        let runs = runs.filter_map(|one| Some((&one.keys, value(one)?)));
        let runs = Vec::from_iter(runs);
        let values = ranks(runs.iter().map(|(_, value)| *value));
        let correlation = |key: usize| {
            let key_ranks = ranks(runs.iter().map(|(keys, _)| keys[key]));
            correlation(&key_ranks, &values)
        };
        let mut found: Vec<(usize, f64)> = (0..keys.len())
            .map(|key| (key, correlation(key)))
            .filter(|(_, correlation)| correlation.abs() >= CORRELATION_MIN)
            .collect();
        found.sort_by(|one, other| other.1.abs().total_cmp(&one.1.abs()));
        found.truncate(NAMED);
        let first = found.first()?.0;
        let stride = runs.len().div_ceil(DRAWN).max(1);
        let drawn = runs.iter().step_by(stride);
        let drawn = drawn.map(|(keys, value)| (keys[first], *value));
        let worst = self.worst[name].iter();
        let worst = worst.map(|one| (one.case, self.cases.values(one.case)[first], one.value));
        Some(Driven {
            name: name.to_owned(),
            limit: self.limits.get(name).copied(),
            keys: found
                .iter()
                .map(|(key, correlation)| (keys[*key].to_owned(), *correlation))
                .collect(),
            sample: drawn.filter(|(_, value)| value.is_finite()).collect(),
            worst: worst.collect(),
            of: runs.len(),
        })
    }
}

/// Returns a place beyond the limit, for a value that was not reached.
fn beyond(limit: Limit) -> f64 {
    match limit.max {
        Some(_) => f64::INFINITY,
        None => f64::NEG_INFINITY,
    }
}

/// The end of a limit that a value is beyond, or nearest to.
pub(super) fn nearest_end(limit: Limit, value: f64) -> Limit {
    let (max, min) = (Limit { min: None, ..limit }, Limit { max: None, ..limit });
    if max.margin(value) <= min.margin(value) {
        max
    } else {
        min
    }
}

/// Mixes the number of a case, so that no order remains and a sample does not fall in step with a grid (the finaliser of
/// SplitMix64).
fn mixed(case: usize) -> u64 {
    let mut number = (case as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    number = (number ^ (number >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    number = (number ^ (number >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    number ^ (number >> 31)
}

/// Returns the rank of each value; equal ones share the middle of their ranks.
fn ranks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let values: Vec<f64> = values.collect();
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_unstable_by(|one, other| values[*one].total_cmp(&values[*other]));
    let mut ranks = vec![0.0; values.len()];
    let mut before = 0;
    for equal in order.chunk_by(|one, next| values[*one] == values[*next]) {
        let rank = before as f64 + (equal.len() as f64 - 1.0) / 2.0;
        for place in equal {
            ranks[*place] = rank;
        }
        before += equal.len();
    }
    ranks
}

/// Returns Pearson's correlation; 0 if one of them does not vary.
fn correlation(one: &[f64], other: &[f64]) -> f64 {
    let count = one.len().max(1) as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / count;
    let (mean_one, mean_other) = (mean(one), mean(other));
    let (mut both, mut square_one, mut square_other) = (0.0, 0.0, 0.0);
    for (one, other) in one.iter().zip(other) {
        let (one, other) = (one - mean_one, other - mean_other);
        both += one * other;
        square_one += one * one;
        square_other += other * other;
    }
    let scale = (square_one * square_other).sqrt();
    if scale > 0.0 { both / scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_values_share_their_rank() {
        let values = [3.0, 1.0, 3.0, f64::INFINITY, 3.0];
        assert_eq!(ranks(values.into_iter()), [2.0, 0.0, 2.0, 4.0, 2.0]);
    }

    #[test]
    fn what_follows_in_any_way_correlates_fully_and_chance_does_not() {
        let key: Vec<f64> = (0..1000).map(f64::from).collect();
        let of = |value: &dyn Fn(f64) -> f64| {
            let values = ranks(key.iter().map(|key| value(*key)));
            correlation(&ranks(key.iter().copied()), &values)
        };
        assert!((of(&|key| key * key * key) - 1.0).abs() < 1e-12);
        assert!((of(&|key| -key) + 1.0).abs() < 1e-12);
        assert_eq!(of(&|_| 7.0), 0.0);
        // Compared with scipy.stats.spearmanr([1, 2, 3, 4, 5], [5, 6, 7, 8, 7]).
        let [one, other] =
            [[1., 2., 3., 4., 5.], [5., 6., 7., 8., 7.]].map(|one| ranks(one.into_iter()));
        assert!((correlation(&one, &other) - 0.820_782_681_668_123_3).abs() < 1e-12);
        let mut chance: Vec<(u64, f64)> = (1..)
            .zip(&key)
            .map(|(number, key)| (mixed(number), *key))
            .collect();
        chance.sort_unstable_by_key(|one| one.0);
        let chance = correlation(&key, &Vec::from_iter(chance.into_iter().map(|one| one.1)));
        assert!(chance.abs() < CORRELATION_MIN, "{chance}");
    }

    #[test]
    fn the_worst_are_the_farthest_beyond_a_limit() {
        let limit = Limit {
            min: Some(0.0),
            max: Some(10.0),
        };
        let order = [12.0, -1.5, 9.5, 0.7, 5.0].map(|value| -limit.margin(value));
        assert!(order.windows(2).all(|pair| pair[0] > pair[1]), "{order:?}");
        assert_eq!(-limit.margin(beyond(limit)), f64::INFINITY);
        let ends = [9.5, 0.7].map(|value| nearest_end(limit, value));
        assert_eq!(
            ends.map(|end| (end.min, end.max)),
            [(None, Some(10.0)), (Some(0.0), None)]
        );
    }
}
