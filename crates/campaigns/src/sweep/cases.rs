//! What a campaign plays: cases, each known by its number alone.

use plan::Plan;
use recording::capture::Watch;
use report::terminal::significant;
use scenario::expect::Limit;

use super::row::SweepRow;
use crate::campaign::NoResult;

/// The cases of a sweep or of torture. Any of them may be played on any machine, in any order.
pub trait Cases: Sync {
    /// "sweep" or "torture": so its folders are called.
    fn kind(&self) -> &'static str;

    /// The scenario's name.
    fn name(&self) -> &str;

    /// A hash of all that decides what the cases are, and of the version of the program.
    fn id(&self) -> &str;

    /// How many cases there are, numbered from 1.
    fn runs(&self) -> usize;

    /// What varies.
    fn keys(&self) -> Vec<&str>;

    /// How each key varies, for people.
    fn ways(&self) -> Vec<(String, String)>;

    /// The values of the keys in a case.
    fn values(&self, number: usize) -> Vec<f64>;

    /// The scenario of a case, as a file of its own.
    fn text(&self, number: usize) -> String;

    /// Plays a case.
    ///
    /// # Errors
    /// It came to no result.
    fn play(&self, number: usize, watch: &Watch) -> Result<SweepRow, NoResult>;

    /// The row of a case in which the program itself is at fault.
    fn faulty(&self, number: usize, reason: String) -> SweepRow;

    /// The limits that the runs are judged by.
    fn limits(&self, plan: &Plan) -> Vec<(String, Limit)> {
        judge::limits(plan)
    }

    /// Files, by name and text, that a folder of the campaign has besides the scenario.
    fn files(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// The values of a case with their keys, for people.
    fn words(&self, number: usize) -> String {
        let values = self.keys().into_iter().zip(self.values(number));
        let values = values.map(|(key, value)| format!("{key} = {value}"));
        values.collect::<Vec<_>>().join(", ")
    }
    /// The same in four digits, for a page.
    fn short_words(&self, number: usize) -> String {
        let values = self.keys().into_iter().zip(self.values(number));
        let values = values.map(|(key, value)| format!("{key} = {}", significant(value)));
        values.collect::<Vec<_>>().join(", ")
    }
}
