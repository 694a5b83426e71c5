//! Waits for a job: counts the rows that appear on the shared disk, and asks the engine whether it still works.

use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use runner::console::PartsBar;
use runner::observer::observed;

use super::campaign::{SharedCampaign, Submitted};
use super::{Engine, EngineError, JobState};
use crate::sweep::Shard;
use crate::sweep::attempt;

/// How soon the engine is asked for the first time, and how seldom later.
const PERIOD_MIN: Duration = Duration::from_millis(250);
const PERIOD_MAX: Duration = Duration::from_secs(5);
/// So often in a row an engine may not answer.
const SILENCES_MAX: u32 = 60;

/// How the waiting ended.
pub(super) enum Waited {
    /// The job is over; what the engine says of tasks that did not end well.
    Over(BTreeMap<usize, String>),
    /// The user no longer waits.
    Interrupted,
}

/// Waits until the engine has no task of the job any more. `bar` shows the rows so far, and how the parts stand.
pub(super) fn wait(
    engine: &dyn Engine,
    campaign: &SharedCampaign<'_>,
    submitted: &Submitted,
    counter: &Mutex<RowCounter>,
    bar: &PartsBar,
) -> Result<Waited, EngineError> {
    let (stop, stopped) = mpsc::channel::<()>();
    let work = || {
        let file = campaign.job_file(&submitted.file);
        let (mut period, mut silences) = (PERIOD_MIN, 0);
        loop {
            match stopped.recv_timeout(period) {
                Err(RecvTimeoutError::Timeout) => {}
                _ => return Ok(Waited::Interrupted),
            }
            period = (period + period / 4).min(PERIOD_MAX);
            let mut counter = counter.lock().unwrap_or_else(PoisonError::into_inner);
            counter.count(campaign);
            match engine.state(&submitted.id, &file, &submitted.parts) {
                Ok(state) => {
                    silences = 0;
                    bar.show(counter.rows(), &words(&state, &counter));
                    // What the engine still does for parts that are whole, such as running them again, changes nothing.
                    if state.is_over || counter.are_done(&submitted.parts, &state.failed) {
                        return Ok(Waited::Over(state.failed));
                    }
                }
                // A controller that restarts is away for a minute.
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

/// How the parts stand.
fn words(state: &JobState, counter: &RowCounter) -> String {
    let mut text = format!("{} of {} parts", counter.whole(), counter.of);
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

/// Counts rows by the lines of files that grow; each byte is read once.
pub(super) struct RowCounter {
    of: usize,
    parts: BTreeMap<usize, PartCount>,
}

#[derive(Default)]
struct PartCount {
    /// Bytes that were read and lines that were in them.
    files: BTreeMap<PathBuf, (u64, usize)>,
    rows: usize,
    is_whole: bool,
    /// A file with the rows of the part in which some are damaged: another one will take its place.
    damaged: Option<u64>,
}

impl RowCounter {
    /// How many parts there are.
    pub(super) fn of(&self) -> usize {
        self.of
    }

    /// Of so many parts.
    pub(super) fn new(of: usize) -> Self {
        let parts = (1..=of).map(|number| (number, PartCount::default()));
        Self {
            of,
            parts: parts.collect(),
        }
    }

    /// Looks anew at parts that are played again, where rows that seemed to be there are none.
    pub(super) fn begin_again(&mut self, campaign: &SharedCampaign<'_>, parts: &[usize]) {
        for number in parts {
            let (number, of) = (*number, self.of);
            let folder = campaign.part(Shard { number, of });
            let published = attempt::growing(&folder).unwrap_or_default().into_iter();
            let damaged = published.filter(|path| attempt::is_published(path));
            let damaged = damaged.filter_map(|path| inode(&path)).next();
            let part = self.parts.entry(number).or_default();
            (part.is_whole, part.damaged) = (false, damaged);
        }
    }

    /// Looks at what has grown. What cannot be read is looked at the next time.
    pub(super) fn count(&mut self, campaign: &SharedCampaign<'_>) {
        for (number, part) in &mut self.parts {
            if part.is_whole {
                continue;
            }
            let (number, of) = (*number, self.of);
            let folder = campaign.part(Shard { number, of });
            let growing = attempt::growing(&folder).unwrap_or_default();
            for path in growing {
                part.is_whole |= attempt::is_published(&path) && inode(&path) != part.damaged;
                let seen = part.files.entry(path.clone()).or_default();
                if count_lines(&path, seen).is_ok() {
                    // The first line is no row.
                    part.rows = part.rows.max(seen.1.saturating_sub(1));
                }
            }
        }
    }

    /// Rows of all parts; an attempt begins with those of the ones before.
    pub(super) fn rows(&self) -> usize {
        self.parts.values().map(|part| part.rows).sum()
    }

    /// Rows of a part.
    pub(super) fn rows_of(&self, part: usize) -> usize {
        self.parts.get(&part).map_or(0, |part| part.rows)
    }

    /// Whether each of these parts is whole or has failed.
    fn are_done(&self, parts: &[usize], failed: &BTreeMap<usize, String>) -> bool {
        let is_whole = |part| self.parts.get(part).is_some_and(|part| part.is_whole);
        let mut parts = parts.iter();
        parts.all(|part| is_whole(part) || failed.contains_key(part))
    }

    fn whole(&self) -> usize {
        self.parts.values().filter(|part| part.is_whole).count()
    }
}

/// What tells a file from another one that took its name.
fn inode(path: &Path) -> Option<u64> {
    path.metadata().ok().map(|file| file.ino())
}

fn count_lines(path: &Path, (offset, lines): &mut (u64, usize)) -> io::Result<()> {
    let mut file = scenario::open_file(path)?;
    file.seek(SeekFrom::Start(*offset))?;
    let mut bytes = [0; 1 << 16];
    loop {
        let count = file.read(&mut bytes)?;
        if count == 0 {
            return Ok(());
        }
        *offset += count as u64;
        *lines += bytes[..count].iter().filter(|byte| **byte == b'\n').count();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_counted_once_however_the_file_grows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.jsonl");
        let mut seen = (0, 0);
        for (text, lines) in [("a\nb\nc", 2), ("a\nb\ncd\n", 3), ("a\nb\ncd\n", 3)] {
            std::fs::write(&path, text).unwrap();
            count_lines(&path, &mut seen).unwrap();
            assert_eq!(seen, (text.len() as u64, lines));
        }
    }
}
