//! Engines: external programs that run many tasks on many machines, lose some, and run them again. canrig writes a job in the
//! engine's format, hands it over, and polls its state. The meaning of a task and its results are known to `sweep` only.

mod campaign;
pub mod command;
mod hyperqueue;
mod kubernetes;
mod program;
mod round;
mod slurm;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use runner::exit::Failure;
use serde::{Deserialize, Serialize};

/// External program that runs the tasks.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum EngineKind {
    /// Slurm: an array job, by `sbatch` and `squeue`
    Slurm,
    /// HyperQueue: a job by its Python client (`pip install hyperqueue`)
    Hyperqueue,
    /// Kubernetes: an Indexed Job, by `kubectl`
    Kubernetes,
}

impl EngineKind {
    fn engine(self) -> &'static dyn Engine {
        match self {
            Self::Slurm => &slurm::Slurm,
            Self::Hyperqueue => &hyperqueue::Hyperqueue,
            Self::Kubernetes => &kubernetes::Kubernetes,
        }
    }
}

/// Resources of a task, and the place where it runs. Absent ones are left to the engine's defaults.
#[derive(Clone, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
struct Limits {
    minutes: Option<u32>,
    mebibytes: Option<u32>,
    cores: u16,
    queue: Option<String>,
    image: Option<String>,
    claim: Option<String>,
}

/// Job: the missing parts of a campaign, as one task each.
struct Job<'a> {
    /// Name in the engine's lists.
    name: String,
    /// Folder of the campaign on the disk that all machines share.
    folder: PathBuf,
    /// Folder of the tasks' output.
    logs: PathBuf,
    /// Program and arguments, except for the part.
    command: Vec<String>,
    /// Parts that are missing.
    parts: &'a [usize],
    /// Number of all parts.
    of: usize,
    limits: &'a Limits,
}

/// State of a job, as the engine reports it.
#[derive(Debug, Default, Eq, PartialEq)]
struct JobState {
    waiting: usize,
    running: usize,
    /// Whether no task will begin or continue.
    is_over: bool,
    /// Reason why tasks wait, if the engine gives one.
    why_waiting: Option<String>,
    /// Parts whose task failed, with the reason that the engine gives.
    failed: BTreeMap<usize, String>,
}

/// Interface of an engine.
trait Engine: Sync {
    /// Returns name and text of the file that describes the job.
    fn file(&self, job: &Job<'_>) -> (&'static str, String);

    /// Hands the job over; returns the id that the engine gives it.
    fn submit(&self, file: &Path) -> Result<String, Failure>;

    /// Asks for the state of a job.
    fn state(&self, id: &str, file: &Path, parts: &[usize]) -> Result<JobState, Failure>;

    /// Returns the command with which the user cancels a job.
    fn cancel_command(&self, id: &str, queue: Option<&str>) -> String;
}

/// Quotes a word for a shell.
pub(crate) fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_./=:,+@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// Joins arguments to a command line for a shell.
fn command_line(words: &[String]) -> String {
    let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    words.join(" ")
}

/// Writes numbers with runs of neighbours as ranges: 1-3,7.
fn ranges(numbers: &[usize]) -> String {
    let ranges = numbers.chunk_by(|one, next| one + 1 == *next);
    let words = ranges.map(|range| match range {
        [first, .., last] => format!("{first}-{last}"),
        one => one.iter().map(usize::to_string).collect(),
    });
    words.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a job of which two parts of nine are missing.
    pub(super) fn job<'a>(folder: &'a Path, limits: &'a Limits) -> Job<'a> {
        Job {
            name: "canrig-1f".to_owned(),
            folder: folder.to_owned(),
            logs: folder.join("engine/log"),
            command: ["/shared/my campaign/canrig", "sweep", "/shared/it's.toml"]
                .map(str::to_owned)
                .into(),
            parts: &[3, 7],
            of: 9,
            limits,
        }
    }

    #[test]
    fn words_survive_a_shell() {
        assert_eq!(quoted("a/b-1.toml"), "a/b-1.toml");
        assert_eq!(quoted("it's $HOME"), "'it'\\''s $HOME'");
        assert_eq!(quoted(""), "''");
    }

    #[test]
    fn neighbours_are_a_range() {
        assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1-3,7,9-10");
        assert_eq!(ranges(&[5]), "5");
    }
}
