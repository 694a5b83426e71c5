//! Verdict of a run: metrics with their limits, and the outcome. `verdict.json` holds it.

use std::collections::BTreeMap;
use std::path::Path;

use plan::Plan;
use recording::ending::EarlyEnd;
use scenario::expect::Requirements;
use serde::{Deserialize, Serialize};

pub use crate::attribution::cause::NamedCause;
pub use crate::metric::{Metric, Unstored};
use crate::timing::Timing;

/// Outcome of a run, in the order of gravity: a failure counts more than an open result.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Every limit was met.
    Pass,
    /// The recording is not good enough to decide.
    Inconclusive,
    /// The run broke off. This outcome is written before the run starts, and replaced when the run has been judged.
    #[default]
    Incomplete,
    /// A limit was not met.
    Fail,
}

impl Outcome {
    /// Returns the word for the outcome in messages and reports.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::Inconclusive => "inconclusive",
            Self::Incomplete => "incomplete",
        }
    }
}

/// Program, plant, law and files of a run. Two runs with equal identities are the same; any difference makes another run.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq, Serialize)]
pub struct Identity {
    /// The build ID of the program, or the SHA-256 of its file where the linker left none.
    pub program: String,
    pub plant: String,
    pub law: String,
    /// SHA-256 of each file that was played, by its name in the run folder.
    pub files: BTreeMap<String, String>,
}

/// Verdict of a run, as `verdict.json` holds it, from any version of the program.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct Verdict {
    /// Version of this file's format.
    pub schema: u32,
    pub scenario: String,
    /// Version of the program.
    pub version: String,
    pub seed: u64,
    /// Identity of the run; `None` for older runs, and for a run without a folder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identity: Option<Identity>,
    /// Requirements that the scenario as a whole tests.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub requirements: Requirements,
    /// Names of the external nodes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub external: Vec<String>,
    pub outcome: Outcome,
    /// Reason for the outcome, if the metrics do not show it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Cause that kept the run from passing; `None` if it passed, or missed a limit while every node did its duties.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<NamedCause>,
    /// Number of frames that the recorder lost, which the frames of a recording do not show.
    #[serde(default, skip_serializing_if = "is_none")]
    pub frames_lost: u64,
    /// Number of CAN FD frames that were on the bus. Only their number is recorded.
    #[serde(default, skip_serializing_if = "is_none")]
    pub fd_frames: u64,
    /// End of the run before its scenario's end, with the reason; `None` if the run was played to its end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_early: Option<EarlyEnd>,
    /// All metrics that the run has or the scenario limits.
    pub metrics: Vec<Metric>,
    /// First losses and emergencies of the run.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub losses: Vec<String>,
    /// Timing of the run; `None` in virtual time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timing: Option<Timing>,
    /// Plays of the scenario before this one; `None` if it was played once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tries: Option<Tries>,
    /// Whether only stalls keep a run from being decided.
    #[serde(skip)]
    pub is_open_for_stalls: Unstored,
    /// Whether a node under test broke a duty that neither a stall nor a fault explains.
    #[serde(skip)]
    pub has_unexplained_breach: Unstored,
}

/// Plays of a scenario, since stalls of the computer spoiled the first ones.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Tries {
    /// Number of this play, from 1.
    pub number: u32,
    /// Largest number of plays.
    pub max: u32,
    /// Plays before this one, in their order.
    pub earlier: Vec<SpoiledPlay>,
}

/// Play that stalls of the computer spoiled.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct SpoiledPlay {
    /// Reason why it decides nothing.
    pub reason: String,
    /// Values beyond their limits.
    pub beyond: Vec<Metric>,
    /// Name of its run folder.
    pub folder: String,
}

impl SpoiledPlay {
    /// Returns the play of a verdict.
    pub fn new(verdict: &Verdict, folder: &Path) -> Self {
        let is_beyond = |row: &&Metric| {
            let judged = row.value.zip(row.limit);
            judged.is_some_and(|(value, limit)| !limit.admits(value))
        };
        let name = folder.file_name().unwrap_or_default();
        Self {
            reason: verdict.reason.clone().unwrap_or_default(),
            beyond: verdict.metrics.iter().filter(is_beyond).cloned().collect(),
            folder: name.to_string_lossy().into_owned(),
        }
    }
}

impl Verdict {
    /// Returns the verdict before a run, which a reader finds if the run breaks off.
    pub fn incomplete(scenario: &str, seed: u64, reason: &str) -> Self {
        Self {
            schema: 1,
            scenario: scenario.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            seed,
            reason: Some(reason.to_owned()),
            ..Self::default()
        }
    }

    /// Returns the same as [`Verdict::incomplete`], for a plan with its requirements and external nodes.
    pub fn incomplete_run(plan: &Plan, reason: &str) -> Self {
        let shared = &plan.shared;
        Self {
            requirements: shared.run.requirements.clone(),
            external: plan.external_names(),
            ..Self::incomplete(&shared.run.name, shared.run.seed, reason)
        }
    }

    /// Returns whether stalls of the computer alone spoiled the run: it is inconclusive for no
    /// other reason, and every breach of a node under test is explained. Another play may decide
    /// it. Only a verdict that was just judged knows this.
    pub fn is_spoiled_by_stalls(&self) -> bool {
        self.outcome == Outcome::Inconclusive
            && self.is_open_for_stalls.0
            && !self.has_unexplained_breach.0
    }

    /// Returns whether the run passed although nothing was limited.
    pub fn judged_nothing(&self) -> bool {
        self.outcome == Outcome::Pass && self.metrics.iter().all(|metric| metric.limit.is_none())
    }

    /// Returns the text that belongs next to the outcome: its reason, or a warning on a run that passed.
    pub fn remark(&self) -> Option<String> {
        let nothing = "nothing was limited, so nothing was judged";
        let is_distrusted = |timing: &Timing| !timing.distrust.is_empty();
        let distrusted = self.timing.as_ref().is_some_and(is_distrusted);
        let remarks = [
            self.judged_nothing().then_some(nothing),
            distrusted.then_some("the timing is not trusted"),
        ];
        let remarks = Vec::from_iter(remarks.into_iter().flatten()).join("; ");
        let passes_with_remarks = self.outcome == Outcome::Pass && !remarks.is_empty();
        self.reason
            .clone()
            .or_else(|| passes_with_remarks.then_some(remarks))
    }

    /// Reads the text of `verdict.json`.
    ///
    /// # Errors
    /// The text is not a verdict.
    pub fn from_json(text: &str) -> serde_json::Result<Self> {
        serde_json::from_str(text)
    }

    /// Returns the text of `verdict.json`.
    ///
    /// # Panics
    /// Never: the verdict has no map with keys other than strings.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text
    }
}

fn is_none(frames: &u64) -> bool {
    *frames == 0
}

#[cfg(test)]
mod tests {
    use scenario::expect::Limit;

    use super::*;

    #[test]
    fn a_stored_verdict_reads_back_whole() {
        let mut verdict = Verdict::incomplete("step \"1\"", 7, "killed");
        (verdict.frames_lost, verdict.fd_frames) = (3, 4);
        verdict.requirements = vec!["REQ-1".to_owned()];
        verdict.identity = Some(Identity {
            program: "1f".to_owned(),
            plant: "sma_actuator".to_owned(),
            law: "pid".to_owned(),
            files: [("scenario.toml".to_owned(), "2e".to_owned())].into(),
        });
        verdict.external = vec!["drive".to_owned()];
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
        verdict.tries = Some(Tries {
            number: 2,
            max: 3,
            earlier: vec![SpoiledPlay::new(&verdict, Path::new("runs/step"))],
        });
        // These are not stored, and a replay compares the rest.
        verdict.is_open_for_stalls = Unstored(true);
        verdict.has_unexplained_breach = Unstored(true);
        verdict.metrics[2].is_unavailable = Unstored(true);
        assert_eq!(Verdict::from_json(&verdict.to_json()).unwrap(), verdict);
        assert!(Verdict::from_json("{}").is_err());
    }

    #[test]
    fn a_verdict_names_scenario_seed_requirements_and_foreign_nodes() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"step\"\nseed = 7\nduration_seconds = 1.0\nrequirements = [\"REQ-1\"]\n\
            [controller.pid]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        let plan = testing::plan(text)
            .with_external(&["drive".to_owned()])
            .unwrap();
        let expected = Verdict {
            requirements: vec!["REQ-1".to_owned()],
            external: vec!["drive".to_owned()],
            ..Verdict::incomplete("step", 7, "killed")
        };
        assert_eq!(Verdict::incomplete_run(&plan, "killed"), expected);
    }

    /// A version wrote this before there were requirements, losses and external nodes.
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
}
