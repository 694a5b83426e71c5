//! The `[sweep]` table: many scenarios of one. Lists and ranges span a grid; at each of its points a number of sets of values is
//! drawn.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Largest number of runs of a sweep.
pub const RUNS_MAX: u64 = 1_000_000;
/// Significant decimals of a range's values: 0.1, 0.2, 0.3 rather than 0.30000000000000004.
const RANGE_DECIMALS: usize = 11;
/// Largest distance of the last step from the end of a range, in steps, at which the end is a value of the range.
const STEP_TOLERANCE: f64 = 1e-9;

/// Numbers that `canrig sweep` varies. A key is a dotted path to a number of the scenario, such as
/// `plant.mechanics.load_kilograms` or `reference.step[0].position_millimetres`.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sweep {
    /// Seed of the draws. Each key has its own stream, so one more key changes no other's numbers.
    #[schemars(range(min = 0, max = 9_007_199_254_740_991_u64))]
    pub seed: u64,
    /// Number of sets of values that are drawn; each is played at each point of the grid.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 1_000_000))]
    pub draws: Option<u32>,
    /// Keys that take each value of a list. Lists and ranges span a grid, in this order; the last varies fastest.
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub list: Vec<List>,
    /// Keys that go from one value to another.
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub range: Vec<Range>,
    /// Keys that are drawn with the same probability between two values.
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub uniform: Vec<Uniform>,
    /// Keys whose logarithm is drawn with the same probability between those of two values.
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub log_uniform: Vec<LogUniform>,
    /// Keys that are drawn from a normal distribution. It has no ends: a draw that the key does not admit is not played,
    /// but reported as `invalid`.
    #[schemars(length(max = 100))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub normal: Vec<Normal>,
    /// Keys that take whole numbers only, put in by the loader.
    #[serde(skip)]
    pub whole_numbers: BTreeSet<String>,
}

/// A key that takes each of some values.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct List {
    /// The key that varies.
    #[schemars(length(min = 1, max = 200))]
    pub key: String,
    /// Its values, each once.
    #[schemars(length(min = 1, max = 100_000))]
    pub values: Vec<f64>,
}

/// A key that goes from one value to another, both included.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// The key that varies.
    #[schemars(length(min = 1, max = 200))]
    pub key: String,
    /// The first value.
    pub from: f64,
    /// The last value, above the first.
    pub to: f64,
    /// Number of values; give either this or `step`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 2, max = 100_000))]
    pub count: Option<u32>,
    /// Distance between two values; give either this or `count`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub step: Option<f64>,
    /// Spacing of the values; `linear` if absent. A logarithmic range has `count`, not `step`.
    #[serde(default)]
    pub spacing: Spacing,
}

/// Spacing of the values of a range.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Spacing {
    /// The same difference from each to the next.
    #[default]
    Linear,
    /// The same ratio of each to the next; both ends are above 0.
    Logarithmic,
}

/// A key that is drawn between two values.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Uniform {
    /// The key that varies.
    #[schemars(length(min = 1, max = 200))]
    pub key: String,
    /// Smallest value of the draws.
    pub from: f64,
    /// Largest value of the draws.
    pub to: f64,
}

/// A key that is drawn between two values by its logarithm.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LogUniform {
    /// The key that varies.
    #[schemars(length(min = 1, max = 200))]
    pub key: String,
    /// Smallest value of the draws.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub from: f64,
    /// Largest value of the draws.
    pub to: f64,
}

/// A key that is drawn from a normal distribution.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Normal {
    /// The key that varies.
    #[schemars(length(min = 1, max = 200))]
    pub key: String,
    /// Mean of the distribution.
    pub mean: f64,
    /// Standard deviation of the distribution.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub standard_deviation: f64,
}

/// Distribution of a number that is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distribution<'a> {
    /// The same probability between two values.
    Uniform(&'a Uniform),
    /// The same probability between the logarithms of two values.
    LogUniform(&'a LogUniform),
    /// A normal distribution.
    Normal(&'a Normal),
}

impl<'a> Distribution<'a> {
    /// Returns the key that varies.
    pub fn key(self) -> &'a str {
        match self {
            Self::Uniform(one) => &one.key,
            Self::LogUniform(one) => &one.key,
            Self::Normal(one) => &one.key,
        }
    }
}

impl Range {
    /// Returns the values; none if neither `count` nor `step` is given.
    pub fn values(&self) -> Vec<f64> {
        let last = self.last();
        let value = |place: u32| match (self.spacing, self.step) {
            // The end as written, not as computed.
            _ if place == last && self.step.is_none() => self.to,
            (Spacing::Linear, Some(step)) => self.from + f64::from(place) * step,
            (Spacing::Linear, None) => {
                self.from + (self.to - self.from) * f64::from(place) / f64::from(last)
            }
            (Spacing::Logarithmic, _) => {
                let part = f64::from(place) / f64::from(last);
                self.from * libm::pow(self.to / self.from, part)
            }
        };
        (0..=last).map(|place| rounded(value(place))).collect()
    }

    /// Returns the index of the last value.
    fn last(&self) -> u32 {
        let steps = match (self.count, self.step) {
            (Some(count), _) => return count.saturating_sub(1),
            (None, Some(step)) => libm::floor((self.to - self.from) / step + STEP_TOLERANCE),
            (None, None) => 0.0,
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to what a sweep may have"
        )]
        let steps = steps.clamp(0.0, RUNS_MAX as f64) as u32;
        steps
    }
}

/// Rounds a value to more digits than users write.
fn rounded(value: f64) -> f64 {
    format!("{value:.RANGE_DECIMALS$e}")
        .parse()
        .unwrap_or(value)
}

impl Sweep {
    /// Returns the axes of the grid: the lists, then the ranges as lists.
    pub fn axes(&self) -> Vec<List> {
        let ranges = self.range.iter().map(|range| List {
            key: range.key.clone(),
            values: range.values(),
        });
        self.list.iter().cloned().chain(ranges).collect()
    }

    /// Returns the distributions of the keys that are drawn.
    pub fn distributions(&self) -> impl Iterator<Item = Distribution<'_>> {
        let uniform = self.uniform.iter().map(Distribution::Uniform);
        let log_uniform = self.log_uniform.iter().map(Distribution::LogUniform);
        let normal = self.normal.iter().map(Distribution::Normal);
        uniform.chain(log_uniform).chain(normal)
    }

    /// Returns the number of runs: points of the grid times draws.
    pub fn runs(&self) -> u64 {
        let lists = self.list.iter().map(|list| list.values.len() as u64);
        let ranges = self.range.iter().map(|one| u64::from(one.last()) + 1);
        let draws = u64::from(self.draws.unwrap_or(1));
        lists.chain(ranges).fold(draws, u64::saturating_mul)
    }

    /// Returns the keys that vary: those of the grid, then those that are drawn.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        let lists = self.list.iter().map(|list| list.key.as_str());
        let ranges = self.range.iter().map(|range| range.key.as_str());
        let drawn = self.distributions().map(Distribution::key);
        lists.chain(ranges).chain(drawn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(text: &str) -> Vec<f64> {
        let range: Range = toml::from_str(&format!("key = \"k\"\n{text}")).unwrap();
        range.values()
    }

    #[test]
    fn a_range_has_both_ends_and_round_values() {
        let linear = range("from = 0.1\nto = 0.5\ncount = 5");
        assert_eq!(linear, [0.1, 0.2, 0.3, 0.4, 0.5]);
        assert_eq!(range("from = 0.1\nto = 0.5\nstep = 0.1"), linear);
        assert_eq!(range("from = 1\nto = 2\nstep = 0.3"), [1.0, 1.3, 1.6, 1.9]);
        let logarithmic = "from = 1e-3\nto = 10\ncount = 5\nspacing = \"logarithmic\"";
        assert_eq!(range(logarithmic), [0.001, 0.01, 0.1, 1.0, 10.0]);
    }

    #[test]
    fn runs_are_points_times_draws_and_never_overflow() {
        let list = List {
            key: "k".to_owned(),
            values: vec![0.0; 100_000],
        };
        let mut sweep = Sweep {
            list: vec![list; 100],
            ..Sweep::default()
        };
        assert_eq!(sweep.runs(), u64::MAX);
        sweep.list.truncate(1);
        sweep.draws = Some(3);
        assert_eq!(sweep.runs(), 300_000);
    }
}
