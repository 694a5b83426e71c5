//! HyperQueue: a job with one task for each part, by its Python client. The same script submits the job and asks for its state.

use std::collections::BTreeMap;
use std::env;
use std::path::Path;

use serde::Deserialize;
use serde_json::json;

use super::program::{run, unclear};
use super::{Engine, Job, JobState, quoted};
use runner::exit::Failure;

/// Variable that names the Python with the client.
const PYTHON: &str = "CANRIG_PYTHON";
const HELP: &str = "HyperQueue's Python client is asked by Python 3: install both, or name the Python that has it in CANRIG_PYTHON";
/// Time from the limit to the kill of a task that does not end.
const KILL_AFTER_SECONDS: u32 = 30;

pub(super) struct Hyperqueue;

/// Part of the script that is the same for every job.
const SCRIPT: &str = include_str!("hyperqueue.py");

impl Engine for Hyperqueue {
    fn file(&self, job: &Job<'_>) -> (&'static str, String) {
        let mut command = Vec::new();
        if let Some(minutes) = job.limits.minutes {
            // This client has no time limit for tasks.
            let kill = format!("--kill-after={KILL_AFTER_SECONDS}");
            command.extend(["timeout".to_owned(), kill, format!("{}", 60 * minutes)]);
        }
        command.extend(job.command.iter().cloned());
        let limits = job.limits;
        let facts = [
            ("NAME", json!(job.name)),
            ("COMMAND", json!(command)),
            ("PARTS", json!(job.parts)),
            ("OF", json!(job.of)),
            ("FOLDER", json!(job.folder.to_string_lossy())),
            ("LOGS", json!(job.logs.to_string_lossy())),
            ("CORES", json!(limits.cores)),
            ("MEBIBYTES", json!(limits.mebibytes.unwrap_or(0))),
            ("SERVER", json!(limits.queue.as_deref().unwrap_or_default())),
        ];
        let lines = facts.into_iter();
        let facts = String::from_iter(lines.map(|(name, value)| format!("{name} = {value}\n")));
        ("job.py", format!("{facts}\n{SCRIPT}"))
    }

    fn submit(&self, file: &Path) -> Result<String, Failure> {
        let said = python(file, &["submit"])?;
        let id = said.lines().next_back().unwrap_or_default();
        match id.parse::<u64>() {
            Ok(_) => Ok(id.to_owned()),
            Err(_) => Err(unclear("HyperQueue's client", &said)),
        }
    }

    fn state(&self, id: &str, file: &Path, _: &[usize]) -> Result<JobState, Failure> {
        parsed(&python(file, &["state", id])?)
    }

    fn cancel_command(&self, id: &str, queue: Option<&str>) -> String {
        let server = queue.map(|queue| format!(" --server-dir {}", quoted(queue)));
        format!("hq job cancel {id}{}", server.unwrap_or_default())
    }
}

fn python(file: &Path, arguments: &[&str]) -> Result<String, Failure> {
    let program = env::var(PYTHON).unwrap_or_else(|_| "python3".to_owned());
    let file = file.to_string_lossy();
    let arguments = [&[&*file], arguments].concat();
    run(&program, &arguments, HELP)
}

/// Last line of the script's output.
#[derive(Deserialize)]
struct Said {
    total: usize,
    finished: usize,
    failed: usize,
    completed: bool,
    errors: BTreeMap<usize, String>,
}

fn parsed(said: &str) -> Result<JobState, Failure> {
    let line = said.lines().next_back().unwrap_or_default();
    let Ok(said) = serde_json::from_str::<Said>(line) else {
        return Err(unclear("HyperQueue's client", line));
    };
    Ok(JobState {
        // The client does not say which of the others run.
        running: said.total.saturating_sub(said.finished + said.failed),
        is_over: said.completed,
        failed: said.errors,
        ..JobState::default()
    })
}

#[cfg(test)]
mod tests {
    use super::super::Limits;
    use super::super::tests::job;
    use super::*;

    #[test]
    fn the_script_names_command_and_parts() {
        let limits = Limits {
            minutes: Some(2),
            cores: 1,
            ..Limits::default()
        };
        let (name, text) = Hyperqueue.file(&job(Path::new("/shared/c"), &limits));
        assert_eq!(name, "job.py");
        let command = "COMMAND = [\"timeout\",\"--kill-after=30\",\"120\",\"/shared/my campaign/canrig\",\"sweep\",\
            \"/shared/it's.toml\"]\nPARTS = [3,7]\nOF = 9\n";
        assert!(text.contains(command), "{text}");
    }

    #[test]
    fn the_client_says_how_far_it_is() {
        let said = "{\"total\": 5, \"finished\": 2, \"failed\": 1, \"completed\": false, \"errors\": {\"7\": \"exit code 4\"}}\n";
        let state = parsed(said).unwrap();
        assert_eq!((state.running, state.is_over), (2, false));
        assert_eq!(state.failed[&7], "exit code 4");
        assert!(parsed("Traceback").is_err());
    }
}
