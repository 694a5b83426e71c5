//! Kubernetes: an Indexed Job. Its pods have the numbers 0, 1, …; the n-th plays the n-th of the missing parts.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use serde::Deserialize;
use serde_json::{Value, json};

use super::program::{run, unclear};
use super::{Engine, Job, JobState, command_line, quoted};
use runner::exit::{Exit, Failure};

const HELP: &str = "kubectl must be in the PATH and know the cluster";
/// Default image of the containers. canrig itself is on the shared disk, so the image needs a C library only.
const IMAGE: &str = "debian:stable-slim";
/// Largest number of times that Kubernetes itself repeats a part whose pod failed.
const BACKOFF_LIMIT_PER_INDEX: u32 = 2;
/// Largest number of pods that are made at a time; the cluster decides how many of them run.
const PODS_MAX: usize = 1000;
const CONTAINER: &str = "canrig";
const VOLUME: &str = "campaign";
/// Answer of `kubectl` about a job that no longer exists.
const FORGOTTEN: &str = "NotFound";

pub(super) struct Kubernetes;

impl Engine for Kubernetes {
    fn file(&self, job: &Job<'_>) -> (&'static str, String) {
        let count = job.parts.len();
        let mut metadata = json!({"name": job.name, "labels": {"app": "canrig"}});
        if let Some(namespace) = &job.limits.queue {
            metadata["namespace"] = json!(namespace);
        }
        let manifest = json!({
            "apiVersion": "batch/v1",
            "kind": "Job",
            "metadata": metadata,
            "spec": {
                "completionMode": "Indexed",
                "completions": count,
                "parallelism": count.min(PODS_MAX),
                "backoffLimitPerIndex": BACKOFF_LIMIT_PER_INDEX,
                "maxFailedIndexes": count,
                "podFailurePolicy": {"rules": [
                    // A node that is drained or lost is not a failure of the part.
                    {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
                    // A wrong command line or an invalid file is the same for all parts, however often they are run.
                    {"action": "FailJob", "onExitCodes": {
                        "containerName": CONTAINER,
                        "operator": "In",
                        "values": [Exit::Usage.code(), Exit::CannotStart.code()],
                    }},
                ]},
                "template": {"spec": pod(job)},
            },
        });
        let text = serde_json::to_string_pretty(&manifest).expect("plain data");
        ("job.json", text + "\n")
    }

    fn submit(&self, file: &Path) -> Result<String, Failure> {
        let file = file.to_string_lossy();
        let said = run("kubectl", &["create", "-f", &file, "-o", "name"], HELP)?;
        match said.trim().strip_prefix("job.batch/") {
            Some(name) => Ok(name.to_owned()),
            None => Err(unclear("kubectl", &said)),
        }
    }

    fn state(&self, _: &str, file: &Path, parts: &[usize]) -> Result<JobState, Failure> {
        let file = file.to_string_lossy();
        match run("kubectl", &["get", "-f", &file, "-o", "json"], HELP) {
            Err(failure) if failure.reason.contains(FORGOTTEN) => Ok(JobState {
                is_over: true,
                ..JobState::default()
            }),
            said => parsed(&said?, parts),
        }
    }

    fn cancel_command(&self, id: &str, queue: Option<&str>) -> String {
        let namespace = queue.map(|queue| format!(" -n {}", quoted(queue)));
        format!("kubectl delete job {id}{}", namespace.unwrap_or_default())
    }
}

/// Returns the pod that plays a part.
fn pod(job: &Job<'_>) -> Value {
    let limits = job.limits;
    let script = format!(
        "shift \"$JOB_COMPLETION_INDEX\"; exec {} --shard \"$1/{}\"",
        command_line(&job.command),
        job.of
    );
    let command = ["sh", "-c", &script, "part"].map(str::to_owned);
    let parts = job.parts.iter().map(ToString::to_string);
    let mut resources = BTreeMap::from([("cpu", limits.cores.to_string())]);
    if let Some(mebibytes) = limits.mebibytes {
        resources.insert("memory", format!("{mebibytes}Mi"));
    }
    let mut pod = json!({
        "restartPolicy": "Never",
        "containers": [{
            "name": CONTAINER,
            "image": limits.image.as_deref().unwrap_or(IMAGE),
            "command": Vec::from_iter(command.into_iter().chain(parts)),
            "env": [{"name": "CANRIG_NODE", "valueFrom": {"fieldRef": {"fieldPath": "spec.nodeName"}}}],
            "resources": {"requests": resources, "limits": resources},
        }],
    });
    // Files belong to the user who submits the campaign, whatever user the image has.
    if let Ok(owner) = job.folder.metadata() {
        pod["securityContext"] = json!({"runAsUser": owner.uid(), "runAsGroup": owner.gid()});
    }
    if let Some(minutes) = limits.minutes {
        pod["activeDeadlineSeconds"] = json!(60 * minutes);
    }
    if let Some(claim) = &limits.claim {
        // The campaign is at the same place in the pods as on this machine.
        let place = job.folder.parent().unwrap_or(&job.folder);
        pod["volumes"] = json!([{"name": VOLUME, "persistentVolumeClaim": {"claimName": claim}}]);
        pod["containers"][0]["volumeMounts"] = json!([{"name": VOLUME, "mountPath": place}]);
    }
    pod
}

/// Answer of `kubectl` about a job.
#[derive(Deserialize)]
struct Said {
    #[serde(default)]
    status: Status,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Status {
    active: usize,
    ready: usize,
    failed_indexes: String,
    conditions: Vec<Condition>,
}

#[derive(Deserialize)]
struct Condition {
    r#type: String,
    status: String,
    #[serde(default)]
    message: String,
}

fn parsed(said: &str, parts: &[usize]) -> Result<JobState, Failure> {
    let Ok(Said { status }) = serde_json::from_str(said) else {
        return Err(unclear("kubectl", said));
    };
    let is_end = |one: &&Condition| {
        one.status == "True" && ["Complete", "Failed"].contains(&one.r#type.as_str())
    };
    let end = status.conditions.iter().find(is_end);
    let why = end.map_or("", |end| &end.message);
    let failed = numbers(&status.failed_indexes).filter_map(|index| parts.get(index).copied());
    Ok(JobState {
        waiting: status.active.saturating_sub(status.ready),
        running: status.ready,
        is_over: end.is_some(),
        failed: failed
            .map(|part| (part, format!("failed ({why})")))
            .collect(),
        why_waiting: None,
    })
}

/// Returns the numbers of a list such as 1,3-5.
fn numbers(list: &str) -> impl Iterator<Item = usize> {
    list.split(',').flat_map(|range| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        match (first.parse::<usize>(), last.parse::<usize>()) {
            (Ok(first), Ok(last)) => first..last.saturating_add(1),
            _ => 0..0,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::super::Limits;
    use super::super::tests::job;
    use super::*;

    #[test]
    fn the_pod_of_an_index_plays_the_missing_part_of_that_place() {
        let limits = Limits {
            minutes: Some(2),
            mebibytes: Some(512),
            cores: 2,
            claim: Some("disk".to_owned()),
            ..Limits::default()
        };
        let (_, text) = Kubernetes.file(&job(Path::new("/shared/c"), &limits));
        let manifest: Value = serde_json::from_str(&text).unwrap();
        let spec = &manifest["spec"];
        assert_eq!(
            (&spec["completions"], &spec["completionMode"]),
            (&json!(2), &json!("Indexed"))
        );
        let codes = &spec["podFailurePolicy"]["rules"][1]["onExitCodes"]["values"];
        assert_eq!(*codes, json!([2, 3]));
        let pod = &spec["template"]["spec"];
        assert_eq!(pod["activeDeadlineSeconds"], 120);
        let container = &pod["containers"][0];
        assert_eq!(container["volumeMounts"][0]["mountPath"], "/shared");
        // Runs the command in a shell, with a program that prints its arguments.
        let mut words: Vec<String> = serde_json::from_value(container["command"].clone()).unwrap();
        words[2] = words[2].replace("'/shared/my campaign/canrig'", "echo");
        let output = std::process::Command::new(&words[0])
            .args(&words[1..])
            .env("JOB_COMPLETION_INDEX", "1")
            .output()
            .unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        assert_eq!(said, "sweep /shared/it's.toml --shard 7/9\n");
    }

    #[test]
    fn kubectl_says_how_far_it_is() {
        let said = r#"{"status": {"active": 3, "ready": 2, "failedIndexes": "0,2-3"}}"#;
        let state = parsed(said, &[4, 5, 6, 9]).unwrap();
        assert_eq!((state.running, state.waiting, state.is_over), (2, 1, false));
        let failed: Vec<usize> = state.failed.into_keys().collect();
        assert_eq!(failed, [4, 6, 9]);
        let said =
            r#"{"status": {"conditions": [{"type": "Failed", "status": "True", "message": "m"}]}}"#;
        assert!(parsed(said, &[]).unwrap().is_over);
        assert!(!parsed("{}", &[]).unwrap().is_over);
        assert!(parsed("no", &[]).is_err());
    }
}
