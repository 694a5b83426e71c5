//! Virtual time: every scenario judged, and the same bytes in every world.

use std::fs;
use std::path::Path;

use crate::support::{canrig, only_run, output, root, scenario};

/// The files that must be the same to the byte.
const DETERMINED: [&str; 5] = [
    "bus.log",
    "signals.csv",
    "verdict.json",
    "junit.xml",
    "report.html",
];

fn contents(run: &Path) -> Vec<Vec<u8>> {
    DETERMINED
        .iter()
        .map(|name| fs::read(run.join(name)).unwrap())
        .collect()
}

#[test]
fn every_shipped_scenario_passes() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) = output(
        canrig(folder.path(), "simulate")
            .arg(root().join("scenarios"))
            .arg("--json"),
    );
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    let verdicts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let verdicts = verdicts.as_array().unwrap();
    assert!(verdicts.len() >= 8, "{} verdicts", verdicts.len());
    for verdict in verdicts {
        assert_eq!(verdict["outcome"], "pass", "{verdict}");
    }
}

#[test]
fn one_process_twice_and_three_processes_leave_the_same_bytes() {
    let runs: Vec<_> = [
        ("simulate", None),
        ("simulate", None),
        ("run", Some("lockstep")),
    ]
    .into_iter()
    .map(|(command, clock)| {
        let folder = tempfile::tempdir().unwrap();
        let mut canrig = canrig(folder.path(), command);
        canrig.arg(scenario("step.toml"));
        if let Some(clock) = clock {
            canrig.args(["--clock", clock]);
        }
        let (code, stdout, stderr) = output(&mut canrig);
        assert_eq!(code, Some(0), "{stdout}\n{stderr}");
        contents(&only_run(folder.path()))
    })
    .collect();
    for run in &runs[1..] {
        for ((name, first), other) in DETERMINED.iter().zip(&runs[0]).zip(run) {
            assert!(first == other, "{name} differs");
        }
    }
}

#[test]
fn the_recording_alone_gives_the_same_verdict() {
    use canrig::{judge::judge, recording::read_log, timeline::decode};
    let folder = tempfile::tempdir().unwrap();
    let (code, ..) = output(canrig(folder.path(), "simulate").arg(scenario("fan.toml")));
    assert_eq!(code, Some(0));
    let run = only_run(folder.path());
    let log = fs::File::open(run.join("bus.log")).unwrap();
    let frames = read_log(std::io::BufReader::new(log)).unwrap();
    let scenario = scenario::Scenario::load(&run.join("scenario.toml")).unwrap();
    let timeline = decode(&frames, &scenario, &dbc::Database::sma_actuator()).unwrap();
    let verdict = judge(&timeline, &scenario, 0);
    assert_eq!(
        verdict.to_json(),
        fs::read_to_string(run.join("verdict.json")).unwrap()
    );
}
