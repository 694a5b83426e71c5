//! Cases of a campaign, each known by its number alone.

use std::path::Path;

use plan::Plan;
use recording::capture::Watch;
use runner::exit::{Exit, Failure};
use scenario::expect::Limit;

use super::row::SweepRow;
use super::store::Rows;
use crate::campaign::caught;

/// Facts of a campaign, which are the same for all of its cases.
pub(crate) struct Facts {
    /// Kind of the campaign, "sweep" or "torture", from which its folders have their names.
    pub(crate) kind: &'static str,
    /// Plan of the scenario, with which the cases share the meaning of their frames.
    pub(crate) plan: Plan,
    /// Hash of everything that decides the cases, and of the version of the program.
    pub(crate) id: String,
    /// Seed of the drawn values.
    pub(crate) seed: u64,
    /// Number of cases, which are numbered from 1.
    pub(crate) runs: usize,
    /// Keys that vary, with descriptions of how they do.
    pub(crate) variations: Vec<(String, String)>,
    /// Limits by which the runs are judged.
    pub(crate) limits: Vec<(String, Limit)>,
    /// Criterion of the runs in place of the limits of the scenario, in sentences.
    pub(crate) criterion: Option<&'static str>,
    /// Files, by name and text, that a folder of the campaign has in addition to the scenario.
    pub(crate) files: Vec<(&'static str, String)>,
}

impl Facts {
    /// Returns the name of the scenario.
    pub(crate) fn name(&self) -> &str {
        &self.plan.shared.run.name
    }

    /// Returns the keys that vary.
    pub(crate) fn keys(&self) -> Vec<&str> {
        self.variations.iter().map(|(key, _)| &**key).collect()
    }
}

/// Cases of a sweep or of torture. Any of them may be played on any machine, in any order.
pub(crate) trait Cases: Sync {
    /// Facts of the campaign.
    fn facts(&self) -> &Facts;

    /// Values of the keys in a case.
    fn values(&self, number: usize) -> Vec<f64>;

    /// Scenario of a case, as a file of its own.
    fn text(&self, number: usize) -> String;

    /// Options with which `canrig simulate` plays a case on the scenario of the campaign; `None` if there are none that do.
    fn options(&self, _number: usize) -> Option<String> {
        None
    }

    /// Plays a case.
    ///
    /// # Errors
    /// The case has no result: the machine failed (`BenchFailed`) or the program (`Internal`).
    fn play(&self, number: usize, watch: &Watch) -> Result<SweepRow, Failure>;

    /// Row of a case in which the program itself is at fault.
    fn faulty(&self, number: usize, reason: String) -> SweepRow;

    /// Plays a case and returns its row, also of one in which the program is at fault.
    ///
    /// # Errors
    /// The machine could not play the run.
    fn row_of(&self, number: usize, watch: &Watch) -> Result<SweepRow, Failure> {
        caught(|| self.play(number, watch)).or_else(|failure| match failure.exit {
            // The panic hook of the program prints the panic; the row says in which case it happened.
            Exit::Internal => Ok(self.faulty(number, failure.reason)),
            Exit::BenchFailed => Err(Exit::BenchFailed.because(format!(
                "run {number} could not be played on this machine: {failure}. What is done is kept, that run is not: give the same command again"
            ))),
            _ => Err(failure),
        })
    }

    /// Keys and values of a case, as a text; `write` writes a value.
    fn values_text(&self, number: usize, write: fn(f64) -> String) -> String {
        let values = self.facts().keys().into_iter().zip(self.values(number));
        let texts = values.map(|(key, value)| format!("{key} = {}", write(value)));
        texts.collect::<Vec<_>>().join(", ")
    }

    /// Shows what the rows of a whole campaign have in addition to tables and page.
    ///
    /// # Errors
    /// It cannot be shown.
    fn show_more(&self, _rows: &Rows, _output: &Path) -> Result<(), Failure> {
        Ok(())
    }
}
