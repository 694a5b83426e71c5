//! A row of a verdict: a value and its limit.

use scenario::expect::{Limit, Requirements, rounded};
use serde::{Deserialize, Serialize};

/// Fact of a run that was just judged. A stored verdict does not have it, so it makes no difference
/// between the two.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unstored(pub bool);

impl PartialEq for Unstored {
    fn eq(&self, _other: &Self) -> bool {
        true
    }
}

/// Row of a verdict: a metric, or a check of a signal or a sequence.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Metric {
    /// Key in `[expect]`, or the demand of a check; the unit is in the name.
    pub name: String,
    /// Measured value; `None` if the run does not have it (no step, never settled).
    pub value: Option<f64>,
    /// Time of the value, in scenario time; for checks of signals, and if one of several sines decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_seconds: Option<f64>,
    /// Reason why there is no value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remark: Option<String>,
    /// Limit; `None` if the metric is only reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<Limit>,
    /// Whether the limit is met; `None` without a limit, and if the limit is not judged.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub passed: Option<bool>,
    /// Requirements that the metric tests.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub requirements: Requirements,
    /// Whether no node on the bus sends the value, so that no other play has it either.
    #[serde(skip)]
    pub is_unavailable: Unstored,
}

impl Metric {
    /// Checks a value against its limit. Without a value a limit is not met.
    pub fn new(name: impl Into<String>, value: Result<f64, String>, limit: Option<Limit>) -> Self {
        let (value, remark) = match value {
            Ok(value) => (Some(rounded(value)), None),
            Err(remark) => (None, Some(remark)),
        };
        let passed = limit.map(|limit| value.is_some_and(|value| limit.admits(value)));
        Self {
            name: name.into(),
            value,
            at_seconds: None,
            remark,
            limit,
            passed,
            requirements: Requirements::new(),
            is_unavailable: Unstored(false),
        }
    }

    /// Returns a metric that no node on this bus sends: its limit is neither met nor missed.
    pub fn not_judged(name: impl Into<String>, reason: String, limit: Option<Limit>) -> Self {
        Self {
            passed: None,
            ..Self::new(name, Err(reason), limit)
        }
    }

    /// Adds the time of the value.
    #[must_use]
    pub fn at(self, seconds: Option<f64>) -> Self {
        Self {
            at_seconds: seconds.map(rounded),
            ..self
        }
    }
}

/// Makes a limit neither met nor missed.
pub(crate) fn leave_open(row: &mut Metric) {
    row.passed = None;
}

/// Returns the reason why a run cannot pass: limits on values that no node on the bus sends.
pub(crate) fn not_judged(metrics: &[Metric]) -> Option<String> {
    let undecided = |metric: &&Metric| metric.limit.is_some() && metric.passed.is_none();
    let undecided = metrics.iter().filter(undecided);
    let names: Vec<&str> = undecided.map(|metric| metric.name.as_str()).collect();
    (!names.is_empty()).then(|| format!("not judged: {}", names.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_two_sided_and_inclusive() {
        let limit = Some(Limit {
            min: Some(0.1),
            max: Some(0.23),
        });
        let passed = |value| Metric::new("settling_time_seconds", value, limit).passed;
        assert_eq!(passed(Ok(0.23)), Some(true));
        assert_eq!(passed(Ok(0.230_001)), Some(false));
        assert_eq!(passed(Ok(0.05)), Some(false));
        assert_eq!(passed(Ok(f64::NAN)), Some(false));
        assert_eq!(passed(Err("never settled".to_owned())), Some(false));
        assert_eq!(Metric::new("overshoot_percent", Ok(1.0), None).passed, None);
    }
}
