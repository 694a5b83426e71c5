//! Waits for a job: counts the rows that appear on the shared disk, and asks the engine whether it still works.

use std::collections::BTreeMap;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use runner::console::Bar;
use runner::exit::Failure;
use runner::observer::observed;

use super::campaign::{SharedCampaign, Submitted};
use super::{Engine, JobState};
use crate::sweep::store::Rows;

/// First and longest interval between two questions to the engine.
const PERIOD_MIN: Duration = Duration::from_millis(250);
const PERIOD_MAX: Duration = Duration::from_secs(5);
/// Largest number of failed questions in a row.
const SILENCES_MAX: u32 = 60;

/// Waits until the engine has no task of the job any more; returns its reasons for the parts that failed, `None` if the user
/// stopped waiting. `bar` shows the number of rows and the state of the parts.
pub(super) fn wait(
    engine: &dyn Engine,
    campaign: &SharedCampaign<'_>,
    submitted: &Submitted,
    counter: &mut RowCounter,
    bar: &Bar,
) -> Result<Option<BTreeMap<usize, String>>, Failure> {
    let (stop, stopped) = mpsc::channel::<()>();
    let work = || {
        let file = campaign.job_file(&submitted.file);
        let (mut period, mut silences) = (PERIOD_MIN, 0);
        loop {
            match stopped.recv_timeout(period) {
                Err(RecvTimeoutError::Timeout) => {}
                _ => return Ok(None),
            }
            period = (period + period / 4).min(PERIOD_MAX);
            // Rows that cannot be read are tried again the next time.
            let _ = counter.count();
            match engine.state(&submitted.id, &file, &submitted.parts) {
                Ok(state) => {
                    silences = 0;
                    bar.show(counter.rows() as u64);
                    bar.say(&state_text(&state, counter));
                    // Work of the engine on completed parts, such as a repetition, does not matter.
                    if state.is_over || counter.are_done(&submitted.parts, &state.failed) {
                        return Ok(Some(state.failed));
                    }
                }
                // A controller that restarts is unreachable for a minute.
                Err(_) if silences < SILENCES_MAX => silences += 1,
                Err(error) => return Err(error),
            }
        }
    };
    let interrupt = || {
        let _ = stop.send(());
    };
    observed(interrupt, || {}, work)
}

/// Describes the state of the parts.
fn state_text(state: &JobState, counter: &RowCounter) -> String {
    let of = counter.0.len();
    let mut text = format!("{} of {of} parts", of - counter.missing().len());
    for (count, word) in [
        (state.running, "running"),
        (state.waiting, "waiting"),
        (state.failed.len(), "failed"),
    ] {
        if count > 0 {
            text += &format!(", {count} {word}");
        }
    }
    if let Some(why) = state.why_waiting.as_ref().filter(|_| state.running == 0) {
        text += &format!(" ({why})");
    }
    text
}

/// Rows of each part.
pub(super) struct RowCounter(pub(super) Vec<Rows>);

impl RowCounter {
    /// Reads the rows that were added to incomplete parts.
    pub(super) fn count(&mut self) -> Result<(), Failure> {
        let mut parts = self.0.iter_mut().filter(|rows| !rows.is_whole());
        parts.try_for_each(Rows::look)
    }

    /// Number of cases that have a row.
    pub(super) fn rows(&self) -> usize {
        self.0.iter().map(Rows::len).sum()
    }

    /// Returns the parts that lack rows.
    pub(super) fn missing(&self) -> Vec<usize> {
        let missing = self.0.iter().filter(|rows| !rows.is_whole());
        missing.map(|rows| rows.shard().number).collect()
    }

    /// Checks whether each of these parts is complete or has failed.
    fn are_done(&self, parts: &[usize], failed: &BTreeMap<usize, String>) -> bool {
        let missing = self.missing();
        let mut left = parts.iter().filter(|part| missing.contains(part));
        left.all(|part| failed.contains_key(part))
    }
}

#[cfg(test)]
mod tests {
    use super::super::campaign::tests::{campaign, plan};
    use super::*;
    use crate::sweep::sweep_cases::SweepCases;

    #[test]
    fn the_state_says_what_there_is_and_why_nothing_runs() {
        let cases = SweepCases::new(&plan()).unwrap();
        let output = tempfile::tempdir().unwrap();
        let counter = RowCounter(campaign(&cases, output.path()).rows(4).unwrap());
        let mut state = JobState {
            waiting: 3,
            why_waiting: Some("Resources".to_owned()),
            failed: [(4, "TIMEOUT".to_owned())].into(),
            ..JobState::default()
        };
        let text = "0 of 4 parts, 3 waiting, 1 failed (Resources)";
        assert_eq!(state_text(&state, &counter), text);
        (state.waiting, state.running) = (1, 2);
        let text = "0 of 4 parts, 2 running, 1 waiting, 1 failed";
        assert_eq!(state_text(&state, &counter), text);
    }
}
