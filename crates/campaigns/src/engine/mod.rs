//! Engines: programs of others that run many tasks on many machines, lose some, and run them again. canrig writes a job that an
//! engine understands, hands it over, and asks how far it is. What a task is, and what of it is left, only `sweep` knows.

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
use serde::{Deserialize, Serialize};

pub(crate) use program::EngineError;

/// Which engine.
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

/// What each task may use, and where it runs; what is absent is the engine's own default.
#[derive(Clone, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
struct Limits {
    minutes: Option<u32>,
    mebibytes: Option<u32>,
    cores: u16,
    queue: Option<String>,
    image: Option<String>,
    claim: Option<String>,
}

/// A job: the parts of a campaign that are missing, as one task each.
struct Job<'a> {
    /// Name that people see in the engine's lists.
    name: String,
    /// Folder of the campaign on the disk that all machines share.
    folder: &'a Path,
    /// Folder of what the tasks print.
    logs: PathBuf,
    /// The program and its arguments, but for the part.
    command: Vec<String>,
    /// The parts that are missing.
    parts: &'a [usize],
    /// How many parts there are.
    of: usize,
    limits: &'a Limits,
}

/// How far a job is, as the engine says.
#[derive(Debug, Default, Eq, PartialEq)]
struct JobState {
    waiting: usize,
    running: usize,
    /// Whether no task will begin or go on any more.
    is_over: bool,
    /// Why tasks wait, where the engine says so.
    why_waiting: Option<String>,
    /// What the engine says of parts whose task did not end well.
    failed: BTreeMap<usize, String>,
}

/// What an engine must be able to do.
trait Engine: Sync {
    /// Name and text of the file that describes the job.
    fn file(&self, job: &Job<'_>) -> (&'static str, String);

    /// Hands the job over; returns the name by which the engine knows it.
    fn submit(&self, file: &Path) -> Result<String, EngineError>;

    /// How far a job is.
    fn state(&self, id: &str, file: &Path, parts: &[usize]) -> Result<JobState, EngineError>;

    /// How people take a job away again that is in a queue.
    fn cancel_words(&self, id: &str, queue: Option<&str>) -> String;
}

/// A word of a shell's command line.
pub(crate) fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_./=:,+@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// A command line for a shell.
fn command_line(words: &[String]) -> String {
    let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    words.join(" ")
}

/// Numbers with what follows each other drawn together: 1-3,7.
fn ranges(numbers: &[usize]) -> String {
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for number in numbers {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == *number => *last = *number,
            _ => ranges.push((*number, *number)),
        }
    }
    let word = |(first, last): (usize, usize)| {
        if first == last {
            first.to_string()
        } else {
            format!("{first}-{last}")
        }
    };
    ranges.into_iter().map(word).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A job of which two parts of nine are missing.
    pub(super) fn job<'a>(folder: &'a Path, limits: &'a Limits) -> Job<'a> {
        Job {
            name: "canrig-1f".to_owned(),
            folder,
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
