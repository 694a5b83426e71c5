//! Nodes that canrig does not start: ours, started by hand, stand for somebody else's.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::support::{canrig, only_run, output, scenario};

/// A warm hold that no busy machine bends, with a limit on the wire's temperature and one on a disturbance.
fn scenario_text() -> String {
    "schema = 1\nname = \"swapped\"\nduration_seconds = 3.0\n[bus]\nsync_period_milliseconds = 100.0\n\
     [controller.sliding_mode]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
     [[disturbance.fan]]\nfrom_seconds = 1.0\nuntil_seconds = 2.0\nconvection_factor = 2.0\n\
     [expect]\ntemperature_celsius = { max = 90.0 }\nmaximum_deviation_millimetres = { max = 60.0 }\n"
        .to_owned()
}

/// A run that expects a node on its embedded bus.
struct Run {
    canrig: Child,
    /// What it prints.
    lines: BufReader<std::process::ChildStdout>,
    address: String,
    scenario: PathBuf,
    runs: PathBuf,
}

impl Run {
    fn expecting(folder: &Path, external: &str) -> Self {
        let scenario = folder.join("swapped.toml");
        fs::write(&scenario, scenario_text()).unwrap();
        let runs = folder.join("runs");
        let mut canrig = canrig(&runs, "run");
        canrig.arg(&scenario);
        canrig.args(["--bus", "embedded", "--external", external]);
        let mut canrig = canrig
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(canrig.stdout.take().unwrap());
        let mut line = String::new();
        while !line.starts_with("bus address: ") {
            line.clear();
            assert_ne!(lines.read_line(&mut line).unwrap(), 0, "no bus address");
        }
        let address = line["bus address: ".len()..].trim().to_owned();
        Self {
            canrig,
            lines,
            address,
            scenario,
            runs,
        }
    }

    /// Starts one of our nodes by hand; it stops when its standard input ends.
    fn start(&self, role: &str) -> Child {
        let mut node = Command::new(env!("CARGO_BIN_EXE_canrig"));
        node.args(["node", role, "--bus", &self.address, "--scenario"]);
        node.arg(&self.scenario);
        let node = node.stdin(Stdio::piped()).stdout(Stdio::null());
        node.stderr(Stdio::null()).spawn().unwrap()
    }

    /// Exit code, and what was printed.
    fn end(mut self) -> (Option<i32>, String, PathBuf) {
        let mut text = String::new();
        self.lines.read_to_string(&mut text).unwrap();
        let ended = self.canrig.wait_with_output().unwrap();
        text += &String::from_utf8(ended.stderr).unwrap();
        (ended.status.code(), text, only_run(&self.runs))
    }
}

fn stop(mut node: Child) {
    drop(node.stdin.take());
    node.wait().unwrap();
}

fn verdict(run: &Path) -> serde_json::Value {
    serde_json::from_str(&fs::read_to_string(run.join("verdict.json")).unwrap()).unwrap()
}

fn metric<'a>(verdict: &'a serde_json::Value, name: &str) -> &'a serde_json::Value {
    let metrics = verdict["metrics"].as_array().unwrap();
    let found = metrics.iter().find(|metric| metric["name"] == name);
    found.unwrap_or_else(|| panic!("no {name} in {verdict}"))
}

/// How many cells of a column hold a value.
fn values(run: &Path, column: &str) -> usize {
    let table = fs::read_to_string(run.join("signals.csv")).unwrap();
    let place = |line: &str| line.split(',').position(|name| name == column);
    let place = place(table.lines().next().unwrap()).unwrap();
    let cells = table.lines().skip(1);
    let cells = cells.map(|line| line.split(',').nth(place).unwrap());
    cells.filter(|cell| !cell.is_empty()).count()
}

#[test]
fn beside_an_external_drive_nothing_is_guessed_and_a_limit_that_nobody_tells_does_not_pass() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::expecting(folder.path(), "drive");
    // The emulator tells temperatures, which must not be taken for those of the drive that it stands for.
    let drive = run.start("plant-emulator");
    let (code, text, run) = run.end();
    stop(drive);
    assert_eq!(code, Some(5), "{text}");
    assert!(text.contains("only the emulated plant tells it"), "{text}");
    let verdict = verdict(&run);
    assert_eq!(verdict["external"], serde_json::json!(["drive"]));
    for name in ["temperature_celsius", "maximum_deviation_millimetres"] {
        let metric = metric(&verdict, name);
        assert!(
            metric["value"].is_null() && metric["passed"].is_null(),
            "{metric}"
        );
    }
    assert!(values(&run, "position_millimetres") > 20);
    assert_eq!(values(&run, "wire_temperature_celsius"), 0);
    assert!(
        verdict["timing"]["plant_emulator"].is_null()
            && verdict["timing"]["controller"].is_object()
    );
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("are not available: the drive is external"));
    // No command for a fan that is not there.
    assert!(
        !fs::read_to_string(run.join("bus.log"))
            .unwrap()
            .contains(" 211#")
    );

    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, text, stderr) = output(replay.arg("replay").arg(&run));
    assert_eq!(code, Some(5), "{text}{stderr}");
    assert!(
        text.contains("the same verdict as that of the run"),
        "{text}"
    );
}

#[test]
fn an_external_controller_is_judged_like_ours() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::expecting(folder.path(), "controller");
    let controller = run.start("controller");
    let (code, text, run) = run.end();
    stop(controller);
    // Beside a busy machine's 5 there is nothing that a hold could miss.
    assert!(matches!(code, Some(0 | 5)), "{code:?}\n{text}");
    let verdict = verdict(&run);
    assert_eq!(verdict["external"], serde_json::json!(["controller"]));
    assert!(metric(&verdict, "temperature_celsius")["value"].is_number());
    assert!(values(&run, "wire_temperature_celsius") > 20);
    assert!(verdict["timing"]["controller"].is_null());
}

#[test]
fn a_drive_that_does_not_come_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (code, text, _) = Run::expecting(folder.path(), "drive,fan").end();
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("no drive: node 16"), "{text}");
}

#[test]
fn what_cannot_be_external_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |arguments: &[&str], name: &str| {
        let mut canrig = canrig(folder.path(), "run");
        let (code, _, stderr) = output(canrig.args(arguments).arg(scenario(name)));
        (code, stderr)
    };
    let bus = ["--bus", "embedded"];
    let (code, text) = refused(&[&bus[..], &["--external", "fan"]].concat(), "step.toml");
    assert!(
        code == Some(2) && text.contains("needs --external drive"),
        "{code:?} {text}"
    );
    let lockstep = ["--external", "drive", "--clock", "lockstep"];
    let (code, text) = refused(&[&bus[..], &lockstep].concat(), "step.toml");
    assert!(
        code == Some(2) && text.contains("needs --clock real-time"),
        "{code:?} {text}"
    );
    let (code, text) = refused(
        &[&bus[..], &["--external", "drive"]].concat(),
        "faults/sensor_stuck.toml",
    );
    assert!(
        code == Some(3) && text.contains("[[fault.sensor.stuck]] cannot be played"),
        "{code:?} {text}"
    );
}
