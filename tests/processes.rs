//! The bench with real processes: the remains when one of them is killed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rustix::process::{Pid, Signal, kill_process, test_kill_process};

use crate::programs::drive_and_fan;
use crate::real_time::{Started, in_real_time, wait_for};
use crate::support::{canrig, only_run, output, scenario, unhurried_scenario};

const NODES: [&str; 2] = ["controller", "plant-emulator"];

/// A run in real time that lasts some seconds.
pub(crate) struct Run {
    canrig: Started,
    folder: tempfile::TempDir,
}

impl Run {
    /// Starts a run and waits until the wire is heated.
    pub(crate) fn start(scenario: &Path, clock: &str) -> Self {
        let run = Self::begin(scenario, clock);
        wait_for("the scenario to begin", || run.has_heated());
        run
    }

    /// Starts a run.
    pub(crate) fn begin(scenario: &Path, clock: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let by_itself = canrig(folder.path(), "run");
        // The caller of the tests may have signals ignored.
        let mut canrig = Command::new("env");
        let canrig = canrig
            .arg("--default-signal=INT,HUP,QUIT")
            .arg(by_itself.get_program())
            .args(by_itself.get_args())
            .arg(scenario)
            .args(["--bus", "embedded", "--clock", clock]);
        // The embedded bus and the temporary files are in their own folder, so a test sees the remains there.
        let runtime = folder.path().join("runtime");
        fs::create_dir(&runtime).unwrap();
        let canrig = canrig
            .env("XDG_RUNTIME_DIR", &runtime)
            .env("TMPDIR", runtime)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        Self {
            canrig: Started::new(canrig.spawn().unwrap()),
            folder,
        }
    }

    pub(crate) fn id(&self) -> Pid {
        Pid::from_raw(self.canrig.id().cast_signed()).unwrap()
    }

    fn run_folder(&self) -> Option<std::path::PathBuf> {
        let entries = fs::read_dir(self.folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().path());
        entries.into_iter().find(|path| !path.ends_with("runtime"))
    }

    /// Returns the folder of its bus and of its temporary files.
    pub(crate) fn runtime(&self) -> PathBuf {
        self.folder.path().join("runtime")
    }

    fn log(&self) -> String {
        self.run_folder()
            .and_then(|run| fs::read_to_string(run.join("bus.log")).ok())
            .unwrap_or_default()
    }

    /// Returns whether a current was commanded: RPDO1 of the drive with a target that is not 0.
    fn has_heated(&self) -> bool {
        self.log()
            .lines()
            .any(|line| line.contains(" 210#0F00") && !line.ends_with("0000"))
    }

    /// Returns the process of a node.
    pub(crate) fn node(&self, name: &str) -> Pid {
        self.find_node(name).expect("the node runs")
    }

    pub(crate) fn find_node(&self, name: &str) -> Option<Pid> {
        let children =
            fs::read_to_string(format!("/proc/{0}/task/{0}/children", self.canrig.id())).unwrap();
        let pids = children
            .split_whitespace()
            .map(|pid| pid.parse::<i32>().unwrap());
        let is_node = |pid: &i32| {
            let line = fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            line.split('\0').any(|word| word == name)
        };
        pids.into_iter().find(is_node).and_then(Pid::from_raw)
    }

    pub(crate) fn end(self) -> (Option<i32>, String, tempfile::TempDir) {
        let ended = self.canrig.ended();
        let text =
            String::from_utf8(ended.stdout).unwrap() + &String::from_utf8(ended.stderr).unwrap();
        (ended.status.code(), text, self.folder)
    }
}

pub(crate) fn is_gone(pid: Pid) -> bool {
    // A zombie without a parent to collect it counts as ended.
    let stat =
        fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero())).unwrap_or_default();
    test_kill_process(pid).is_err() || stat.contains(") Z ")
}

pub(crate) fn last_command(log: &str) -> &str {
    log.lines().rfind(|line| line.contains(" 210#")).unwrap()
}

fn verdict(folder: &Path) -> serde_json::Value {
    let entries = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let run = entries
        .into_iter()
        .find(|path| !path.ends_with("runtime"))
        .unwrap();
    serde_json::from_str(&fs::read_to_string(run.join("verdict.json")).unwrap()).unwrap()
}

/// Asserts that a killed node ends the run, which names it.
fn is_named_and_nothing_stays(victim: &str, scenario: &str, clock: &str) {
    let run = Run::start(&crate::support::scenario(scenario), clock);
    let nodes = NODES.map(|node| run.node(node));
    kill_process(run.node(victim), Signal::KILL).unwrap();
    let (code, text, folder) = run.end();
    assert_eq!(code, Some(4), "{text}");
    let expected = format!("the {victim} was killed by signal 9");
    assert!(text.contains(&expected), "{text}");
    assert!(nodes.iter().all(|node| is_gone(*node)));
    assert_eq!(verdict(folder.path())["outcome"], "incomplete");
}

#[test]
fn a_node_killed_in_real_time_is_named_and_nothing_stays() {
    for victim in NODES {
        in_real_time(|| is_named_and_nothing_stays(victim, "step.toml", "real-time"));
    }
}

#[test]
fn a_node_killed_in_lockstep_is_named_and_nothing_stays() {
    for victim in NODES {
        is_named_and_nothing_stays(victim, "sine_20s.toml", "lockstep");
    }
}

/// Writes a rig of `count` drives, each with its own motor and loop, under a steady current. Its cycle is so long that
/// its nodes do not lose each other on a busy machine; `added` is further text of the scenario for each drive, with
/// `NODE` for its name.
fn several_drives(folder: &Path, count: u8, added: &str) -> (PathBuf, Vec<(String, u8)>) {
    let drives = (0..count).map(|number| (format!("drive_{number}"), 0x10 + 2 * number));
    let drives = Vec::from_iter(drives);
    let mut rig = "schema = 1\nname = \"several drives\"\n\
        [bus]\nsync_period_milliseconds = 20.0\n\
        [defaults.drive]\namplifier = { rated = 1.0, min = -1.0, max = 1.0 }\n\
        sensor = { unit = \"millimetres\", min = 0.0, max = 60.0, resolution_bits = 16 }\n\
        [node.controller]\nkind = \"controller\"\nnode_id = 1\n"
        .to_owned();
    let mut scenario =
        "schema = 1\nrig = \"rig.toml\"\nname = \"several drives\"\nduration_seconds = 20.0\n\
        [controller.all.open_loop]\n\
        [[controller.all.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.05\n"
            .to_owned();
    for (drive, node_id) in &drives {
        rig += &format!(
            "[plant.{plant}.dc_motor]\n[node.{drive}]\nkind = \"drive\"\nnode_id = {node_id}\n\
             amplifier.port = \"{plant}.current_amperes\"\nsensor.port = \"{plant}.position_metres\"\n\
             [loop.of_{drive}]\nfeedback = \"{drive}.position\"\noutputs = [\"{drive}.current\"]\n",
            plant = plant_name(drive),
        );
        scenario += &added.replace("NODE", drive);
    }
    fs::write(folder.join("rig.toml"), rig).unwrap();
    let path = folder.join("scenario.toml");
    fs::write(&path, scenario).unwrap();
    (path, drives)
}

fn plant_name(drive: &str) -> String {
    drive.replace("drive", "motor")
}

/// A future fault, with which each plant publishes its current in any state of its drive.
const FAULT_TO_COME: &str =
    "[[fault.sensor.noise]]\nfrom_seconds = 19.0\nnode = \"NODE\"\nnoise_millimetres_rms = 0.01\n";

/// Returns the last current by the plant of a drive.
fn last_current(log: &str, plan: &plan::Plan, one: &plan::ControlLoop) -> f64 {
    let truth = plan::message_of(plan.database(), one.drive(), "truth").unwrap();
    let current = truth.handle(truth.signal("plant_current_amperes").unwrap());
    let frames = log.lines().rev().filter_map(|line| {
        let (id, data) = line.rsplit_once(' ')?.1.split_once('#')?;
        let id = u16::from_str_radix(id, 16).ok()?;
        let bytes = (0..data.len() / 2)
            .map(|place| &data[2 * place..2 * place + 2])
            .map(|byte| u8::from_str_radix(byte, 16).unwrap());
        Some(can::CanFrame::new(id, &Vec::from_iter(bytes)))
    });
    let mut currents = frames.filter_map(|frame| current.decode(&frame));
    currents.next().expect("the plant said it")
}

/// Asserts that a process of several drives that is killed while current flows ends the run, which names it once, and
/// that no current remains in any surviving plant.
fn is_named_and_no_current_stays(count: u8, victim: &str, clock: &str) {
    let folder = tempfile::tempdir().unwrap();
    let (scenario, drives) = several_drives(folder.path(), count, FAULT_TO_COME);
    if clock == "lockstep" {
        // Virtual time is fast, and must still run when the process is killed; the log of a longer run is compressed.
        let text = fs::read_to_string(&scenario).unwrap();
        let long = text.replace("duration_seconds = 20.0", "duration_seconds = 590.0");
        fs::write(&scenario, long).unwrap();
    }
    let plan = plan::Plan::load(&scenario, worlds::catalogue::catalogue()).unwrap();
    let run = Run::start(&scenario, clock);
    let emulators = drives.iter().map(|(drive, _)| run.node(&plant_name(drive)));
    let nodes = Vec::from_iter(emulators.chain([run.node("controller")]));
    let flows = |one| last_current(&run.log(), &plan, one) > 0.0;
    wait_for("the current to flow", || plan.loops.iter().all(flows));
    kill_process(run.node(victim), Signal::KILL).unwrap();
    let run_folder = run.run_folder().unwrap();
    let (code, text, folder) = run.end();
    assert_eq!(code, Some(4), "{text}");
    let node = match drives.iter().find(|(drive, _)| plant_name(drive) == victim) {
        Some((drive, _)) => format!("emulator of {victim} and its drive {drive}"),
        None => victim.to_owned(),
    };
    let expected = format!("the {node} was killed by signal 9");
    assert!(text.contains(&expected), "{text}");
    assert!(nodes.iter().all(|node| is_gone(*node)));
    let verdict = verdict(folder.path());
    assert_eq!(verdict["outcome"], "incomplete");
    let reason = verdict["reason"].as_str().unwrap();
    assert_eq!(reason.matches(&expected).count(), 1, "{reason}");
    let log = fs::read_to_string(run_folder.join("bus.log")).unwrap();
    for (one, (drive, _)) in plan.loops.iter().zip(&drives) {
        if plant_name(drive) != victim {
            assert_eq!(
                last_current(&log, &plan, one),
                0.0,
                "{drive} after {victim}"
            );
        }
        // A drive that ended with its emulator sends no report.
        let is_off = (plant_name(drive) != victim).then_some(true);
        let row = format!("{}.drive_off", one.name());
        assert_eq!(row_passed(&verdict, &row), is_off, "{row} after {victim}");
    }
}

/// Returns whether a row of a verdict passed; `None` if it is not judged.
fn row_passed(verdict: &serde_json::Value, name: &str) -> Option<bool> {
    let mut rows = verdict["metrics"].as_array().unwrap().iter();
    let row = rows.find(|row| row["name"] == name).expect(name);
    row["passed"].as_bool()
}

/// Kills the controller of four drives. The recording shows that each drive is off by its own watches, and a replay
/// with one that is not fails.
fn drives_are_off_by_themselves(clock: &str) {
    let folder = tempfile::tempdir().unwrap();
    let (scenario, drives) = several_drives(folder.path(), 4, "");
    if clock == "lockstep" {
        let text = fs::read_to_string(&scenario).unwrap();
        let long = text.replace("duration_seconds = 20.0", "duration_seconds = 590.0");
        fs::write(&scenario, long).unwrap();
    }
    let run = Run::start(&scenario, clock);
    kill_process(run.node("controller"), Signal::KILL).unwrap();
    let run_folder = run.run_folder().unwrap();
    let (code, text, folder) = run.end();
    assert_eq!(code, Some(4), "{text}");
    let verdict = verdict(folder.path());
    for (drive, node_id) in &drives {
        let row = format!("of_{drive}.drive_off");
        assert_eq!(row_passed(&verdict, &row), Some(true), "{verdict}");
        let heartbeat_error = format!(" {:03X}#3081", 0x080 + u16::from(*node_id));
        let log = fs::read_to_string(run_folder.join("bus.log")).unwrap();
        assert!(log.contains(&heartbeat_error), "{drive}");
    }
    let log = fs::read_to_string(run_folder.join("bus.log")).unwrap();
    let off = "592#4B4160001800";
    assert_eq!(log.matches(off).count(), 1, "{drives:?}");
    let on = log.replace(off, "592#4B4160003702");
    fs::write(run_folder.join("bus.log"), on).unwrap();
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, told, stderr) = output(replay.arg("replay").arg(&run_folder));
    assert_eq!(code, Some(1), "{told}{stderr}");
    assert!(told.contains("drive_1: on 0."), "{told}");
}

/// The drive is the cause of the outcome, and the exit code is that of a run that the bench ended.
#[test]
fn a_controller_killed_beside_a_drive_that_stays_on_is_a_failure_of_the_bench() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = drive_and_fan(folder.path());
    for (file, from, to) in [
        (
            "drive.py",
            "OBJECTS = {",
            "OBJECTS = {(0x6041, 0): 0x0237, ",
        ),
        (
            "step.toml",
            "duration_seconds = 2.0",
            "duration_seconds = 590.0",
        ),
    ] {
        let path = folder.path().join(file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(&path, text.replace(from, to)).unwrap();
    }
    let run = Run::begin(&scenario, "lockstep");
    wait_for("a current", || run.log().contains(" 220#0F00"));
    kill_process(run.node("controller"), Signal::KILL).unwrap();
    let (code, text, folder) = run.end();
    assert_eq!(code, Some(4), "{text}");
    let verdict = verdict(folder.path());
    assert_eq!(verdict["outcome"], "fail", "{verdict}");
    assert_eq!(verdict["cause"]["node"], "drive", "{verdict}");
}

/// Kills the drive of one loop. It is the cause, and the other loop is judged up to that time.
fn other_loops_are_not_judged(clock: &str) {
    let folder = tempfile::tempdir().unwrap();
    let (scenario, _) = several_drives(folder.path(), 2, "");
    let mut text = fs::read_to_string(&scenario).unwrap();
    if clock == "lockstep" {
        text = text.replace("duration_seconds = 20.0", "duration_seconds = 590.0");
    }
    for drive in ["drive_0", "drive_1"] {
        text += &format!("[expect.of_{drive}]\nposition_millimetres_max = {{ max = 50.0 }}\n");
    }
    fs::write(&scenario, text).unwrap();
    let run = Run::start(&scenario, clock);
    kill_process(run.node("motor_1"), Signal::ABORT).unwrap();
    let (code, text, folder) = run.end();
    assert_eq!(code, Some(1), "{text}");
    let verdict = verdict(folder.path());
    assert_eq!(verdict["cause"]["node"], "drive_1");
    let rows = ["of_drive_0", "of_drive_1"].map(|name| format!("{name}.position_millimetres_max"));
    assert_eq!(
        rows.map(|row| row_passed(&verdict, &row)),
        [None, Some(false)]
    );
    assert!(text.contains("not judged, ended by drive_1"), "{text}");
    assert_eq!(
        row_passed(&verdict, "of_drive_0.drive_off"),
        Some(true),
        "{text}"
    );
}

#[test]
fn a_drive_that_dies_leaves_the_other_loops_unjudged() {
    in_real_time(|| other_loops_are_not_judged("real-time"));
}

#[test]
fn a_drive_that_dies_in_lockstep_leaves_the_other_loops_unjudged() {
    other_loops_are_not_judged("lockstep");
}

#[test]
fn four_drives_are_off_after_their_controller_was_killed() {
    in_real_time(|| drives_are_off_by_themselves("real-time"));
}

#[test]
fn four_drives_are_off_after_their_controller_was_killed_in_lockstep() {
    drives_are_off_by_themselves("lockstep");
}

#[test]
fn any_process_of_several_drives_that_is_killed_is_named_and_leaves_no_current() {
    for count in [2, 4] {
        let motors = (0..count).map(|number| format!("motor_{number}"));
        for victim in motors.chain(["controller".to_owned()]) {
            in_real_time(|| is_named_and_no_current_stays(count, &victim, "real-time"));
        }
    }
}

#[test]
fn any_process_of_four_drives_that_is_killed_in_lockstep_is_named_and_leaves_no_current() {
    let motors = (0..4).map(|number| format!("motor_{number}"));
    for victim in motors.chain(["controller".to_owned()]) {
        is_named_and_no_current_stays(4, &victim, "lockstep");
    }
}

#[test]
fn a_process_of_several_drives_that_is_killed_before_the_scenario_begins_is_named() {
    for (victim, node) in [
        ("controller", "controller"),
        ("motor_3", "emulator of motor_3 and its drive drive_3"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let (scenario, _) = several_drives(folder.path(), 4, "");
        let run = Run::begin(&scenario, "real-time");
        wait_for("the node to start", || run.find_node(victim).is_some());
        kill_process(run.node(victim), Signal::KILL).unwrap();
        let (code, text, folder) = run.end();
        assert_eq!(code, Some(4), "{text}");
        let expected = format!("the {node} was killed by signal 9");
        assert!(text.contains(&expected), "{text}");
        assert_eq!(verdict(folder.path())["outcome"], "incomplete");
    }
}

#[test]
fn a_killed_bench_of_several_drives_leaves_no_process_and_no_socket() {
    for count in [2, 4] {
        in_real_time(|| {
            let folder = tempfile::tempdir().unwrap();
            let (scenario, drives) = several_drives(folder.path(), count, "");
            let run = Run::start(&scenario, "real-time");
            let emulators = drives.iter().map(|(drive, _)| run.node(&plant_name(drive)));
            is_tidy_after_the_kill(&run, emulators.chain([run.node("controller")]).collect());
        });
    }
}

/// A hanging drive ends the run, which has its name in the rig file: the controller gives it up.
#[test]
fn a_silent_drive_of_several_is_named() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let (scenario, _) = several_drives(folder.path(), 2, "");
        let run = Run::start(&scenario, "real-time");
        kill_process(run.node("motor_1"), Signal::STOP).unwrap();
        let (code, text, folder) = run.end();
        // The stopped process belongs to canrig: it is named, but does not fail the drive.
        assert_eq!(code, Some(5), "{text}");
        let end = &verdict(folder.path())["ended_early"];
        assert_eq!(end["node"], "drive_1", "{end}");
        let what = end["what"].as_str().unwrap();
        assert!(what.contains("the controller gave it up"), "{what}");
        assert!(what.contains("(node 18"), "{what}");
    });
}

/// A host stall, as of a paused virtual machine: failures during it are not attributed to the nodes.
#[test]
fn a_machine_that_stands_still_leaves_the_run_open_and_a_replay_agrees() {
    in_real_time(is_open_after_a_stop);
}

fn is_open_after_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    let hold = unhurried_scenario(folder.path(), 4.0);
    let runs = folder.path().join("runs");
    let mut canrig = canrig(&runs, "run");
    let canrig = canrig
        .args(["--bus", "embedded"])
        .arg(hold)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let run = Run {
        canrig: Started::new(canrig.spawn().unwrap()),
        folder,
    };
    let log = || {
        let folder = fs::read_dir(&runs).ok().and_then(|mut runs| runs.next());
        let log = folder.map(|folder| folder.unwrap().path().join("bus.log"));
        log.and_then(|log| fs::read_to_string(log).ok())
            .unwrap_or_default()
    };
    wait_for("the scenario to begin", || log().contains(" 210#0F00"));
    let everybody = [run.id(), run.node("controller"), run.node("plant-emulator")];
    for (signal, milliseconds) in [(Signal::STOP, 450), (Signal::CONT, 0)] {
        for process in everybody {
            kill_process(process, signal).unwrap();
        }
        std::thread::sleep(std::time::Duration::from_millis(milliseconds));
    }
    let (code, text, _folder) = run.end();
    assert_eq!(code, Some(5), "{text}");
    let run = only_run(&runs);
    let stalls = fs::read_to_string(run.join("stalls.csv")).unwrap();
    assert!(stalls.contains(",machine,stood still"), "{stalls}");
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, again, stderr) = output(replay.arg("replay").arg(&run));
    assert_eq!(code, Some(5), "{again}{stderr}");
    assert!(
        again.contains("the same verdict as that of the run"),
        "{again}"
    );
    // Without the evidence only the nodes can have left out the cycles.
    fs::remove_file(run.join("stalls.csv")).unwrap();
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, again, stderr) = output(replay.arg("replay").arg(&run));
    assert_eq!(code, Some(1), "{again}{stderr}");
}

#[test]
fn a_killed_bench_leaves_no_process_and_no_socket() {
    in_real_time(|| {
        let run = Run::start(&scenario("step.toml"), "real-time");
        is_tidy_after_the_kill(&run, NODES.map(|node| run.node(node)).into());
    });
}

fn is_tidy_after_the_kill(run: &Run, nodes: Vec<Pid>) {
    kill_process(run.id(), Signal::KILL).unwrap();
    wait_for("the nodes to end", || {
        nodes.iter().all(|node| is_gone(*node))
    });
    wait_for("the socket to be removed", || {
        fs::read_dir(run.runtime()).unwrap().next().is_none()
    });
    assert_eq!(verdict(run.folder.path())["outcome"], "incomplete");
}

#[test]
fn an_interrupted_run_ends_with_the_current_at_0() {
    for signal in [Signal::INT, Signal::HUP, Signal::QUIT] {
        ends_with_the_current_at_0(signal);
    }
}

/// A terminal sends its signals to all processes in it.
fn ends_with_the_current_at_0(signal: Signal) {
    in_real_time(|| {
        let run = Run::start(&scenario("step.toml"), "real-time");
        let nodes = NODES.map(|node| run.node(node));
        for process in [nodes[0], nodes[1], run.id()] {
            kill_process(process, signal).unwrap();
        }
        let log = || run.log();
        wait_for("the nodes to end", || {
            nodes.iter().all(|node| is_gone(*node))
        });
        wait_for("the current to be taken away", || {
            last_command(&log()).ends_with("0000")
        });
        let (code, text, folder) = run.end();
        assert_eq!(code, Some(130), "{text}");
        let verdict = verdict(folder.path());
        assert_eq!(verdict["reason"], "interrupted by the user");
    });
}

#[test]
fn real_time_on_the_embedded_bus_is_recorded_whole() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let short = unhurried_scenario(folder.path(), 3.0);
        let runs = folder.path().join("runs");
        let (code, stdout, stderr) =
            output(canrig(&runs, "run").args(["--bus", "embedded"]).arg(short));
        // On a busy machine the timing may leave the result undecided; the program then reports it.
        assert!(matches!(code, Some(0 | 5)), "{code:?}\n{stdout}\n{stderr}");
        let run = only_run(&runs);
        for name in [
            "scenario.toml",
            "bus.log",
            "signals.csv",
            "verdict.json",
            "junit.xml",
        ] {
            assert!(run.join(name).exists(), "{name} is missing");
        }
        assert!(!stdout.contains("lost"), "{stdout}");
        let verdict = fs::read_to_string(run.join("verdict.json")).unwrap();
        let verdict: serde_json::Value = serde_json::from_str(&verdict).unwrap();
        let timing = &verdict["timing"];
        for name in ["sync_to_position", "position_to_command", "round_trip"] {
            let median = timing[format!("{name}_microseconds")]["median"].as_f64();
            assert!(median.is_some_and(|median| median > 0.0), "{timing}");
        }
        assert!(
            timing["controller"]["ticks"].as_u64() > Some(20),
            "{timing}"
        );
    });
}

#[test]
fn a_node_by_hand_needs_no_bench() {
    // Without a drive the controller gives up with its own message.
    let output = Command::new(env!("CARGO_BIN_EXE_canrig"))
        .args([
            "node",
            "controller",
            "--bus",
            "embedded:/nowhere/bus",
            "--scenario",
        ])
        .arg(scenario("step.toml"))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(4));
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.contains("no bus is at /nowhere/bus"), "{text}");
}
