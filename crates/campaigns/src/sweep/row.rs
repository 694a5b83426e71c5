//! What is kept of one case.

use serde::{Deserialize, Serialize};

use judge::verdict::{Outcome, Verdict};
use runner::exit::Exit;

/// How a case ended.
#[derive(Clone, Copy, Debug, Deserialize, Eq, Ord, PartialEq, PartialOrd, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// Every limit was met.
    Pass,
    /// The recording is not good enough to decide.
    Inconclusive,
    /// A limit was not met.
    Fail,
    /// Its values make no valid scenario, so it was not played.
    Invalid,
    /// The run broke off.
    Incomplete,
    /// The program itself could not bring it to a verdict.
    InternalError,
}

impl Ended {
    /// All of them, from best to worst.
    pub const ALL: [Self; 6] = [
        Self::Pass,
        Self::Inconclusive,
        Self::Fail,
        Self::Invalid,
        Self::Incomplete,
        Self::InternalError,
    ];

    /// Its name in tables.
    #[must_use]
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

    /// The exit code of a sweep whose worst case ends so.
    #[must_use]
    pub fn exit(self) -> Exit {
        match self {
            Self::Pass => Exit::Pass,
            Self::Inconclusive => Exit::Inconclusive,
            Self::Fail => Exit::VerdictFailed,
            Self::Invalid => Exit::CannotStart,
            Self::Incomplete => Exit::BenchFailed,
            Self::InternalError => Exit::Internal,
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

/// One case that is done.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct SweepRow {
    /// Its number.
    pub case: usize,
    /// What names its content.
    pub id: String,
    /// The scenario's seed; none where there is no scenario.
    pub seed: Option<u64>,
    /// How it ended.
    pub ended: Ended,
    /// Why, where the metrics do not show it.
    pub reason: Option<String>,
    /// The limits that were not met.
    pub missed: Vec<String>,
    /// The limits that could not be judged.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undecided: Vec<String>,
    /// The metrics that have a value.
    pub metrics: Vec<(String, f64)>,
}

impl SweepRow {
    /// What a verdict says.
    #[must_use]
    pub fn from_verdict(case: usize, id: &str, verdict: &Verdict) -> Self {
        let missed = verdict
            .metrics
            .iter()
            .filter(|one| one.passed == Some(false));
        let undecided = verdict
            .metrics
            .iter()
            .filter(|one| one.limit.is_some() && one.passed.is_none());
        let metrics = verdict
            .metrics
            .iter()
            .filter_map(|one| Some((one.name.clone(), one.value?)));
        Self {
            case,
            id: id.to_owned(),
            seed: Some(verdict.seed),
            ended: verdict.outcome.into(),
            reason: verdict.reason.clone(),
            missed: missed.map(|one| one.name.clone()).collect(),
            undecided: undecided.map(|one| one.name.clone()).collect(),
            metrics: metrics.filter(|(_, value)| value.is_finite()).collect(),
        }
    }

    /// A case without a verdict.
    #[must_use]
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

    /// A metric's value.
    #[must_use]
    pub fn metric(&self, name: &str) -> Option<f64> {
        let metric = self.metrics.iter().find(|(known, _)| known == name);
        metric.map(|(_, value)| *value)
    }
}
