//! Results of one case that are kept.

use serde::{Deserialize, Serialize};

use judge::verdict::{Metric, Outcome, Verdict};
use runner::exit::Exit;

/// End of a case.
#[derive(Clone, Copy, Debug, Deserialize, Eq, Ord, PartialEq, PartialOrd, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// Every limit was met.
    Pass,
    /// The recording is not good enough to decide.
    Inconclusive,
    /// A limit was not met.
    Fail,
    /// The values of the case make no valid scenario, so it was not played.
    Invalid,
    /// The run broke off.
    Incomplete,
    /// The program itself could not bring the case to a verdict.
    InternalError,
}

impl Ended {
    /// Returns the outcome of a run that ends like this; one without a verdict is incomplete.
    pub fn outcome(self) -> Outcome {
        match self {
            Self::Pass => Outcome::Pass,
            Self::Inconclusive => Outcome::Inconclusive,
            Self::Fail => Outcome::Fail,
            Self::Invalid | Self::Incomplete | Self::InternalError => Outcome::Incomplete,
        }
    }

    /// Returns the name of the end in tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Inconclusive => "inconclusive",
            Self::Fail => "fail",
            Self::Invalid => "invalid",
            Self::Incomplete => "incomplete",
            Self::InternalError => "internal_error",
        }
    }

    /// Returns the exit code of a sweep whose worst case ends like this.
    pub fn exit(self) -> Exit {
        match self {
            Self::Invalid => Exit::CannotStart,
            Self::InternalError => Exit::Internal,
            judged => judged.outcome().into(),
        }
    }
}

impl From<Outcome> for Ended {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Pass => Self::Pass,
            Outcome::Fail => Self::Fail,
            Outcome::Inconclusive => Self::Inconclusive,
            Outcome::Incomplete => Self::Incomplete,
        }
    }
}

/// Completed case.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct SweepRow {
    /// Number of the case.
    pub case: usize,
    /// Hash of the case's content.
    pub id: String,
    /// Seed of the scenario; `None` if there is no scenario.
    pub seed: Option<u64>,
    /// End of the case.
    pub ended: Ended,
    /// Reason for that end, if the metrics do not show it.
    pub reason: Option<String>,
    /// Limits that were not met.
    pub missed: Vec<String>,
    /// Limits that could not be judged.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undecided: Vec<String>,
    /// Metrics that have a value.
    pub metrics: Vec<(String, f64)>,
}

impl SweepRow {
    /// Returns the row of a verdict.
    pub fn from_verdict(case: usize, id: &str, verdict: &Verdict) -> Self {
        let names = |is_named: fn(&Metric) -> bool| {
            let named = verdict.metrics.iter().filter(|one| is_named(one));
            named.map(|one| one.name.clone()).collect()
        };
        let metrics = verdict.metrics.iter();
        let metrics = metrics.filter_map(|one| Some((one.name.clone(), one.value?)));
        Self {
            case,
            id: id.to_owned(),
            seed: Some(verdict.seed),
            ended: verdict.outcome.into(),
            reason: verdict.reason.clone(),
            missed: names(|one| one.passed == Some(false)),
            undecided: names(|one| one.limit.is_some() && one.passed.is_none()),
            metrics: metrics.filter(|(_, value)| value.is_finite()).collect(),
        }
    }

    /// Returns the row of a case without a verdict.
    pub fn without_verdict(case: usize, id: &str, ended: Ended, reason: String) -> Self {
        Self {
            case,
            id: id.to_owned(),
            seed: None,
            ended,
            reason: Some(reason),
            missed: Vec::new(),
            undecided: Vec::new(),
            metrics: Vec::new(),
        }
    }

    /// Returns a metric's value.
    pub fn metric(&self, name: &str) -> Option<f64> {
        let metric = self.metrics.iter().find(|(known, _)| known == name);
        metric.map(|(_, value)| *value)
    }
}
