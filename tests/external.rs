//! Nodes that canrig does not start. Nodes of canrig, started by hand, represent foreign ones.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

use crate::book_commands::expects_its_node;
use crate::real_time::{Started, in_real_time, wait_for};
use crate::rigs::{changed_rig, rig};
use crate::support::{canrig, only_run, output, root, scenario};

const CYCLE: &str = "[bus]\nsync_period_milliseconds = 100.0\n";
const FAN: &str =
    "[[disturbance.fan]]\nfrom_seconds = 1.0\nuntil_seconds = 2.0\nconvection_factor = 2.0\n";
const DEVIATION: &str = "maximum_deviation_millimetres = { max = 60.0 }\n";

/// Gains that lead the load also in a cycle of 100 ms. Those that ship are for one of 1 ms, and throw it to its end there, where
/// the controller does not believe its position.
pub(crate) const LAW: &str = "[controller.sliding_mode]\nbandwidth_radians_per_second = 6.0\n\
     switching_gain_metres_per_second_cubed = 9.6\nreference_launch_jerk_metres_per_second_cubed = 2.0\n\
     hold.bandwidth_radians_per_second = 6.0\n";

/// Returns a warm hold that a busy machine does not disturb. Its limits on the wire's temperature and on a disturbance
/// are never exceeded: a permanent current of 1 A heats the wire to 138 °C.
fn scenario_text() -> String {
    format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"swapped\"\nduration_seconds = 3.0\n{CYCLE}\
         {LAW}[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n{FAN}\
         [expect]\ntemperature_celsius = {{ max = 140.0 }}\n{DEVIATION}"
    )
}

/// Returns the same for the rig of [`rig_file`], which has its own cycle and no fan.
fn text_for_rig() -> String {
    let without = |text: String, part: &str| text.replace(part, "");
    [CYCLE, FAN, DEVIATION]
        .into_iter()
        .fold(scenario_text(), without)
}

/// A run that expects a node on its embedded bus.
pub(crate) struct Run {
    pub(crate) canrig: Started,
    /// Its standard output.
    lines: BufReader<std::process::ChildStdout>,
    pub(crate) address: String,
    pub(crate) scenario: PathBuf,
    pub(crate) runs: PathBuf,
}

/// Writes a rig file for the emulator as the drive, with this limit of the position.
fn rig_file(folder: &Path, position_max: f64) -> PathBuf {
    let path = folder.join("emulated.toml");
    let drive = format!(
        "limits = {{ current_amperes = 1.0, min = -1.0, max = {position_max:.1}, rate_max = 1e4 }}\n\
         timeouts = {{ drive_lost_milliseconds = 1000, controller_lost_milliseconds = 1000 }}"
    );
    fs::write(&path, rig_of_a_drive(50.0, &drive)).unwrap();
    path
}

impl Run {
    /// Begins a run without the longest part of the pre-flight, which `preflight` tests.
    fn expecting(folder: &Path, external: &str) -> Self {
        let arguments = ["--external", external, "--no-heating"];
        Self::of(&scenario_text(), folder, &arguments)
    }

    /// Begins a run on the rig of [`rig_file`]. The nodes that represent foreign ones do not know it.
    fn on_rig(folder: &Path, position_max: f64, more: &[&str]) -> Self {
        let rig = rig_file(folder, position_max);
        let arguments = ["--rig", rig.to_str().unwrap(), "--no-heating"];
        let run = Self::of(&text_for_rig(), folder, &[&arguments[..], more].concat());
        let scenario = folder.join("elsewhere.toml");
        fs::write(&scenario, scenario_text().replace("= 100.0", "= 50.0")).unwrap();
        Self { scenario, ..run }
    }

    pub(crate) fn of(text: &str, folder: &Path, arguments: &[&str]) -> Self {
        let scenario = folder.join("swapped.toml");
        fs::write(&scenario, text).unwrap();
        let runs = folder.join("runs");
        let mut canrig = canrig(&runs, "run");
        canrig.arg(&scenario);
        canrig.args(["--bus", "embedded"]).args(arguments);
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
            canrig: Started::new(canrig),
            lines,
            address,
            scenario,
            runs,
        }
    }

    pub(crate) fn start(&self, role: &str) -> Child {
        start(&self.address, role, &self.scenario)
    }

    /// Returns exit code, output, and folder of the run.
    pub(crate) fn end(self) -> (Option<i32>, String, PathBuf) {
        let runs = self.runs.clone();
        let (code, text) = self.printed();
        (code, text, only_run(&runs))
    }

    /// Returns the same, next to a node of canrig that stops afterwards.
    pub(crate) fn end_beside(self, role: &str) -> (Option<i32>, String, PathBuf) {
        let node = self.start(role);
        let ended = self.end();
        stop(node);
        ended
    }

    /// Returns exit code and output.
    pub(crate) fn printed(mut self) -> (Option<i32>, String) {
        let mut text = String::new();
        self.lines.read_to_string(&mut text).unwrap();
        let ended = self.canrig.ended();
        text += &String::from_utf8(ended.stderr).unwrap();
        (ended.status.code(), text)
    }
}

/// Starts a node of canrig by hand; it stops when its standard input ends.
pub(crate) fn start(address: &str, role: &str, scenario: &Path) -> Child {
    let mut node = Command::new(env!("CARGO_BIN_EXE_canrig"));
    node.args(["node", role, "--bus", address, "--scenario"]);
    let node = node
        .arg(scenario)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    node.spawn().unwrap()
}

pub(crate) fn stop(mut node: Child) {
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

/// A replay leaves undecided results undecided.
fn replays_undecided_again(run: &Path) {
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, text, stderr) = output(replay.arg("replay").arg(run));
    assert_eq!(code, Some(5), "{text}{stderr}");
    assert!(
        text.contains("the same verdict as that of the run"),
        "{text}"
    );
}

/// Returns the number of cells of a column that hold a value; 0 if there is no such column.
fn values(run: &Path, column: &str) -> usize {
    let table = fs::read_to_string(run.join("signals.csv")).unwrap();
    let place = |line: &str| line.split(',').position(|name| name == column);
    let Some(place) = place(table.lines().next().unwrap()) else {
        return 0;
    };
    let cells = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(place).unwrap());
    cells.filter(|cell| !cell.is_empty()).count()
}

#[test]
fn beside_an_external_drive_nothing_is_guessed_and_a_limit_that_nobody_publishes_does_not_pass() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::expecting(folder.path(), "drive");
        // The emulator publishes temperatures, which must not count as those of the foreign drive.
        let (code, text, run) = run.end_beside("plant-emulator");
        assert_eq!(code, Some(5), "{text}");
        assert!(
            text.contains("only the emulated plant publishes it"),
            "{text}"
        );
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
        // There is no command for a missing fan.
        assert!(
            !fs::read_to_string(run.join("bus.log"))
                .unwrap()
                .contains(" 211#")
        );

        replays_undecided_again(&run);
    });
}

#[test]
fn an_external_controller_is_judged_like_ours() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::expecting(folder.path(), "controller");
        let (code, text, run) = run.end_beside("controller");
        // A hold cannot miss anything else than the 5 of a busy machine.
        assert!(matches!(code, Some(0 | 5)), "{code:?}\n{text}");
        let verdict = verdict(&run);
        assert_eq!(verdict["external"], serde_json::json!(["controller"]));
        assert!(metric(&verdict, "temperature_celsius")["value"].is_number());
        assert!(values(&run, "wire_temperature_celsius") > 20);
        assert!(verdict["timing"]["controller"].is_null());
    });
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
    let (code, text) = refused(
        &[&bus[..], &["--external", "disturbance"]].concat(),
        "step.toml",
    );
    assert!(
        code == Some(3) && text.contains("needs --external drive"),
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

#[test]
fn a_rig_file_gives_the_cycle_and_goes_with_the_recording() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        // With such a cycle the law overshoots by far.
        let run = Run::on_rig(folder.path(), 70.0, &[]);
        let (code, text, run) = run.end_beside("plant-emulator");
        assert_eq!(code, Some(5), "{text}");
        assert!(
            text.contains("only the emulated plant publishes it"),
            "{text}"
        );
        assert_eq!(verdict(&run)["external"], serde_json::json!(["drive"]));
        // The run lasts 3 s with the 50 ms of the rig file.
        let rows = values(&run, "position_millimetres");
        assert!((55..=60).contains(&rows), "{rows}");
        replays_undecided_again(&run);
    });
}

/// The emulators of two drives on one joint represent real drives, which one law leads.
#[test]
fn two_external_drives_of_one_loop_are_led_and_checked_one_after_the_other() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let text = |rig: &str, more: &str| {
            format!(
                "schema = 1\nrig = \"{rig}\"\nname = \"joint\"\nduration_seconds = 2.0\n{more}\
                 [controller.pid_pair]\nproportional_amperes_per_degree = 0.04\n\
                 [[reference.hold]]\nat_seconds = 0.0\nposition_degrees = 5.0\n\
                 [expect]\ncurrent_amperes_rms = {{ max = 1.0 }}\n"
            )
        };
        fs::write(folder.path().join("joint.toml"), rig("real_pair")).unwrap();
        let run = Run::of(&text("joint.toml", ""), folder.path(), &["--no-heating"]);
        // The emulator does not know the rig.
        let scenario = folder.path().join("elsewhere.toml");
        let cycle = "[bus]\nsync_period_milliseconds = 50.0\n";
        fs::write(&scenario, text("sma_pair", cycle)).unwrap();
        let (code, text, run) = Run { scenario, ..run }.end_beside("plant-emulator");
        assert_eq!(code, Some(0), "{text}");
        for (name, id) in [("flexor", 16), ("extensor", 18)] {
            let found = format!(
                " {name}:\n  ✓ other manager none is heard\n  ✓ nodes         found: {name} (node {id})"
            );
            assert!(text.contains(&found), "{text}");
        }
        let external = serde_json::json!(["flexor", "extensor"]);
        assert_eq!(verdict(&run)["external"], external);
        // The law heats both wires, the flexor more.
        let current = |name: &str| metric(&verdict(&run), name)["value"].as_f64().unwrap();
        let [flexor, extensor] =
            ["angle", "extensor"].map(|name| current(&format!("{name}.current_amperes_rms")));
        assert!(flexor > extensor && extensor > 0.1, "{flexor} {extensor}");
    });
}

#[test]
fn canrig_stops_a_drive_that_a_foreign_controller_leads_beyond_a_limit() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let rig = rig_file(folder.path(), 8.0);
        let arguments = ["--rig", rig.to_str().unwrap(), "--external", "controller"];
        let low =
            text_for_rig().replace("position_millimetres = 10.0", "position_millimetres = 5.0");
        let run = Run::of(&low, folder.path(), &arguments);
        // The nodes do not know the rig file; the controller moves to 10 mm, with its own cycle.
        let elsewhere = folder.path().join("elsewhere.toml");
        fs::write(&elsewhere, scenario_text()).unwrap();
        let drive = start(&run.address, "plant-emulator", &elsewhere);
        let controller = start(&run.address, "controller", &elsewhere);
        let (code, text, run) = run.end();
        stop(drive);
        stop(controller);
        assert_eq!(code, Some(1), "{text}");
        let expected = "drive: canrig stopped the drive: limit of the rig: the position is";
        assert!(text.contains(expected), "{text}");
        let log = fs::read_to_string(run.join("bus.log")).unwrap();
        let (_, after) = log.split_once(" 000#0210\n").expect("NMT stop");
        let is_heated = |line: &str| line.contains(" 190#37") && !line.ends_with("0000");
        assert!(
            !after.lines().any(is_heated),
            "the current flows on:\n{after}"
        );
    });
}

/// Asserts that a node failed the run: its name and the time are in the verdict, for CI, on the page and in a replay.
fn is_failed_by(node: &str, what: &str, run: &Path) {
    let verdict = verdict(run);
    assert_eq!(verdict["outcome"], "fail", "{verdict}");
    let reason = verdict["reason"].as_str().unwrap();
    assert!(reason.starts_with(&format!("{node}: {what}")), "{reason}");
    let end = &verdict["ended_early"];
    assert_eq!((&end["by"], &end["node"]), (&"node".into(), &node.into()));
    let [junit, page] =
        ["junit.xml", "report.html"].map(|name| fs::read_to_string(run.join(name)).unwrap());
    let first = reason.lines().next().unwrap();
    assert!(
        junit.contains(&format!("<failure message=\"{first}")),
        "{junit}"
    );
    assert!(page.contains(first), "{reason} is not on the page");
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, text, stderr) = output(replay.arg("replay").arg(run));
    assert_eq!(code, Some(1), "{text}{stderr}");
    assert!(
        text.contains("the same verdict as that of the run"),
        "{text}"
    );
}

#[test]
fn a_foreign_controller_that_dies_fails_the_run() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let text = scenario_text().replace("duration_seconds = 3.0", "duration_seconds = 9.0");
        let run = Run::of(&text, folder.path(), &["--external", "controller"]);
        let mut controller = run.start("controller");
        let log = || fs::read_to_string(only_run(&run.runs).join("bus.log")).unwrap_or_default();
        wait_for("the drive to be led", || log().contains(" 210#0F00"));
        std::thread::sleep(Duration::from_secs(1));
        controller.kill().unwrap();
        controller.wait().unwrap();
        let (code, text, run) = run.end();
        assert_eq!(code, Some(1), "{text}");
        assert!(text.contains("controller: silent since "), "{text}");
        is_failed_by("controller", "silent since ", &run);
        let missed = metric(&verdict(&run), "missed_cycles_percent")["value"].as_f64();
        assert!(missed > Some(70.0), "{missed:?}");
        let log = fs::read_to_string(run.join("bus.log")).unwrap();
        // Without SYNC it sends no position. Its emergency, after leaving Operational, shows that no current flows.
        assert!(log.contains(" 090#3081"), "no emergency:\n{log}");
        let last = log.lines().rfind(|line| line.contains(" 710#")).unwrap();
        assert!(!last.ends_with("#05"), "{last}");
    });
}

/// A controller that sends only SYNC, and a missing one.
#[test]
fn a_controller_that_enables_nothing_and_one_that_is_not_there_fail_the_run() {
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let run = |folder: &tempfile::TempDir| Run::expecting(folder.path(), "controller");
    let [idle, absent] = [run(&folders[0]), run(&folders[1])];
    let address = idle.address.parse().unwrap();
    let is_over = std::sync::atomic::AtomicBool::new(false);
    let ends = std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut bus = platform::open(&address, &[]).unwrap();
            while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                // The bus ends before this thread does.
                let _ = bus.send(&can::CanFrame::new(0x080, &[]));
                std::thread::sleep(Duration::from_millis(100));
            }
        });
        let ends = [idle.end(), absent.end()];
        is_over.store(true, std::sync::atomic::Ordering::Relaxed);
        ends
    });
    let whats = [
        "the scenario did not begin within 15 s: the drive never reported Operation enabled (NMT start: none, SYNC: sent, drive: no statusword)",
        "not heard at all within 15 s",
    ];
    for ((code, text, run), what) in ends.into_iter().zip(whats) {
        assert_eq!(code, Some(1), "{text}");
        is_failed_by("controller", what, &run);
    }
}

#[test]
fn a_drive_that_dies_beside_our_controller_is_named() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::on_rig(folder.path(), 70.0, &[]);
        let mut drive = run.start("plant-emulator");
        let log = || fs::read_to_string(only_run(&run.runs).join("bus.log")).unwrap_or_default();
        wait_for("the scenario to go on", || {
            log().lines().filter(|line| line.contains(" 190#")).count() > 20
        });
        drive.kill().unwrap();
        drive.wait().unwrap();
        let (code, text, run) = run.end();
        assert_eq!(code, Some(1), "{text}");
        is_failed_by("drive", "silent since ", &run);
    });
}

#[test]
fn ctrl_c_stops_a_drive_that_a_foreign_controller_leads() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::on_rig(folder.path(), 70.0, &["--external", "controller"]);
        let drive = run.start("plant-emulator");
        let controller = start(&run.address, "controller", &run.scenario);
        let log = || fs::read_to_string(only_run(&run.runs).join("bus.log")).unwrap_or_default();
        wait_for("the drive to be led", || log().contains(" 210#0F00"));
        let canrig = Pid::from_raw(run.canrig.id().cast_signed()).unwrap();
        kill_process(canrig, Signal::INT).unwrap();
        let (code, text, run) = run.end();
        stop(drive);
        stop(controller);
        assert_eq!(code, Some(130), "{text}");
        let log = fs::read_to_string(run.join("bus.log")).unwrap();
        assert!(log.contains(" 000#0210"), "no NMT stop:\n{log}");
    });
}

#[test]
fn rig_files_are_checked_like_scenarios() {
    let folder = tempfile::tempdir().unwrap();
    let check = |path: &Path| {
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        output(canrig.arg("check").arg(path).env("NO_COLOR", "1"))
    };
    let path = rig_file(folder.path(), 45.0);
    let (code, text, _) = check(&path);
    assert!(
        code == Some(0) && text.contains("valid (rig: emulated)"),
        "{text}"
    );
    let text = fs::read_to_string(&path).unwrap() + "node = 3\n";
    fs::write(&path, text).unwrap();
    let (code, _, stderr) = check(&path);
    assert_eq!(code, Some(3));
    assert!(
        stderr.contains("unknown key `node` in [node.drive]") && stderr.contains("node = 3"),
        "{stderr}"
    );
}

/// An identifier cut to 11 bits would belong to another PDO, so no bench could support it.
#[test]
fn a_rigs_eds_with_a_pdo_identifier_of_29_bits_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = rig_file(folder.path(), 45.0);
    let text = fs::read_to_string(&path).unwrap() + "eds = \"drive.eds\"\n";
    fs::write(&path, text).unwrap();
    let eds = dbc::DRIVE_EDS.replace("$NODEID+0x40000180", "0x20000190");
    for (eds, code) in [(dbc::DRIVE_EDS, 0), (&eds, 3)] {
        fs::write(folder.path().join("drive.eds"), eds).unwrap();
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        let (found, _, stderr) = output(canrig.arg("check").arg(&path));
        assert_eq!(found, Some(code), "{stderr}");
        let is_named = stderr.contains("0x1800:01") && stderr.contains("0x20000190");
        assert_eq!(is_named, code == 3, "{stderr}");
    }
}

#[test]
fn a_set_point_that_the_rig_may_not_reach_is_refused_before_current_flows() {
    let folder = tempfile::tempdir().unwrap();
    let rig = rig_file(folder.path(), 34.0);
    let mut canrig = canrig(folder.path(), "run");
    canrig.args(["--bus", "embedded", "--rig"]).arg(&rig);
    let (code, _, stderr) = output(canrig.arg(scenario("step.toml")));
    assert_eq!(code, Some(3), "{stderr}");
    let expected = "the set-point is 35 mm at 10 s, beyond the rig's limits (-1 to 34 mm)";
    assert!(stderr.contains(expected), "{stderr}");
}

/// Returns the text of a rig with one real drive of these keys, its loop, and a cycle of this length.
pub(crate) fn rig_of_a_drive(sync_period_milliseconds: f64, drive: &str) -> String {
    let period = format!("sync_period_milliseconds = {sync_period_milliseconds:?}");
    let rig = changed_rig("one_drive", &[("sync_period_milliseconds = 1.0", &period)]);
    format!("{rig}{drive}\n")
}

/// The terms of a law are frames of canrig's own controller, and leave room for the set-points.
#[test]
fn an_external_controller_sends_no_terms_of_a_law() {
    let mut taken = 0;
    for entry in fs::read_dir(root().join("scenarios")).unwrap().flatten() {
        let path = entry.path();
        if path.extension().is_none_or(|kind| kind != "toml") {
            continue;
        }
        let plan = plan::Plan::load(&path, worlds::catalogue::catalogue()).unwrap();
        let (loops, controller) = (plan.loops.len(), plan.controller().name.clone());
        match plan.with_external(std::slice::from_ref(&controller)) {
            Ok(plan) => {
                let mut loops = plan.loops.iter();
                let terms = |one: &plan::ControlLoop| one.terms(plan.database()).count();
                assert!(loops.all(|one| terms(one) == 0), "{}", path.display());
                taken += 1;
            }
            // Four set-points in each cycle of 1.5 ms are too many.
            Err(why) => assert!(loops == 4 && why.contains("set-points"), "{why}"),
        }
    }
    assert!(taken >= 26, "{taken} scenarios");
}

#[test]
fn a_scenario_that_an_external_controller_leads_needs_no_law() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("led.toml");
    let text = "schema = 1\nrig = \"dc_motor\"\nname = \"led\"\nduration_seconds = 1.0\n\
                [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
    fs::write(&path, text).unwrap();
    let run = |arguments: &[&str]| {
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        canrig.args(arguments).current_dir(folder.path());
        canrig
    };
    for world in [
        &["run", "--bus", "embedded"][..],
        &["run", "--clock", "lockstep", "--bus", "embedded"],
        &["simulate"],
    ] {
        let external = ["led.toml", "--external", "controller"];
        let played = run(&[world, &external].concat());
        expects_its_node(played, folder.path()).unwrap();
    }
    let (code, _, error) = output(&mut run(&["simulate", "led.toml"]));
    assert_eq!(code, Some(3), "{error}");
    assert!(error.contains("no law closes the loop"), "{error}");
    let (code, listed, error) = output(&mut run(&["signals", "led.toml", "--", "true"]));
    assert_eq!(code, Some(0), "{error}");
    assert!(listed.contains("bench_set_point"), "{listed}");
    assert!(!listed.contains("integral_amperes"), "{listed}");
}
