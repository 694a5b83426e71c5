//! A number with the paper's value and its target.

use scenario::expect::{self, Limit};
use serde::Serialize;

use judge::verdict::{Metric, Outcome, Verdict};

/// One number of the reproduction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantity {
    /// Run of the number: the control law, or another distinction from other runs.
    pub of: String,
    /// Value in the paper, as printed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paper: Option<&'static str>,
    /// Relation of the law's model to the plant, if the law has a model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<Model>,
    /// Measured value, its target, and whether the target is met.
    pub metric: Metric,
}

/// Relation of a law's nominal model to the plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// The model has every number of the plant.
    EqualsThePlant,
    /// The model has other numbers, or the plant is of another kind.
    Differs,
}

impl Model {
    /// Returns the text for a table.
    pub fn word(self) -> &'static str {
        match self {
            Self::EqualsThePlant => "=\u{a0}plant",
            Self::Differs => "≠\u{a0}plant",
        }
    }
}

/// Values in the paper, by name of the metric.
pub type Paper = [(&'static str, &'static str)];

impl Quantity {
    /// Makes a number that is computed from several runs.
    pub fn derived(
        name: &'static str,
        of: impl Into<String>,
        value: Result<f64, String>,
        target: Option<Limit>,
    ) -> Self {
        Self {
            of: of.into(),
            paper: None,
            model: None,
            metric: Metric::new(name, value, target),
        }
    }

    /// Adds the paper's value.
    #[must_use]
    pub fn beside(self, paper: &'static str) -> Self {
        Self {
            paper: Some(paper),
            ..self
        }
    }

    /// Adds the relation of the law's model to the plant.
    #[must_use]
    pub fn with_model(self, model: Option<Model>) -> Self {
        Self { model, ..self }
    }

    /// Returns these metrics of a verdict, in this order; metrics that the run lacks are left out. In a run without a
    /// decision no limit is met.
    pub fn from_verdict(of: &str, verdict: &Verdict, metrics: &[&str], paper: &Paper) -> Vec<Self> {
        let find = |name: &&str| verdict.metrics.iter().find(|metric| metric.name == *name);
        let is_decided = matches!(verdict.outcome, Outcome::Pass | Outcome::Fail);
        let number = |metric: &Metric| {
            let mut metric = metric.clone();
            metric.passed = metric.passed.map(|passed| passed && is_decided);
            let paper = paper.iter().find(|(name, _)| *name == metric.name);
            Self {
                of: of.to_owned(),
                paper: paper.map(|(_, text)| *text),
                model: None,
                metric,
            }
        };
        metrics.iter().filter_map(find).map(number).collect()
    }

    /// Returns the name of the quantity, which has its unit.
    pub fn name(&self) -> &str {
        &self.metric.name
    }

    /// Returns whether the number has a value in the paper or a target.
    pub fn is_compared(&self) -> bool {
        self.paper.is_some() || self.metric.limit.is_some()
    }

    /// Returns whether no target is missed.
    pub fn holds(&self) -> bool {
        self.metric.passed != Some(false)
    }
}

/// Returns an upper limit.
pub fn at_most(max: f64) -> Option<Limit> {
    Some(expect::at_most(max))
}

/// Returns a lower limit.
pub fn at_least(min: f64) -> Option<Limit> {
    Some(Limit {
        min: Some(min),
        max: None,
    })
}

/// Returns limits on both sides of a value, at a relative distance.
pub fn within(value: f64, part: f64) -> Option<Limit> {
    // Metrics have six decimals as well.
    let rounded = |value: f64| (value * 1e6).round() / 1e6;
    Some(Limit {
        min: Some(rounded(value * (1.0 - part))),
        max: Some(rounded(value * (1.0 + part))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_decides_nothing_meets_no_limit() {
        let mut verdict = Verdict::incomplete("step", 1, "cycles were missed");
        verdict.metrics = vec![
            Metric::new("overshoot_percent", Ok(0.1), at_most(0.6)),
            Metric::new("settling_time_seconds", Ok(0.2), None),
        ];
        let names = ["settling_time_seconds", "overshoot_percent", "sine_gain"];
        let paper = [("overshoot_percent", "0.6 %")];
        let numbers = |verdict: &Verdict| Quantity::from_verdict("pid", verdict, &names, &paper);
        let found = numbers(&verdict);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].is_compared(), found[0].holds()), (false, true));
        assert_eq!((found[1].paper, found[1].holds()), (Some("0.6 %"), false));
        verdict.outcome = Outcome::Pass;
        assert!(numbers(&verdict)[1].holds());
    }
}
