//! Nodes that programs play: equal in every world, the number of requests, the result of a run when one fails, and the
//! remains.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rustix::io::Errno;
use rustix::process::{Pid as Process, Signal, kill_process};

use crate::laws::{
    IN_LOCKSTEP, IN_REAL_TIME, SIMULATED, is_started_by_a_play_only, is_without_current,
    leaves_nothing_when_killed, numbers, played, processes_in, the_same_bytes,
};
use crate::processes::is_gone;
use crate::real_time::{Started, in_real_time, wait_for};
use crate::support::{canrig, only_run, output, root};

/// Runs `canrig new controller` into a folder of that name; returns its scenario.
fn new_controller(folder: &Path, language: &str) -> PathBuf {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.args(["new", "controller", language, "--language", language]);
    let (code, stdout, stderr) = output(canrig.current_dir(folder));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    folder.join(language).join(format!("{language}.toml"))
}

/// Compiles the controller in C with a change to its header.
fn compile(folder: &Path, change: impl Fn(String) -> String) {
    let header = fs::read_to_string(root().join("include/canrig.h")).unwrap();
    fs::write(folder.join("canrig.h"), change(header)).unwrap();
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-o"]);
    compiler
        .arg(folder.join("controller"))
        .arg(folder.join("controller.c"));
    let (code, _, error) = output(compiler.arg("-lm"));
    assert_eq!(code, Some(0), "{error}");
}

fn in_c(folder: &Path) -> PathBuf {
    let scenario = new_controller(folder, "c");
    compile(&folder.join("c"), |header| header);
    scenario
}

fn read(run: &Path, name: &str) -> Vec<u8> {
    fs::read(run.join(name)).unwrap_or_else(|error| panic!("{}: {name}: {error}", run.display()))
}

#[test]
fn a_controller_in_c_and_one_in_python_leave_the_same_bytes_in_both_worlds() {
    let folder = tempfile::tempdir().unwrap();
    let scenarios = [in_c(folder.path()), new_controller(folder.path(), "python")];
    let verdicts =
        scenarios.map(|scenario| the_same_bytes(&scenario, &scenario.with_file_name("runs")));
    // Both control alike; the difference is rounding.
    let settled = |files: &[Vec<u8>; 3]| {
        let verdict: serde_json::Value = serde_json::from_slice(&files[2]).unwrap();
        assert_eq!(verdict["external"][0], "controller", "{verdict}");
        let files = verdict["identity"]["files"].as_object().unwrap().len();
        assert_eq!(files, 3, "{verdict}");
        verdict["outcome"].clone()
    };
    assert_eq!(settled(&verdicts[0]), settled(&verdicts[1]));
}

#[test]
fn a_program_in_the_place_of_a_scenario_is_told_where_it_stands() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = new_controller(folder.path(), "python");
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let controller = scenario.with_file_name("controller.py");
    canrig.current_dir(folder.path()).arg("simulate");
    let (code, stdout, stderr) = output(canrig.arg(controller));
    assert_eq!(code, Some(3), "{stdout}{stderr}");
    let said = Vec::from_iter(stderr.split_whitespace()).join(" ");
    assert!(said.contains("is a program, not a scenario"), "{said}");
    assert!(
        said.contains("stands behind `--`: canrig simulate SCENARIO -- python3"),
        "{said}"
    );
}

/// A link to an interpreter is not followed: that of a virtual environment finds its packages by where it lies.
#[test]
fn an_interpreter_behind_a_link_is_started_by_the_link() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = new_controller(folder.path(), "python");
    let interpreter = folder.path().join("linked_python");
    let (code, stdout, _) =
        output(Command::new("python3").args(["-c", "import sys; print(sys.executable)"]));
    assert_eq!(code, Some(0));
    std::os::unix::fs::symlink(stdout.trim(), &interpreter).unwrap();
    let mut canrig = canrig(&folder.path().join("runs"), "simulate");
    canrig
        .arg("motor_step")
        .arg("--")
        .arg(&interpreter)
        .arg(scenario.with_file_name("controller.py"));
    let (_, stdout, stderr) = output(&mut canrig);
    assert!((stdout + &stderr).contains(&format!("starts `{}", interpreter.display())));
}

/// The frames of a case are its own, where the scenario of the sweep sends none.
#[test]
fn a_sweep_varies_how_often_set_points_are_sent() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = folder.path().join("sweep.toml");
    let text = "schema = 1\nrig = \"dc_motor\"\nname = \"s\"\nduration_seconds = 0.2\n[controller.pid]\n\
                proportional_amperes_per_metre = 64.8\nintegral_amperes_per_metre_second = 489.0\n\
                derivative_ampere_seconds_per_metre = 3.74\n\
                [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
                [[sweep.list]]\nkey = \"bus.set_points_every_cycles\"\nvalues = [0, 1, 5]\n";
    fs::write(&sweep, text).unwrap();
    let mut canrig = canrig(&folder.path().join("runs"), "sweep");
    let (code, stdout, stderr) = output(canrig.arg(&sweep));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert!(stdout.contains("3 runs: 3 pass"), "{stdout}");
}

/// Without the flag of 29 bits the kernel would cut 0x800 to 0x000, NMT.
#[test]
fn an_identifier_that_would_be_cut_is_refused_in_c() {
    let folder = tempfile::tempdir().unwrap();
    let source = r#"
#include "canrig.h"

#include <stdio.h>

static canrig bus;

static int sends(uint32_t id) {
    canrig_frame frame = {.id = id, .length = 1};
    return canrig_send(&bus, &frame);
}

static int opens(canrig_filter filter) {
    const canrig_options options = {"test", &filter, 1, &filter, 1, 0};
    return canrig_open(&bus, "lockstep:/nowhere", &options);
}

int main(void) {
    const canrig_filter cut = CANRIG_EXACT(0x800), standard = CANRIG_EXACT(0x7FF);
    const canrig_filter extended = CANRIG_EXACT(CAN_EFF_FLAG | 0x800);
    printf("%d %d %d ", opens(cut), opens(standard), opens(extended));
    bus.is_over = 0;
    bus.kind = CANRIG_LOCKSTEP_;
    printf("%d %d %d %d", sends(0x800), sends(0x1FFFFFFF), sends(0x7FF), sends(CAN_EFF_FLAG | 0x800));
    return extended.mask != (CAN_EFF_FLAG | CAN_RTR_FLAG | CAN_EFF_MASK);
}
"#;
    fs::write(folder.path().join("controller.c"), source).unwrap();
    compile(folder.path(), |header| header);
    let (code, said, _) = output(&mut Command::new(folder.path().join("controller")));
    let [invalid, missing] = [Errno::INVAL, Errno::NOENT].map(|error| -error.raw_os_error());
    assert_eq!(
        (code, said),
        (
            Some(0),
            format!("{invalid} {missing} {missing} {invalid} {invalid} 0 0")
        )
    );
}

/// Copies the files of `tests/data/programs`: a drive and a fan in Python, and a scenario for both.
pub(crate) fn drive_and_fan(folder: &Path) -> PathBuf {
    let data = root().join("tests/data/programs");
    for entry in fs::read_dir(data).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, folder.join(path.file_name().unwrap())).unwrap();
    }
    for (from, to) in [
        ("tests/foreign/servo.eds", "servo.eds"),
        ("python/canrig/node.py", "canrig_node.py"),
    ] {
        fs::copy(root().join(from), folder.join(to)).unwrap();
    }
    folder.join("step.toml")
}

#[test]
fn a_drive_and_an_io_node_may_be_programs() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = drive_and_fan(folder.path());
    let mut logs = Vec::new();
    for (number, world) in [SIMULATED, IN_LOCKSTEP].into_iter().enumerate() {
        let (code, said, run) = played(&scenario, &folder.path().join(number.to_string()), world);
        assert_eq!(code, Some(0), "{said}");
        let set = String::from_utf8(read(&run, "fan.log")).unwrap();
        let set = Vec::from_iter(set.lines().filter_map(|line| line.split_once(' ')));
        // These are factors of 5 and of 1, in thousandths.
        assert_eq!(
            set.iter().map(|one| one.1).collect::<Vec<_>>(),
            ["88130000", "e8030000"]
        );
        logs.push(["bus.log", "signals.csv"].map(|name| read(&run, name)));
    }
    assert!(logs[0] == logs[1]);
}

/// The limits of a real drive are watched in every world.
#[test]
fn a_program_that_leaves_the_limits_of_its_drive_is_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = drive_and_fan(folder.path());
    let mut logs = Vec::new();
    for (number, world) in [SIMULATED, IN_LOCKSTEP].into_iter().enumerate() {
        let runs = folder.path().join(number.to_string());
        let mut canrig = canrig(&runs, world[0]);
        canrig.env("DRIVE_JUMPS_TO_MILLIMETRES", "50");
        let (code, stdout, stderr) = output(canrig.arg(&scenario).args(&world[1..]));
        let said = Vec::from_iter((stdout + &stderr).split_whitespace()).join(" ");
        assert_eq!(code, Some(1), "{said}");
        assert!(
            said.contains("canrig stopped the drive: limit of the rig"),
            "{said}"
        );
        let log = String::from_utf8(read(&only_run(&runs), "bus.log")).unwrap();
        assert!(
            frames(&log).any(|frame| frame == ("000", "0220")),
            "NMT Stop"
        );
        logs.push(log);
    }
    assert_eq!(logs[0], logs[1]);
    in_real_time(|| is_stopped_in_real_time(&scenario));
}

/// The frames by which the bench stops the drive are its own, not those of a second master.
fn is_stopped_in_real_time(scenario: &Path) {
    let runs = scenario.with_file_name("real");
    let _ = fs::remove_dir_all(&runs);
    let mut canrig = canrig(&runs, "run");
    canrig.env("DRIVE_JUMPS_TO_MILLIMETRES", "50");
    let options = ["--bus", "embedded", "--no-heating"];
    let (code, stdout, stderr) = output(canrig.arg(scenario).args(options));
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    let run = only_run(&runs);
    let verdict: serde_json::Value = serde_json::from_slice(&read(&run, "verdict.json")).unwrap();
    assert_eq!(verdict["cause"]["node"], "drive", "{verdict}");
    assert_eq!(verdict["cause"]["duty"], "limit", "{verdict}");
    let sent = String::from_utf8(read(&run, "sent.csv")).unwrap();
    assert!(sent.contains("\nbench,0x000,1\n"), "{sent}");
    let (code, text, _) = output(
        Command::new(env!("CARGO_BIN_EXE_canrig"))
            .arg("replay")
            .arg(&run),
    );
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("the same verdict as that of the run"),
        "{text}"
    );
}

/// Returns each frame of a log: identifier and data.
fn frames(log: &str) -> impl Iterator<Item = (&str, &str)> {
    let frames = log.lines().filter_map(|line| line.rsplit(' ').next());
    frames.filter_map(|word| word.split_once('#'))
}

/// A controller that takes the set-point from frames while it sends the SYNC after them gives the same run as one that
/// computes it from its part.
#[test]
fn the_bench_tells_the_set_point_of_the_next_sync() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = new_controller(folder.path(), "python");
    let log = |scenario: &Path, name: &str| {
        let (code, said, run) = played(scenario, &scenario.with_file_name(name), SIMULATED);
        assert!(matches!(code, Some(0 | 1)), "{said}");
        String::from_utf8(read(&run, "bus.log")).unwrap()
    };
    let computed = log(&scenario, "computed");
    let controller = scenario.with_file_name("controller.py");
    let source = fs::read_to_string(&controller).unwrap();
    let mut followed = source.clone();
    for (from, to) in [
        ("filters = [", "filters = [0x301, "),
        (
            "        if frame.id == HEART",
            "        if frame.id == 0x301:\n            told = PART.loops[0].set_points.decode(frame.data)\n            self.told = told[\"set_point_millimetres\"]\n        elif frame.id == HEART",
        ),
        (
            "            self.sync_at = self.bus.now_ns\n",
            "            self.sync_at = self.bus.now_ns\n            self.wanted = getattr(self, \"told\", 0.0)\n",
        ),
        (
            "wanted = PART.loops[0].set_point((self.sync_at - self.zero) / 1e9)",
            "wanted = self.wanted",
        ),
    ] {
        assert_eq!(followed.matches(from).count(), 1, "{from}");
        followed = followed.replace(from, to);
    }
    fs::write(&controller, followed).unwrap();
    assert_eq!(log(&scenario, "followed"), computed);
    fs::write(&controller, source).unwrap();

    let count = |log: &str, wanted: &str| frames(log).filter(|(id, _)| *id == wanted).count();
    let syncs = count(&computed, "080");
    assert!(count(&computed, "301").abs_diff(syncs) <= 1, "{syncs}");
    // The set-points are 10 and 35 mm, each without a rate.
    let is_told = |(id, data): (&str, &str)| {
        id != "301" || ["0000204100000000", "00000C4200000000"].contains(&data)
    };
    assert!(frames(&computed).all(is_told));
    let text = fs::read_to_string(&scenario).unwrap();
    for (every, least, most) in [(0, 0, 0), (5, syncs / 5 - 20, syncs / 5 + 100)] {
        let other = scenario.with_file_name(format!("every_{every}.toml"));
        fs::write(
            &other,
            format!("{text}\n[bus]\nset_points_every_cycles = {every}\n"),
        )
        .unwrap();
        let told = count(&log(&other, &every.to_string()), "301");
        assert!((least..=most).contains(&told), "{every}: {told} of {syncs}");
    }
    let (_, listed, _) = output(
        Command::new(env!("CARGO_BIN_EXE_canrig"))
            .arg("signals")
            .arg(&scenario),
    );
    assert!(listed.contains("bench_set_point"), "{listed}");
}

/// Returns the requests for each SYNC to a controller in C with a change to its header.
fn questions_a_cycle(change: impl Fn(String) -> String) -> f64 {
    let folder = tempfile::tempdir().unwrap();
    let scenario = new_controller(folder.path(), "c");
    let folder = scenario.parent().unwrap();
    let source = fs::read_to_string(folder.join("controller.c")).unwrap();
    let prints = "canrig_close(&bus);\n    printf(\"%lu\\n\", canrig_questions);";
    let source = source.replacen("canrig_close(&bus);", prints, 1);
    fs::write(folder.join("controller.c"), source).unwrap();
    compile(folder, |header| {
        let asked = "    bus->is_asked = 1;\n";
        assert!(header.contains(asked));
        let counted = header.replacen(asked, &format!("{asked}    canrig_questions++;\n"), 1);
        let counter = "static unsigned long canrig_questions;\n/* Whether nobody answers";
        change(counted.replacen("/* Whether nobody answers", counter, 1))
    });
    let (code, said, run) = played(&scenario, &folder.join("runs"), SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    let questions = String::from_utf8(read(&run, "controller.log")).unwrap();
    let log = String::from_utf8(read(&run, "bus.log")).unwrap();
    let cycles = log.lines().filter(|line| line.contains(" 080#")).count();
    questions.trim().parse::<f64>().unwrap() / cycles as f64
}

#[test]
fn a_controller_is_asked_about_once_a_cycle_and_twice_where_it_promises_nothing() {
    let asked = questions_a_cycle(|header| header);
    assert!((0.9..=1.2).contains(&asked), "{asked}");
    let asked = questions_a_cycle(|header| {
        let quiet = "{ return id <= CAN_SFF_MASK &&";
        assert!(header.contains(quiet));
        let silent = "silent = options->silent_count,";
        assert!(header.contains(silent));
        let header = header.replacen(quiet, "{ return 0 && id <= CAN_SFF_MASK &&", 1);
        header.replacen(silent, "silent = 0,", 1)
    });
    assert!((1.9..=2.2).contains(&asked), "{asked}");
}

#[test]
fn a_controller_plays_in_real_time_and_ends_with_its_lifeline() {
    let folder = tempfile::tempdir().unwrap();
    for scenario in [in_c(folder.path()), new_controller(folder.path(), "python")] {
        in_real_time(|| {
            let runs = scenario.with_file_name("runs");
            let _ = fs::remove_dir_all(&runs);
            let (code, said, run) = played(&scenario, &runs, IN_REAL_TIME);
            // On a busy machine cycles are missed.
            assert!(matches!(code, Some(0 | 1 | 5)), "{said}");
            assert!(said.contains("controller: starts `"), "{said}");
            assert!(!said.contains("when it was to stop"), "{said}");
            is_without_current(&run);
        });
    }
}

#[test]
fn a_program_of_the_command_line_takes_the_place_of_the_law() {
    let folder = tempfile::tempdir().unwrap();
    in_c(folder.path());
    new_controller(folder.path(), "python");
    let mut first: Option<[Vec<u8>; 2]> = None;
    for (number, program) in [
        &["c/controller", "--verbose"][..],
        &["c/controller", "--verbose"],
        &["python3", "python/controller.py"],
    ]
    .into_iter()
    .enumerate()
    {
        let runs = folder.path().join(number.to_string());
        let mut canrig = canrig(&runs, "simulate");
        canrig.args(["motor_step", "--"]).args(program);
        let (code, stdout, stderr) = output(canrig.current_dir(folder.path()));
        let said = stdout + &stderr;
        assert!(matches!(code, Some(0 | 1)), "{said}");
        assert!(
            said.contains("[controller] of the scenario is left out"),
            "{said}"
        );
        let run = only_run(&runs);
        let verdict: serde_json::Value =
            serde_json::from_slice(&read(&run, "verdict.json")).unwrap();
        let file = format!(
            "program/{}",
            program[number / 2].rsplit('/').next().unwrap()
        );
        assert!(verdict["identity"]["files"][&file].is_string(), "{verdict}");
        if number < 2 {
            let files = ["bus.log", "verdict.json"].map(|name| read(&run, name));
            assert!(*first.get_or_insert_with(|| files.clone()) == files);
        }
        // The folder can be judged, and played again, in its place.
        let (code, stdout, stderr) = output(
            Command::new(env!("CARGO_BIN_EXE_canrig"))
                .arg("replay")
                .arg(&run),
        );
        assert!(
            stdout.contains("the same verdict"),
            "{code:?} {stdout}{stderr}"
        );
        let again = folder.path().join(format!("{number}-again"));
        let (code, said, again) = played(&run.join("scenario.toml"), &again, SIMULATED);
        assert!(matches!(code, Some(0 | 1)), "{said}");
        assert_eq!(read(&again, "bus.log"), read(&run, "bus.log"));
    }
}

#[test]
fn a_sweep_varies_the_plant_of_a_program() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = in_c(folder.path());
    let text = fs::read_to_string(&scenario).unwrap();
    let swept = scenario.with_file_name("swept.toml");
    let sweep = "[[sweep.list]]\nkey = \"plant.motor.load_kilograms\"\nvalues = [0.1, 0.2, 0.3]\n";
    fs::write(&swept, text + sweep).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "sweep").arg(&swept));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert!(
        stderr.contains("controller: starts `./controller` in "),
        "{stderr}"
    );
    let table = String::from_utf8(read(&only_run(&runs), "runs.csv")).unwrap();
    assert_eq!(table.lines().count(), 4, "{table}");
}

#[test]
fn an_external_controller_comes_to_its_seat_in_virtual_time() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = in_c(folder.path());
    let by_canrig = played(&scenario, &folder.path().join("started"), SIMULATED);
    assert_eq!(by_canrig.0, Some(0), "{}", by_canrig.1);
    for (number, world) in [
        &["simulate"][..],
        &["run", "--clock", "lockstep", "--bus", "embedded"],
    ]
    .into_iter()
    .enumerate()
    {
        let runs = folder.path().join(number.to_string());
        let mut canrig = canrig(&runs, world[0]);
        canrig
            .args(&world[1..])
            .arg(&scenario)
            .args(["--external", "controller"]);
        let said = folder.path().join(format!("said{number}"));
        canrig.stdout(fs::File::create(&said).unwrap());
        let canrig = Started::new(canrig.stderr(Stdio::null()).spawn().unwrap());
        let address = || {
            let text = fs::read_to_string(&said).unwrap_or_default();
            let (_, rest) = text.split_once("controller: expected at ")?;
            rest.split_once('\n').map(|(address, _)| address.to_owned())
        };
        wait_for("the address", || address().is_some());
        let part = folder.path().join("part.json");
        let text = r#"{"bus":{"period_seconds":0.001},"loops":[{"command_range":[-1.0,1.0],"drive":{"name":"drive","node_id":16},
            "set_point":[[0.0,10.0],[2.0,10.0],[2.0,35.0],[4.0,35.0]]}]}"#;
        fs::write(&part, text).unwrap();
        let mut controller = Command::new(folder.path().join("c/controller"));
        controller
            .env("CANRIG_BUS", address().unwrap())
            .env("CANRIG_PART", &part);
        let (code, _, error) = output(&mut controller);
        assert_eq!(code, Some(0), "{error}");
        let ended = canrig.ended();
        assert!(
            ended.status.success(),
            "{}",
            fs::read_to_string(&said).unwrap()
        );
        assert_eq!(
            read(&only_run(&runs), "bus.log"),
            read(&by_canrig.2, "bus.log")
        );
    }
}

#[test]
fn a_node_that_does_not_come_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = new_controller(folder.path(), "python");
    let arguments = ["simulate", "--external", "controller"];
    let (code, said, run) = played(&scenario, &folder.path().join("runs"), &arguments);
    assert_eq!(code, Some(1), "{said}");
    assert!(
        said.contains("controller: did not come to its seat in 15 s"),
        "{said}"
    );
    assert!(run.join("report.html").exists());
}

/// A manual player of the protocol: `take` a seat, `ask` gives the number, the end and the frames of the next grant,
/// `answer` answers it; `play` leads the drive, with a current, for a number of grants.
const SEAT: &str = r#"
import os, signal, socket, struct, sys, time
HEADER = struct.Struct("<BBHIQ")
RECORD = struct.Struct("<QIBBH8s")
channel = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
EXACT = 0xC00007FF
def connect():
    channel.connect(os.environ["CANRIG_BUS"].partition(":")[2])
def hello(version=1, magic=0x47495243, seat=0, filters=(0x190, 0x590, 0x710)):
    head = HEADER.pack(1, version, len(filters), magic, 0) + struct.pack("<BBHI32s", seat, 0, 0, 0, b"test")
    channel.send(head + b"".join(struct.pack("<II", one, EXACT) for one in filters))
def take():
    connect()
    hello()
    return channel.recv(1 << 17)
def ask():
    message = channel.recv(1 << 17)
    if not message:
        sys.exit(0)
    kind, _, count, number, to = HEADER.unpack_from(message)
    if kind == 5:
        done(number, to, a=1)
        sys.exit(0)
    return number, to, list(RECORD.iter_unpack(message[24:]))
def frame(time, identifier, data=b"", length=None, flags=0):
    return RECORD.pack(time, identifier, len(data) if length is None else length, flags, 0, data)
def done(number, reached, *frames, next=(1 << 64) - 1, a=0, kind=4, count=None, text=b""):
    count = len(frames) if count is None else count
    channel.send(HEADER.pack(kind, a, count, number, next) + struct.pack("<Q", reached) + b"".join(frames) + text)
OBJECTS = [bytes.fromhex(text) for text in ("23161001e8030100", "23061000204e0000", "2f6060000a000000")]
class Lead:
    PERIOD = 20_000_000
    def __init__(self):
        self.step, self.is_up, self.tick, self.sync = 0, False, 0, None
    def answer(self, number, to, frames):
        out = []
        for at, identifier, length, _, _, data in frames:
            if identifier == 0x710:
                self.is_up |= data[:length] == b"\0"
            elif identifier == 0x590 and self.step < 4:
                self.on_step(out, at)
            elif identifier == 0x190:
                status = data[0] | data[1] << 8
                word = 6 if status & 0x4F == 0x40 else 7 if status & 0x6F == 0x21 else 0x80 if status & 0x4F == 8 else 15
                out.append(frame(at, 0x210, struct.pack("<Hh", word, 200 if status & 0x6F == 0x27 else 0)))
        if to >= self.tick:
            self.tick = to + 10_000_000
            out.append(frame(to, 0x701, b"\x05"))
            if not self.is_up:
                out.append(frame(to, 0, b"\x82\x10"))
            elif self.step == 0:
                self.on_step(out, to)
            elif self.step == 4 and self.sync is None:
                self.sync = to
        if self.sync is not None and to >= self.sync:
            out.append(frame(to, 0x080))
            self.sync += self.PERIOD
        done(number, to, *out, next=min(self.tick, self.sync or self.tick))
    def on_step(self, out, at):
        out.append(frame(at, 0x610, OBJECTS[self.step]) if self.step < 3 else frame(at, 0, b"\x01\x00"))
        self.step += 1
lead = Lead()
def play(grants=1 << 40):
    for _ in range(grants):
        lead.answer(*ask())
def enabled():
    """Plays until there is a current."""
    play(700)
"#;

/// Writes a scenario whose controller is a program with these statements. The cycle is so long that the nodes do not
/// lose each other on a busy machine.
fn controller_that(folder: &Path, does: &str) -> PathBuf {
    fs::write(folder.join("seat.py"), SEAT).unwrap();
    fs::write(
        folder.join("node.py"),
        format!("from seat import *\n{does}\n"),
    )
    .unwrap();
    let path = folder.join("node.toml");
    let text = "schema = 1\nrig = \"dc_motor\"\nname = \"node\"\nduration_seconds = 6.0\n\
         [bus]\nsync_period_milliseconds = 20.0\n\
         [node.controller]\nprogram = [\"python3\", \"node.py\"]\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn the_leader_of_these_tests_leads() {
    let folder = tempfile::tempdir().unwrap();
    let node = controller_that(folder.path(), "take()\nplay()");
    let (code, said, run) = played(&node, &folder.path().join("runs"), SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    let log = String::from_utf8(read(&run, "bus.log")).unwrap();
    let current = log
        .lines()
        .position(|line| line.contains(" 210#0F00C800"))
        .unwrap();
    let current = log.lines().take(current).count();
    assert!(log.lines().count() > current);
}

/// Statements of a program, and the resulting message.
const HOSTILE: [(&str, &str); 27] = [
    ("sys.exit(3)", "exited with code 3"),
    (
        "connect()\nchannel.close()\nsys.exit(4)",
        "exited with code 4",
    ),
    (
        "connect()\nchannel.send(b'GET / HTTP/1.1')\ntime.sleep(60)",
        "byte 14: a message has 16 bytes",
    ),
    (
        "connect()\nhello(version=9)\nask()",
        "byte 1: version 9, where 1 is spoken",
    ),
    (
        "connect()\nhello(seat=1)\nask()",
        "byte 16: seat 1, and a node's is 0",
    ),
    (
        "connect()\nhello(filters=range(600))\nask()",
        "byte 2: 600 filters, where 512 is the limit",
    ),
    ("connect()\nhello()\nsys.exit(5)", "exited with code 5"),
    (
        "take()\nenabled()\nprint('oh no')\nsys.exit(7)",
        "exited with code 7",
    ),
    ("take()\nenabled()\nos.abort()", "was ended by signal 6"),
    (
        "take()\nenabled()\nask()\nsys.exit(0)",
        "exited with code 0",
    ),
    (
        "take()\nenabled()\nchannel.close()\ntime.sleep(60)",
        "closed its channel",
    ),
    (
        "take()\nenabled()\nos.closerange(0, 100)\ntime.sleep(60)",
        "closed its channel",
    ),
    (
        "take()\nenabled()\nchannel.send(b'x' * 150_000)\nplay()",
        "byte 0: kind 120, where DONE is 4",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t, kind=99)\nplay()",
        "byte 0: kind 99, where DONE is 4",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n - 1, t)\nplay()",
        "and ",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\nwhile True: done(n, t)",
        "was asked",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t - 1)\nplay()",
        "byte 16: it reached",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t + (1 << 40))\nplay()",
        "byte 16: it reached",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t, frame(t - 10 ** 9, 0x80))\nplay()",
        "byte 24: frame 080#",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t, frame(t, 0x80, length=64))\nplay()",
        "byte 36: a frame of 64 bytes",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t, frame(t, 0x80, flags=4))\nplay()",
        "with flags 0x04",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t, frame(t, 0x20000080))\nplay()",
        "an error frame, which no node sends",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t, count=2000)\nplay()",
        "byte 2: 2000 frames, where 1024 is the limit",
    ),
    (
        "take()\nenabled()\nwhile True:\n    n, t, f = ask()\n    done(n, t, next=t)",
        "its deadline does not move",
    ),
    (
        "take()\nenabled()\nwhile True:\n    n, t, f = ask()\n    done(n, t, *[frame(t, 0x7FF)] * 1000, next=t + 1)",
        "the bus cannot carry what it sends",
    ),
    (
        "take()\nenabled()\nn, t, f = ask()\ndone(n, t, a=2, text=b'no gain')\ntime.sleep(60)",
        "no gain",
    ),
    (
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\ntake()\ntry:\n    play()\nexcept SystemExit:\n    time.sleep(60)",
        "was ended by signal 9",
    ),
];

/// Returns the errors after a run of a hostile program.
fn amiss(node: &Path, said: &str, world: &[&str]) -> Vec<String> {
    let folder = node.parent().unwrap();
    let (code, text, run) = played(node, &folder.join(world[0]), world);
    let files = [
        "report.html",
        "verdict.json",
        "junit.xml",
        "bus.log",
        "frames.dbc",
    ];
    let missing = files.into_iter().filter(|name| !run.join(name).exists());
    let mut amiss = Vec::from_iter(missing.map(str::to_owned));
    let end = text.split_once("FAIL: ").map_or("nothing", |(_, end)| end);
    if code != Some(1) || !end.contains(said) || !end.starts_with("controller: ") {
        amiss.push(format!("{code:?}, not `{said}`: {end}"));
    }
    match processes_in(folder) {
        0 => {}
        left => amiss.push(format!("{left} processes are left")),
    }
    amiss
}

#[test]
fn a_program_that_breaks_is_named_and_the_folder_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let mut all_amiss = Vec::new();
    for (number, (does, said)) in HOSTILE.into_iter().enumerate() {
        let folder = folder.path().join(number.to_string());
        fs::create_dir(&folder).unwrap();
        let node = controller_that(&folder, does);
        // One in four runs in the other world, too.
        let worlds = [SIMULATED, IN_LOCKSTEP];
        for world in &worlds[..1 + usize::from(number % 4 == 0)] {
            let amiss = amiss(&node, said, world);
            all_amiss.extend(amiss.into_iter().map(|amiss| format!("{does}: {amiss}\n")));
        }
    }
    assert!(all_amiss.is_empty(), "{}", all_amiss.concat());
}

#[test]
fn a_program_that_reads_nothing_is_named_after_its_patience() {
    let folder = tempfile::tempdir().unwrap();
    let node = controller_that(folder.path(), "take()\nenabled()\ntime.sleep(60)");
    for (patience, said) in [
        ("0.5", "gave no answer within 0 s"),
        ("2", "gave no answer within 2 s"),
    ] {
        let arguments = ["simulate", "--quiet", "--patience", patience];
        let runs = folder.path().join(patience);
        let (code, text, run) = played(&node, &runs, &arguments);
        assert_eq!(code, Some(1), "{text}");
        assert!(text.contains(said), "{text}");
        assert!(run.join("report.html").exists());
    }
}

/// Two processes that refuse to end, the second in its own session; their numbers are in a file.
const STUBBORN: &str = "
signal.signal(signal.SIGTERM, signal.SIG_IGN)
numbers = open('numbers', 'w')
print(os.getpid(), file=numbers, flush=True)
if os.fork() == 0:
    os.setsid()
    print(os.getpid(), file=numbers, flush=True)
    channel.close()
    while True: time.sleep(60)
take()
play(300)
while True: time.sleep(60)
";

#[test]
fn a_killed_canrig_leaves_no_node() {
    let folder = tempfile::tempdir().unwrap();
    let node = controller_that(folder.path(), STUBBORN);
    leaves_nothing_when_killed(&node, canrig);
}

#[test]
fn a_node_whose_keeper_is_killed_is_named_with_that_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    let node = controller_that(folder.path(), STUBBORN);
    let mut canrig = canrig(&folder.path().join("runs"), "simulate");
    canrig
        .arg(&node)
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    let canrig = Started::new(canrig.spawn().unwrap());
    wait_for("the program", || numbers(folder.path()).len() == 2);
    let left = numbers(folder.path());
    let stat = fs::read_to_string(format!("/proc/{}/stat", left[0].as_raw_nonzero())).unwrap();
    let keeper = stat.rsplit(") ").next().unwrap().split(' ').nth(1).unwrap();
    let keeper = Process::from_raw(keeper.parse().unwrap()).unwrap();
    kill_process(keeper, Signal::KILL).unwrap();
    let ended = canrig.ended();
    let said = String::from_utf8(ended.stdout).unwrap();
    assert_eq!(ended.status.code(), Some(1), "{said}");
    assert!(said.contains("was killed with its keeper"), "{said}");
    wait_for("the end of the program", || is_gone(left[0]));
    // No process is left that knows of it.
    kill_process(left[1], Signal::KILL).unwrap();
}

#[test]
fn a_grandchild_ends_with_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let does = STUBBORN
        .replace("play(300)\nwhile True: time.sleep(60)", "play()")
        .replace("signal.signal(signal.SIGTERM, signal.SIG_IGN)\n", "");
    let node = controller_that(folder.path(), &does);
    let (code, said, _) = played(&node, &folder.path().join("runs"), SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    let numbers = numbers(folder.path());
    assert_eq!(numbers.len(), 2);
    assert!(numbers.into_iter().all(is_gone));
}

#[test]
fn a_seat_is_taken_once_and_the_environment_says_what_a_node_may_know() {
    let folder = tempfile::tempdir().unwrap();
    let does = "take()\nsecond = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)\n\
         print(second.connect_ex(os.environ['CANRIG_BUS'].partition(':')[2]))\n\
         for name in ('NODE', 'NODE_ID', 'CLOCK', 'SEED'): print(os.environ['CANRIG_' + name])\n\
         print(os.fstat(int(os.environ['CANRIG_LIFELINE'])).st_mode >> 12)\n\
         print(open(os.environ['CANRIG_PART']).read(), os.getcwd(), sys.stdin.read())\nplay()";
    let node = controller_that(folder.path(), does);
    let (code, said, run) = played(&node, &folder.path().join("runs"), SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    let log = String::from_utf8(read(&run, "controller.log")).unwrap();
    let place = folder.path().canonicalize().unwrap();
    // ENOENT: the socket is gone. A pipe is 1.
    assert!(
        log.starts_with("2\ncontroller\n1\nvirtual\n0\n1\n{\""),
        "{log}"
    );
    assert!(log.trim().ends_with(&place.display().to_string()), "{log}");
    for hidden in ["plant", "resistance", "settling", "overshoot"] {
        assert!(!log.contains(hidden), "{hidden}: {log}");
    }
}

#[test]
fn a_million_lines_hold_up_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let does = "take()\nfor number in range(1_000_000): print('a line of output', number)\nplay()";
    let node = controller_that(folder.path(), does);
    let world = [IN_LOCKSTEP, &["--patience", "300"]].concat();
    let (code, said, run) = played(&node, &folder.path().join("runs"), &world);
    assert_eq!(code, Some(0), "{said}");
    let log = read(&run, "controller.log");
    let end = String::from_utf8_lossy(&log[16 << 20..]).into_owned();
    assert!(end.trim().ends_with("bytes more are not kept)"), "{end}");
}

#[test]
fn nothing_is_started_by_what_plays_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let does = format!("open({:?}, 'w')\ntake()\nplay()", place("started"));
    let node = controller_that(folder.path(), &does);
    is_started_by_a_play_only(&node, &place("node.py"), &place("started"));
}

#[test]
fn played_twice_the_first_frame_that_differs_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let random = "take()\nenabled()\nn, t, f = ask()\ndone(n, t, frame(t, 0x7F0, os.urandom(8)), next=t)\nplay()";
    let twice = ["simulate", "--twice"];
    for (name, does, code, said) in [
        ("same", "take()\nplay()", 0, "played twice: the same "),
        ("random", random, 1, "node.toml: two plays differ at "),
    ] {
        let folder = folder.path().join(name);
        fs::create_dir(&folder).unwrap();
        let node = controller_that(&folder, does);
        let (ended, text, _) = played(&node, &folder.join("runs"), &twice);
        assert_eq!(ended, Some(code), "{text}");
        assert!(text.contains(said), "{text}");
        assert_eq!(text.contains(": 7F0#"), code == 1, "{text}");
    }
    let controller = new_controller(folder.path(), "python");
    let random = controller.with_file_name("controller.py");
    let text = fs::read_to_string(&random).unwrap();
    let wrong = text.replace(
        "round(1000 * amperes)",
        "__import__('os').urandom(1)[0] % 9",
    );
    assert_ne!(text, wrong);
    fs::write(&random, wrong).unwrap();
    let (ended, text, _) = played(&controller, &folder.path().join("runs"), &twice);
    assert_eq!(ended, Some(1), "{text}");
    assert!(text.contains(" of controller at "), "{text}");
    // More frames than a recorded run keeps in memory.
    let long = ["simulate", "--twice", "--set", "duration_seconds=70.0"];
    let step = root().join("scenarios/step.toml");
    let (_, text, _) = played(&step, &folder.path().join("long"), &long);
    assert!(text.contains("played twice: the same 3"), "{text}");
}

#[test]
fn a_crash_and_a_hang_happen_to_a_program_alike_in_both_worlds() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = in_c(folder.path());
    let text = fs::read_to_string(&scenario).unwrap();
    for (fault, resets) in [("crash", 2), ("hang", 1)] {
        let table = format!(
            "[[fault.node.{fault}]]\nnode = \"controller\"\nfrom_seconds = 1.0\nuntil_seconds = 1.5\n[expect]"
        );
        let path = scenario.with_file_name(format!("{fault}.toml"));
        fs::write(&path, text.replacen("[expect]", &table, 1)).unwrap();
        let mut logs = Vec::new();
        for world in [SIMULATED, IN_LOCKSTEP] {
            let runs = folder.path().join(format!("{fault}-{}", world[0]));
            let (code, said, run) = played(&path, &runs, world);
            assert!(matches!(code, Some(0 | 1)), "{said}");
            assert!(!said.contains("when it was to stop"), "{said}");
            let log = String::from_utf8(read(&run, "bus.log")).unwrap();
            let seen = log
                .lines()
                .filter(|line| line.contains(" 000#8210"))
                .count();
            assert!(
                (resets..=resets + 1).contains(&seen),
                "{fault}: {seen} resets"
            );
            logs.push(log);
        }
        assert!(logs[0] == logs[1], "{fault}");
    }
}

#[test]
fn a_program_from_elsewhere_is_refused_at_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let node = controller_that(folder.path(), "take()\nplay()");
    let text = fs::read_to_string(&node).unwrap();
    let fault = |table: &str| {
        format!("[[fault.{table}]]\nnode = \"controller\"\nfrom_seconds = 2.0\n[[reference.hold]]")
    };
    for (is, becomes, said) in [
        (
            "\"python3\"",
            "\"/bin/sh\"",
            "`/bin/sh` cannot be a file of the node",
        ),
        ("\"python3\"", "\"../pid\"", "no absolute path, no `..`"),
        (
            "\"python3\"",
            "\"./pid\"",
            "there is no such file beside the scenario",
        ),
        (
            "\"python3\"",
            "\"pythn3\"",
            "no program `pythn3` is on PATH",
        ),
        ("\"node.py\"", "\"/bin/sh\"", "no absolute path, no `..`"),
        ("[\"python3\", \"node.py\"]", "[]", "program"),
        ("[\"python3\", \"node.py\"]", "\"node.py\"", "program"),
        (
            "[[reference.hold]]",
            &fault("node.slow_cycle"),
            "slow_cycle",
        ),
        (
            "[[reference.hold]]",
            &fault("node.slow_cycle").replace("from", "delay_milliseconds = 1.0\nfrom"),
            "cannot happen to a program",
        ),
    ] {
        let wrong = folder.path().join("wrong.toml");
        fs::write(&wrong, text.replacen(is, becomes, 1)).unwrap();
        let mut check = Command::new(env!("CARGO_BIN_EXE_canrig"));
        let (code, stdout, stderr) = output(check.arg("check").arg(&wrong));
        let text = Vec::from_iter((stdout + &stderr).split_whitespace()).join(" ");
        assert_eq!(code, Some(3), "{becomes}: {text}");
        assert!(text.contains(said), "{said}: {text}");
    }
}
