//! Slurm: an array job whose tasks have the numbers of the parts.

use std::fmt::Write;
use std::path::Path;

use super::program::{run, unclear};
use super::{Engine, Job, JobState, command_line, quoted, ranges};
use runner::exit::Failure;

const HELP: &str = "is this machine part of a Slurm cluster, with Slurm's commands in the PATH?";
/// Format of a task in the output of `squeue`: its number, state, node, and the reason why it waits.
const FORMAT: &str = "--format=%K|%T|%N|%r";
/// Answer of `squeue` about a job that ended some time ago.
const FORGOTTEN: &str = "Invalid job id";

pub(super) struct Slurm;

impl Engine for Slurm {
    fn file(&self, job: &Job<'_>) -> (&'static str, String) {
        let limits = job.limits;
        let mut text = "#!/bin/sh\n".to_owned();
        let mut option = |value: String| {
            let _ = writeln!(text, "#SBATCH {value}");
        };
        option(format!("--job-name={}", job.name));
        option(format!("--array={}", ranges(job.parts)));
        option(format!("--cpus-per-task={}", limits.cores));
        if let Some(minutes) = limits.minutes {
            option(format!("--time={minutes}"));
        }
        if let Some(mebibytes) = limits.mebibytes {
            option(format!("--mem={mebibytes}M"));
        }
        if let Some(queue) = &limits.queue {
            option(format!("--partition={}", quoted(queue)));
        }
        let logs = job.logs.join("slurm-%A-part-%a.txt");
        option(format!("--output={}", quoted(&logs.to_string_lossy())));
        option(format!("--chdir={}", quoted(&job.folder.to_string_lossy())));
        // A task whose node is lost begins again, and finds the rows that it wrote.
        option("--requeue".to_owned());
        option("--open-mode=append".to_owned());
        let _ = writeln!(
            text,
            "exec {} --shard auto --shards {}",
            command_line(&job.command),
            job.of
        );
        ("job.sh", text)
    }

    fn submit(&self, file: &Path) -> Result<String, Failure> {
        let file = file.to_string_lossy();
        let said = run("sbatch", &["--parsable", &file], HELP)?;
        // `sbatch` prints the number of the job, and the name of the cluster if there are several.
        let id = said.trim().split(';').next().unwrap_or_default();
        match id.parse::<u64>() {
            Ok(_) => Ok(id.to_owned()),
            Err(_) => Err(unclear("sbatch", &said)),
        }
    }

    fn state(&self, id: &str, _: &Path, parts: &[usize]) -> Result<JobState, Failure> {
        let job = format!("--jobs={id}");
        let asked = ["--noheader", "--array", "--states=all", &job, FORMAT];
        match run("squeue", &asked, HELP) {
            Err(failure) if failure.reason.contains(FORGOTTEN) => Ok(JobState {
                is_over: true,
                ..JobState::default()
            }),
            said => parsed(&said?, parts),
        }
    }

    fn cancel_command(&self, id: &str, _: Option<&str>) -> String {
        format!("scancel {id}")
    }
}

/// Reads the output of `squeue`.
fn parsed(said: &str, parts: &[usize]) -> Result<JobState, Failure> {
    let mut state = JobState::default();
    for line in said.lines().filter(|line| !line.trim().is_empty()) {
        let fields: Vec<&str> = line.trim().splitn(4, '|').collect();
        let [part, task, node, reason] = fields[..] else {
            return Err(unclear("squeue", line));
        };
        let part = part.parse::<usize>();
        let part = part.map_err(|_| unclear("squeue", line))?;
        match task {
            "PENDING" | "REQUEUED" | "REQUEUE_HOLD" | "REQUEUE_FED" | "SUSPENDED" | "STOPPED"
            | "SPECIAL_EXIT" => {
                state.waiting += 1;
                state.why_waiting = Some(reason.to_owned()).filter(|reason| reason != "None");
            }
            "RUNNING" | "CONFIGURING" | "COMPLETING" | "SIGNALING" | "STAGE_OUT" | "RESIZING" => {
                state.running += 1;
            }
            "COMPLETED" => {}
            ended if parts.contains(&part) => {
                let place = match node {
                    "" => String::new(),
                    node => format!(" on {node}"),
                };
                state.failed.insert(part, format!("{ended}{place}"));
            }
            _ => {}
        }
    }
    state.is_over = state.waiting + state.running == 0;
    Ok(state)
}

#[cfg(test)]
mod tests {
    use super::super::Limits;
    use super::super::tests::job;
    use super::*;

    #[test]
    fn the_job_is_an_array_of_the_missing_parts() {
        let limits = Limits {
            minutes: Some(30),
            mebibytes: Some(512),
            cores: 2,
            queue: Some("short".to_owned()),
            ..Limits::default()
        };
        let (name, text) = Slurm.file(&job(Path::new("/shared/my campaign"), &limits));
        assert_eq!(name, "job.sh");
        let expected = "#!/bin/sh\n#SBATCH --job-name=canrig-1f\n#SBATCH --array=3,7\n#SBATCH --cpus-per-task=2\n\
            #SBATCH --time=30\n#SBATCH --mem=512M\n#SBATCH --partition=short\n\
            #SBATCH --output='/shared/my campaign/engine/log/slurm-%A-part-%a.txt'\n\
            #SBATCH --chdir='/shared/my campaign'\n#SBATCH --requeue\n#SBATCH --open-mode=append\n\
            exec '/shared/my campaign/canrig' sweep '/shared/it'\\''s.toml' --shard auto --shards 9\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn squeue_says_how_far_it_is() {
        let said = "3|RUNNING|n0|None\n4|PENDING||Resources\n5|COMPLETED|n0|None\n6|TIMEOUT|n1|TimeLimit\n\
            7|NODE_FAIL|n1|NodeDown\n8|CANCELLED||None\n";
        let state = parsed(said, &[3, 4, 5, 6, 7, 8]).unwrap();
        assert_eq!((state.running, state.waiting, state.is_over), (1, 1, false));
        assert_eq!(state.why_waiting.as_deref(), Some("Resources"));
        let failed: Vec<&str> = state.failed.values().map(String::as_str).collect();
        assert_eq!(failed, ["TIMEOUT on n1", "NODE_FAIL on n1", "CANCELLED"]);
        assert!(parsed("", &[]).unwrap().is_over);
        assert!(parsed("what?\n", &[]).is_err());
    }
}
