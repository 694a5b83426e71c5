//! What a run came to: metrics beside their limits, and the outcome.

use scenario::Scenario;
use scenario::expect::{Limit, Requirements};
use serde::{Deserialize, Serialize};

use crate::exit::Exit;
use crate::external::External;
use crate::timing::Timing;

/// How a run ended.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Every limit was met.
    Pass,
    /// A limit was not met.
    Fail,
    /// The recording is not good enough to decide.
    Inconclusive,
    /// The run broke off; written before it starts and replaced when it has been judged.
    Incomplete,
}

impl Outcome {
    /// The exit code of this outcome.
    #[must_use]
    pub fn exit(self) -> Exit {
        match self {
            Self::Pass => Exit::Pass,
            Self::Fail => Exit::VerdictFailed,
            Self::Inconclusive => Exit::Inconclusive,
            Self::Incomplete => Exit::BenchFailed,
        }
    }

    /// The word that people read.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::Inconclusive => "inconclusive",
            Self::Incomplete => "incomplete",
        }
    }
}

/// One metric.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Metric {
    /// Its key in `[expect]`, or what a check demands; the unit is in the name.
    pub name: String,
    /// The measured value; none where the run does not have it (no step, never settled).
    pub value: Option<f64>,
    /// When it was so, in scenario time; for checks of signals only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_seconds: Option<f64>,
    /// Why there is no value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remark: Option<String>,
    /// Its limit; none where it is only reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<Limit>,
    /// Whether the limit is met; none where there is no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub passed: Option<bool>,
    /// The requirements that it tests.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub requirements: Requirements,
}

impl Metric {
    /// Holds a value against its limit. Without a value a limit is not met.
    #[must_use]
    pub fn new(name: impl Into<String>, value: Result<f64, String>, limit: Option<Limit>) -> Self {
        let passed = limit.map(|limit| value.as_ref().is_ok_and(|value| meets(*value, limit)));
        let (value, remark) = match value {
            Ok(value) => (Some(rounded(value)), None),
            Err(remark) => (None, Some(remark)),
        };
        Self {
            name: name.into(),
            value,
            at_seconds: None,
            remark,
            limit,
            passed,
            requirements: Requirements::new(),
        }
    }

    /// A metric that this bus does not tell: its limit is neither met nor missed.
    #[must_use]
    pub fn not_judged(name: impl Into<String>, reason: String, limit: Option<Limit>) -> Self {
        Self {
            name: name.into(),
            value: None,
            at_seconds: None,
            remark: Some(reason),
            limit,
            passed: None,
            requirements: Requirements::new(),
        }
    }

    /// The same metric with the time at which it was so.
    #[must_use]
    pub fn at(self, seconds: Option<f64>) -> Self {
        Self {
            at_seconds: seconds.map(rounded),
            ..self
        }
    }
}

/// What a metric is called, for people: a key as words, the name of a check as it is.
#[must_use]
pub fn title(name: &str) -> String {
    match name.contains(' ') {
        true => name.to_owned(),
        false => name.replace('_', " "),
    }
}

fn meets(value: f64, limit: Limit) -> bool {
    let value = rounded(value);
    limit.min.is_none_or(|min| value >= min) && limit.max.is_none_or(|max| value <= max)
}

/// Six decimals: more than any metric is known to, and the same text on every machine.
pub(crate) fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// The verdict of one run, as `verdict.json` holds it, whichever version wrote it.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Verdict {
    /// Version of this file's format.
    pub schema: u32,
    /// The scenario's name.
    pub scenario: String,
    /// The program's version.
    pub version: String,
    /// The scenario's seed.
    pub seed: u64,
    /// The requirements that the scenario as a whole tests.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub requirements: Requirements,
    /// The nodes that were not canrig's.
    #[serde(default, skip_serializing_if = "External::is_empty")]
    pub external: External,
    /// How the run ended.
    pub outcome: Outcome,
    /// Why, where the metrics do not tell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Frames that the recorder lost: the one thing that the frames of a recording do not tell.
    #[serde(default, skip_serializing_if = "is_none_lost")]
    pub frames_lost: u64,
    /// All metrics that the run has or the scenario limits.
    pub metrics: Vec<Metric>,
    /// Losses and emergencies of the run, the first of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub losses: Vec<String>,
    /// How well the deadlines were kept; none in virtual time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timing: Option<Timing>,
}

impl Verdict {
    /// The verdict before a run: what a reader finds when the run breaks off.
    #[must_use]
    pub fn incomplete(scenario: &str, seed: u64, reason: &str) -> Self {
        Self {
            schema: 1,
            scenario: scenario.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            seed,
            requirements: Requirements::new(),
            external: External::default(),
            outcome: Outcome::Incomplete,
            reason: Some(reason.to_owned()),
            frames_lost: 0,
            metrics: Vec::new(),
            losses: Vec::new(),
            timing: None,
        }
    }

    /// As [`Verdict::incomplete`], of a scenario with its requirements.
    #[must_use]
    pub fn incomplete_of(scenario: &Scenario, reason: &str) -> Self {
        Self {
            requirements: scenario.requirements.clone(),
            ..Self::incomplete(&scenario.name, scenario.seed, reason)
        }
    }

    /// Reads the text of `verdict.json`.
    ///
    /// # Errors
    /// The text is no verdict.
    pub fn from_json(text: &str) -> serde_json::Result<Self> {
        serde_json::from_str(text)
    }

    /// The text of `verdict.json`.
    ///
    /// # Panics
    /// Never: the verdict has no map with keys other than strings.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text
    }
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_none_lost(frames: &u64) -> bool {
    *frames == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::external::ExternalNode;

    #[test]
    fn a_stored_verdict_reads_back_whole() {
        let mut verdict = Verdict::incomplete("step \"1\"", 7, "killed");
        verdict.frames_lost = 3;
        verdict.requirements = vec!["REQ-1".to_owned()];
        verdict.external = External::new(&[ExternalNode::Drive]).unwrap();
        let limit = Some(Limit {
            min: Some(0.1),
            max: None,
        });
        verdict.metrics = vec![
            Metric::new("settling_time_seconds", Ok(0.2), limit),
            Metric::new("overshoot_percent", Err("no step".to_owned()), None).at(Some(1.5)),
            Metric::not_judged("temperature_celsius", "not available".to_owned(), limit),
        ];
        verdict.metrics[0].requirements = vec!["REQ-2".to_owned()];
        assert_eq!(Verdict::from_json(&verdict.to_json()).unwrap(), verdict);
        assert!(Verdict::from_json("{}").is_err());
    }

    /// What a version wrote before there were requirements, losses and external nodes.
    #[test]
    fn a_verdict_of_an_earlier_version_reads_back() {
        let text = r#"{ "schema": 1, "scenario": "step", "version": "0.0.1", "seed": 1, "outcome": "pass",
            "metrics": [{ "name": "overshoot_percent", "value": null }] }"#;
        let verdict = Verdict::from_json(text).unwrap();
        let expected = Verdict {
            version: "0.0.1".to_owned(),
            outcome: Outcome::Pass,
            reason: None,
            metrics: vec![Metric {
                remark: None,
                ..Metric::new("overshoot_percent", Err(String::new()), None)
            }],
            ..Verdict::incomplete("step", 1, "")
        };
        assert_eq!(verdict, expected);
    }

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
