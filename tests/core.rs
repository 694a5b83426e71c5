//! Rigs and scenarios that canrig does not play yet, in `tests/core/`, and what it says to each of
//! them. A scenario `NAME.toml` is to pass, `NAME_without.toml` to fail: it lacks what `NAME.toml`
//! is about, and has the same limits. The answers are in `tests/core/expected.txt`, which
//! `UPDATE_SNAPSHOTS=1 cargo test --release -p canrig --test tests core::` writes anew.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::net::{PRINTS_PART, judged_again, printed_parts};
use crate::support::{canrig, only_run, output, root, scenario};

/// Scenarios, each with the commands that are shown besides `simulate`.
const SCENARIOS: [(&str, &[&str]); 21] = [
    ("mass", &[]),
    ("mass_without", &[]),
    ("io_hangs", &[]),
    ("io_hangs_without", &[]),
    ("no_loop", &["check", "signals", "eds"]),
    ("no_loop_without", &[]),
    ("extra_object", &[]),
    ("extra_object_without", &[]),
    ("direct", &[]),
    ("direct_without", &[]),
    ("target_velocity", &[]),
    ("target_velocity_without", &[]),
    ("lone_drive", &[]),
    ("lone_drive_without", &[]),
    ("swept_fan", &[]),
    ("swept_fan_without", &[]),
    ("two_ecus", &["check", "signals", "eds"]),
    ("two_ecus_without", &[]),
    ("two_ecus_stops", &[]),
    ("micrometres", &[]),
    ("micrometres_without", &[]),
];

/// Checks whether a scenario is to fail.
fn is_opposite(name: &str) -> bool {
    name.ends_with("_without") || name.ends_with("_stops")
}

/// Returns a command in the folder of the scenarios, without colours.
fn here(arguments: &[&str]) -> Command {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.env_remove("FORCE_COLOR");
    canrig.env_remove("CLICOLOR_FORCE");
    canrig.env("NO_COLOR", "1");
    canrig.current_dir(root().join("tests/core"));
    canrig.args(arguments);
    canrig
}

/// Exit codes of a command line and of a file that is refused.
const REFUSED: [Option<i32>; 2] = [Some(2), Some(3)];

/// Returns the lines of an answer: the command with its exit code, and below it what it said; of a
/// refusal only the messages, without the places in the files.
fn answer(command: &str, code: Option<i32>, said: &str) -> Vec<String> {
    let number = code.map_or("a signal".to_owned(), |code| code.to_string());
    let is_message = |line: &&str| {
        let is_refused = REFUSED.contains(&code);
        !line.is_empty() && (!is_refused || line.starts_with("× ") || line.starts_with("error: "))
    };
    let mut lines = vec![format!("canrig {command}: {number}")];
    let said = said.lines().map(str::trim).filter(is_message);
    lines.extend(said.map(|line| format!("    {line}")));
    lines
}

/// Returns the outcome and the reason of a verdict, and the limits that were missed.
fn outcome(verdict: &str) -> String {
    let verdict: Value = serde_json::from_str(verdict).unwrap_or_else(|_| panic!("{verdict}"));
    let mut said = verdict["outcome"].as_str().unwrap().to_owned();
    if let Some(reason) = verdict["reason"].as_str() {
        said += &format!("\n{reason}");
    }
    for row in verdict["metrics"].as_array().into_iter().flatten() {
        if row["passed"] == false {
            said += &format!("\n{} is not met", row["name"].as_str().unwrap());
        }
    }
    said
}

/// Simulates a scenario. What is played is played in processes, too, and judged again, to the same
/// bytes.
fn simulate(folder: &Path, name: &str) -> Vec<String> {
    let file = format!("{name}.toml");
    let [simulated, in_processes] = ["simulated", "in_processes"].map(|world| {
        let runs = folder.join(name).join(world);
        runs.to_str().unwrap().to_owned()
    });
    let (code, _, stderr) = output(&mut here(&[
        "simulate", "--quiet", "--output", &simulated, &file,
    ]));
    if !Path::new(&simulated).exists() {
        return answer(&format!("simulate {file}"), code, &stderr);
    }
    let run = only_run(Path::new(&simulated));
    let said = outcome(&judged_again(&run));
    assert_eq!(code == Some(0), !is_opposite(name), "{name}: {said}");
    let options = ["--clock", "lockstep", "--quiet", "--output", &in_processes];
    let (_, stdout, stderr) = output(here(&["run", &file]).args(options));
    assert!(
        Path::new(&in_processes).exists(),
        "{name}: {stdout}{stderr}"
    );
    let other = only_run(Path::new(&in_processes));
    for file in ["bus.log", "signals.csv"] {
        let [one, other] = [&run, &other].map(|run| fs::read(run.join(file)).unwrap());
        assert!(one == other, "{name}: {file} differs in processes");
    }
    answer(&format!("simulate {file}"), code, &said)
}

/// Returns what another command says to a scenario.
fn said(folder: &Path, command: &str, name: &str) -> Vec<String> {
    let file = format!("{name}.toml");
    let sheets = folder.join(name).join("eds");
    let options = match command {
        "eds" => vec!["--to", sheets.to_str().unwrap()],
        _ => Vec::new(),
    };
    let (code, stdout, stderr) = output(here(&[command, &file]).args(options));
    let said = (stdout + &stderr).replace(folder.to_str().unwrap(), "FOLDER");
    answer(&format!("{command} {file}"), code, &said)
}

/// Returns the part of the controller of a scenario.
fn part(folder: &Path, scenario: &Path) -> Vec<u8> {
    let mut simulate = canrig(folder, "simulate");
    output(simulate.arg("--quiet").arg(scenario).args(PRINTS_PART));
    let mut parts = printed_parts(&only_run(folder));
    assert_eq!(parts.len(), 1, "{}", scenario.display());
    parts.swap_remove(0).1
}

/// Plays `step` with a controller that is started by hand in a folder with a part, and nothing
/// else.
fn led_by_part(folder: &Path, name: &str, of: &Path) -> Vec<String> {
    let place = folder.join(name);
    let alone = place.join("alone");
    fs::create_dir_all(&alone).unwrap();
    fs::write(alone.join("part.json"), part(&place.join("told"), of)).unwrap();
    let runs = place.join("runs");
    let mut simulate = canrig(&runs, "simulate");
    simulate.arg(scenario("step.toml"));
    simulate.args(["--external", "controller", "--patience", "none"]);
    let mut bench = simulate
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(bench.stdout.take().unwrap())
        .lines()
        .map(Result::unwrap);
    let address = lines.find_map(|line| {
        let address = line.split_once("expected at ");
        address.map(|(_, address)| address.to_owned())
    });
    let mut node = here(&["node", "--part", "part.json"]);
    node.current_dir(&alone).env("CANRIG_BUS", address.unwrap());
    let (code, _, stderr) = output(&mut node);
    let command = "node --part part.json";
    if code != Some(0) {
        kill_process(Pid::from_child(&bench), Signal::INT).unwrap();
        bench.wait().unwrap();
        return answer(command, code, &stderr);
    }
    lines.for_each(drop);
    bench.wait().unwrap();
    let said = outcome(&judged_again(&only_run(&runs)));
    assert_eq!(
        said.starts_with("pass"),
        !is_opposite(name),
        "{name}: {said}"
    );
    answer(command, code, &said)
}

#[test]
fn each_rig_has_the_stored_answer() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut lines = Vec::new();
    for (name, commands) in SCENARIOS {
        lines.push(format!("== {name}"));
        for command in commands {
            lines.extend(said(folder, command, name));
        }
        lines.extend(simulate(folder, name));
    }
    let without = root().join("tests/core/part_alone_without.toml");
    for (name, of) in [
        ("part_alone", scenario("step.toml")),
        ("part_alone_without", without),
    ] {
        lines.push(format!("== {name}"));
        lines.extend(led_by_part(folder, name, &of));
    }
    let now = lines.join("\n") + "\n";
    let path = root().join("tests/core/expected.txt");
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        fs::write(&path, &now).unwrap();
    }
    let stored = fs::read_to_string(&path).unwrap_or_default();
    let differs = stored
        .lines()
        .zip(now.lines())
        .find(|(one, other)| one != other);
    assert!(
        stored == now,
        "other answers than in {}; the first difference: {differs:?}; now:\n{now}",
        path.display()
    );
}

/// Each scenario of the folder is played, and has its opposite.
#[test]
fn no_scenario_is_forgotten() {
    let mut files = Vec::new();
    for entry in fs::read_dir(root().join("tests/core")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        files.extend(name.strip_suffix(".toml").map(str::to_owned));
    }
    files.retain(|name| !name.ends_with("_rig") && name != "part_alone_without");
    files.sort();
    let mut played = SCENARIOS.map(|(name, _)| name);
    played.sort_unstable();
    assert_eq!(files, played);
    for name in &files {
        let opposite = format!("{name}_without");
        assert!(is_opposite(name) || files.contains(&opposite), "{name}");
    }
}
