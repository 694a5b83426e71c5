//! Laws that a program plays: equal in every world, the result of a run when one fails, and the remains.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use controller::law::{CommandRange, Cycle, Law, LoopReads};
use controller::laws::pid::Pid;
use dbc::Quantities;
use fmu::description::Version;
use fmu::export::{Model, ModelVariable, Role, write_fmu};
use rustix::process::{Pid as Process, Signal, kill_process};
use scenario::reference::SetPoint;
use serde_json::json;

use crate::processes::{is_gone, last_command};
use crate::real_time::{Started, busy, in_real_time, wait_for};
use crate::support::{canrig, only_run, output, root, runs};

/// Returns the path of an example of the book.
fn example(name: &str) -> PathBuf {
    root().join("docs/examples").join(name)
}

/// Returns the program with the Python package of this checkout.
fn with_python(folder: &Path, command: &str) -> Command {
    let mut canrig = canrig(folder, command);
    canrig.env("PYTHONPATH", root().join("python"));
    canrig
}

/// Plays a scenario; returns the exit code, the output without line ends, and its only run.
pub(crate) fn played(
    scenario: &Path,
    runs: &Path,
    arguments: &[&str],
) -> (Option<i32>, String, PathBuf) {
    let mut canrig = with_python(runs, arguments[0]);
    let (code, stdout, stderr) = output(canrig.arg(scenario).args(&arguments[1..]));
    let said = Vec::from_iter((stdout + &stderr).split_whitespace()).join(" ");
    (code, said, only_run(runs))
}

pub(crate) const SIMULATED: &[&str] = &["simulate", "--quiet"];
pub(crate) const IN_LOCKSTEP: &[&str] = &["run", "--quiet", "--clock", "lockstep"];
pub(crate) const IN_REAL_TIME: &[&str] = &["run", "--bus", "embedded"];

/// Plays a scenario twenty times in both worlds beside busy processes, and asserts that the runs have the same bytes; returns
/// its bus.log, signals.csv and verdict.json.
pub(crate) fn the_same_bytes(scenario: &Path, runs: &Path) -> [Vec<u8>; 3] {
    let _busy = [busy(), busy()];
    let mut plays = (0..20).map(|number| {
        let world = [SIMULATED, IN_LOCKSTEP][number % 2];
        let (code, said, run) = played(scenario, &runs.join(number.to_string()), world);
        assert_eq!(code, Some(0), "{said}");
        ["bus.log", "signals.csv", "verdict.json"].map(|name| fs::read(run.join(name)).unwrap())
    });
    let first = plays.next().unwrap();
    assert!(plays.all(|files| files == first));
    first
}

/// Asserts that the program of a scenario, which plays once it has made the file `started`, is not started by what plays
/// nothing.
pub(crate) fn is_started_by_a_play_only(scenario: &Path, program: &Path, started: &Path) {
    let runs = scenario.with_file_name("runs");
    let (code, said, run) = played(scenario, &runs, SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    fs::remove_file(started).unwrap();
    let canrig = |arguments: &[&Path]| {
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        let (code, stdout, stderr) = output(canrig.args(arguments));
        assert_eq!(code, Some(0), "{stdout}{stderr}");
    };
    canrig(&[Path::new("check"), scenario]);
    canrig(&[Path::new("report"), &run]);
    canrig(&[Path::new("replay"), &run]);
    canrig(&[Path::new("compare"), &run, &run]);
    assert!(!started.exists());
    // The recording is judged without the program.
    fs::remove_file(program).unwrap();
    canrig(&[Path::new("replay"), &run]);
}

/// Asserts that a current was commanded, and that the last command removed it.
pub(crate) fn is_without_current(run: &Path) {
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let is_current = |line: &str| line.contains(" 210#0F00") && !line.ends_with("0000");
    assert!(log.lines().any(is_current), "there was no current");
    let last = last_command(&log);
    assert!(last.ends_with("0000"), "{last}");
}

/// A manual player of the protocol: `take` a seat, `step` gives the number and the values of the next STEP, `answer`
/// answers it.
const SEAT: &str = r#"
import os, socket, struct, sys, time
HEADER = struct.Struct("<BBHIQ")
channel = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
def connect():
    channel.connect(os.environ["CANRIG_PORTS"])
def hello(version=1, magic=0x47495243, seat=1):
    channel.send(HEADER.pack(1, version, 0, magic, 0) + struct.pack("<BBHI32s", seat, 0, 0, 0, b"test"))
def take():
    connect()
    hello()
    welcome = channel.recv(1 << 17)
    channel.send(HEADER.pack(4, 0, 0, 0, 0))
    return welcome
def step():
    message = channel.recv(1 << 17)
    if not message or message[0] == 5:
        sys.exit(0)
    return int.from_bytes(message[4:8], "little"), struct.unpack(f"<{(len(message) - 16) // 8}d", message[16:])
def answer(number, *values, kind=7, a=0, count=None):
    count = len(values) if count is None else count
    channel.send(HEADER.pack(kind, a, count, number, 0) + struct.pack(f"<{len(values)}d", *values))
def play(steps=1 << 40):
    for _ in range(steps):
        answer(step()[0], 0.2)
"#;

/// Writes a scenario whose law is a program with these statements. The cycle is so long that the nodes do not lose each
/// other on a busy machine.
fn law_that(folder: &Path, does: &str) -> PathBuf {
    fs::write(folder.join("seat.py"), SEAT).unwrap();
    fs::write(
        folder.join("law.py"),
        format!("from seat import *\n{does}\n"),
    )
    .unwrap();
    let path = folder.join("law.toml");
    let text = "schema = 1\nrig = \"dc_motor\"\nname = \"law\"\nduration_seconds = 3.0\n\
         [bus]\nsync_period_milliseconds = 20.0\n\
         [controller.program]\ncommand = [\"python3\", \"law.py\"]\n\
         reads = [\"position_millimetres\"]\nwrites = [\"current_amperes\"]\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_pid_in_python_leaves_the_same_bytes_beside_busy_processes() {
    let folder = tempfile::tempdir().unwrap();
    let files = the_same_bytes(&example("pid_in_python.toml"), folder.path());
    let signals = String::from_utf8_lossy(&files[1]);
    assert!(signals.lines().next().unwrap().contains("integral_amperes"));
}

#[test]
fn a_pid_in_python_plays_in_real_time() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let (code, said, run) = played(&example("pid_in_python.toml"), folder.path(), IN_REAL_TIME);
        // On a busy machine cycles are missed.
        assert!(said.contains("law: starts `python3 pid.py` in "), "{said}");
        assert!(matches!(code, Some(0 | 1 | 5)), "{said}");
        assert!(!said.contains("the law's process"), "{said}");
        is_without_current(&run);
    });
}

/// Returns the gains of the book's PID, for both.
fn gains() -> scenario::controller::Pid {
    let text = fs::read_to_string(example("pid_in_python.toml")).unwrap();
    let scenario: toml::Table = text.parse().unwrap();
    let mut gains = scenario["controller"]["program"]["parameters"].clone();
    let table = gains.as_table_mut().unwrap();
    for pattern in [
        "proportional_{gain}",
        "integral_{gain}_second",
        "derivative_{gain_seconds}",
    ] {
        let gain = table.remove(&Quantities::default().name(pattern)).unwrap();
        table.insert(pattern.to_owned(), gain);
    }
    gains.try_into().unwrap()
}

/// The other end of a seat: starts a command, plays rows of input to it, and prints its first output of each.
const PLAYER: &str = r#"
import json, os, socket, struct, subprocess, sys, tempfile
HEADER = struct.Struct("<BBHIQ")
welcome, rows = json.loads(sys.argv[1]), [list(map(float, line.split())) for line in sys.stdin]
with tempfile.TemporaryDirectory() as folder:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(folder + "/socket")
    listener.listen(1)
    law = subprocess.Popen(sys.argv[2:], env={**os.environ, "CANRIG_PORTS": folder + "/socket"}, stdin=subprocess.DEVNULL)
    channel, _ = listener.accept()
    channel.recv(1 << 17)
    channel.send(HEADER.pack(2, 1, 0, 0, 0) + bytes(24) + json.dumps(welcome).encode())
    assert channel.recv(1 << 17)[:2] == b"\x04\x00"
    for number, row in enumerate(rows):
        time = round(1e9 * welcome["period_seconds"]) * number
        values = struct.pack(f"<{1 + len(row)}d", welcome["period_seconds"], *row)
        channel.send(HEADER.pack(6, 0, len(row), number, time) + values)
        answer = channel.recv(1 << 17)
        assert answer[0] == 7 and answer[1] == 0, answer
        print(repr(struct.unpack_from("<d", answer, 16)[0]))
    channel.send(HEADER.pack(5, 0, 0, 0, 0))
    channel.recv(1 << 17)
    sys.exit(law.wait())
"#;

/// Returns position and set-point in metres, of each cycle of 10 s under the PID in Rust.
fn recorded(folder: &Path) -> Vec<[f64; 2]> {
    let text = fs::read_to_string(in_rust(folder)).unwrap();
    let long = folder.join("long.toml");
    let steps = (2..10).map(|at| {
        let to = if at % 2 == 0 { 35.0 } else { 15.0 };
        format!("\n[[reference.step]]\nat_seconds = {at}.0\nposition_millimetres = {to:.1}\n")
    });
    let (before, _) = text.split_once("\n[[reference.step]]").unwrap();
    let before = before.replace("duration_seconds = 4.0", "duration_seconds = 10.0");
    fs::write(&long, before + &String::from_iter(steps)).unwrap();
    let (code, said, run) = played(&long, &folder.join("recorded"), SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    let table = fs::read_to_string(run.join("signals.csv")).unwrap();
    let mut rows = table.lines();
    let names = Vec::from_iter(rows.next().unwrap().split(','));
    let places = ["position_millimetres", "set_point_millimetres"]
        .map(|name| names.iter().position(|other| *other == name).unwrap());
    let read = |row: &str| {
        let cells = Vec::from_iter(row.split(','));
        places.map(|place| 1e-3 * cells[place].parse().unwrap_or(f64::NAN))
    };
    rows.map(read).collect()
}

/// A range within which the recorded steps wind up a PID without anti-windup.
const RANGE: [f64; 2] = [-0.4, 0.4];

/// Returns the currents of the PID in Rust before they are limited.
fn by_rust(rows: &[[f64; 2]]) -> Vec<f64> {
    let range = CommandRange {
        min: RANGE[0],
        max: RANGE[1],
        ..CommandRange::default()
    };
    let law = Pid::new(&gains(), &[range]);
    let mut state = law.start();
    let cycle = Cycle {
        scenario_time_seconds: 0.0,
        period_seconds: 0.001,
    };
    let rows = rows.iter().map(|[position, wanted]| LoopReads {
        position: *position,
        set_point: SetPoint {
            position: *wanted,
            ..SetPoint::default()
        },
    });
    rows.map(|reads| law.wanted_amperes(&mut state, &cycle, &reads).0)
        .collect()
}

#[test]
fn each_pid_computes_what_the_one_in_rust_does() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    in_c(folder.path());
    let mut rows = recorded(folder.path());
    assert!(rows.len() >= 10_000);
    // Every tenth cycle lacks its position.
    rows.iter_mut()
        .step_by(10)
        .for_each(|row| row[0] = f64::NAN);
    let expected = by_rust(&rows);
    assert!(expected.iter().any(|it| it.abs() > RANGE[1]));
    let gains = serde_json::to_string(&gains()).unwrap();
    let gains: serde_json::Value =
        serde_json::from_str(&Quantities::default().name(&gains)).unwrap();
    let scenario: toml::Table = GAINS_OF_FMU.replace("1.5", "0.4").parse().unwrap();
    let parameters = &scenario["controller"]["fmu"]["parameters"];
    let canrig = env!("CARGO_BIN_EXE_canrig").to_owned();
    let path = |name: &str| place(name).to_string_lossy().into_owned();
    let worker = |file: &str| vec![canrig.clone(), "law-worker".to_owned(), path(file)];
    let fmu = |name: &str| {
        let unpacked = path(&format!("{name}-files"));
        let unpack = "import sys, zipfile; zipfile.ZipFile(sys.argv[1]).extractall(sys.argv[2])";
        let file = path(&format!("{name}.fmu"));
        let (code, _, error) =
            output(Command::new("python3").args(["-c", unpack, &file, &unpacked]));
        assert_eq!(code, Some(0), "{error}");
        let mut command = worker(&format!("{name}.fmu"));
        command.push(unpacked);
        command
    };
    let python = vec![
        "python3".to_owned(),
        example("pid.py").to_string_lossy().into_owned(),
    ];
    for (command, parameters) in [
        (python, gains.clone()),
        (worker("pid.so"), gains),
        (fmu("two"), serde_json::to_value(parameters).unwrap()),
        (fmu("three"), serde_json::to_value(parameters).unwrap()),
    ] {
        let welcome = json!({
            "reads": ["position_metres", "set_point_metres"],
            "writes": ["command"],
            "terms": ["integral_amperes"],
            "ranges": [RANGE],
            "parameters": parameters,
            "variables": {"position_metres": "y", "set_point_metres": "r", "command": "u", "integral_amperes": "sum"},
            "period_seconds": 0.001,
        });
        let mut player = Command::new("python3");
        player.env("PYTHONPATH", root().join("python"));
        player
            .args(["-c", PLAYER, &welcome.to_string()])
            .args(&command);
        let lines = rows
            .iter()
            .map(|[position, wanted]| format!("{position:?} {wanted:?}\n"));
        let input = place("rows");
        fs::write(&input, String::from_iter(lines)).unwrap();
        player.stdin(fs::File::open(&input).unwrap());
        let (code, stdout, stderr) = output(&mut player);
        assert_eq!(code, Some(0), "{command:?}: {stderr}");
        let currents = Vec::from_iter(stdout.lines().map(|line| line.parse::<f64>().unwrap()));
        assert_eq!(currents.len(), expected.len());
        let apart = currents.iter().zip(&expected);
        let apart = apart
            .map(|(one, expected)| (one - expected).abs())
            .fold(0.0, f64::max);
        assert!(apart <= 1e-12, "{command:?}: {apart:e} apart");
    }
}

#[test]
fn a_sweep_varies_the_parameters_of_a_program_and_is_of_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    fs::copy(example("pid.py"), place("pid.py")).unwrap();
    let text = fs::read_to_string(example("pid_in_python.toml")).unwrap();
    let sweep = "[[sweep.list]]\nkey = \"controller.program.parameters.set_point_weight\"\nvalues = [0.3, 0.4, 0.5]\n\
         [[sweep.list]]\nkey = \"controller.program.parameters.proportional_amperes_per_metre\"\nvalues = [50.0, 65.0]\n";
    fs::write(place("sweep.toml"), text + sweep).unwrap();
    let mut canrig = with_python(&place("runs"), "sweep");
    let (code, stdout, stderr) = output(canrig.arg(place("sweep.toml")));
    assert!(matches!(code, Some(0 | 1)), "{stdout}{stderr}");
    assert!(
        stderr.contains("law: starts `python3 pid.py` in "),
        "{stderr}"
    );
    let swept = only_run(&place("runs"));
    let table = fs::read_to_string(swept.join("runs.csv")).unwrap();
    assert_eq!(table.lines().count(), 7, "{table}");
    let column = |row: &str| row.split(',').nth(8).map(str::to_owned);
    let settled = Vec::from_iter(table.lines().skip(1).map(column));
    assert_ne!(settled[0], settled[5], "{table}");
    // Rows of another program are not added to these.
    fs::write(
        place("pid.py"),
        fs::read_to_string(example("pid.py")).unwrap() + "\n",
    )
    .unwrap();
    let mut canrig = with_python(&place("runs"), "sweep");
    output(canrig.arg(place("sweep.toml")));
    assert_eq!(runs(&place("runs")).len(), 2);
}

#[test]
fn another_value_of_a_parameter_and_another_file_are_another_run() {
    let folder = tempfile::tempdir().unwrap();
    let key = "controller.program.parameters.set_point_weight=1.0";
    let set = ["simulate", "--set", key];
    let (_, _, one) = played(
        &example("pid_in_python.toml"),
        &folder.path().join("1"),
        SIMULATED,
    );
    let (_, _, other) = played(
        &example("pid_in_python.toml"),
        &folder.path().join("2"),
        &set,
    );
    let read = |run: &Path, name: &str| fs::read_to_string(run.join(name)).unwrap();
    assert_ne!(read(&one, "signals.csv"), read(&other, "signals.csv"));
    let verdict: serde_json::Value = serde_json::from_str(&read(&one, "verdict.json")).unwrap();
    let hash = &verdict["identity"]["files"]["pid.py"];
    assert_eq!(hash.as_str().unwrap().len(), 64, "{verdict}");
    assert_eq!(verdict["identity"]["law"], "program");
}

#[test]
fn nothing_is_started_by_what_plays_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let does = format!("open({:?}, 'w')\ntake()\nplay()", place("started"));
    let law = law_that(folder.path(), &does);
    is_started_by_a_play_only(&law, &place("law.py"), &place("started"));
}

/// Statements of a program, and the resulting message.
const HOSTILE: [(&str, &str); 16] = [
    ("sys.exit(3)", "`python3 law.py` exited with code 3"),
    (
        "connect()\nchannel.close()\nsys.exit(4)",
        "exited with code 4",
    ),
    (
        "connect()\nchannel.send(b'GET / HTTP/1.1')",
        "spoke what is no HELLO: byte 14: a message has 16 bytes",
    ),
    (
        "connect()\nhello(version=9)\nstep()",
        "spoke what is no HELLO: byte 1: version 9",
    ),
    (
        "take()\nplay(50)\nprint('oh no')\nsys.exit(7)",
        "exited with code 7; the end of its output: oh no",
    ),
    (
        "take()\nplay(50)\nanswer(step()[0], float('nan'))\nplay()",
        "answered NaN for `current_amperes`",
    ),
    (
        "take()\nplay(50)\nanswer(step()[0], 1.0, 2.0)\nplay()",
        "answered what is no answer: byte 2: 2 values in 16 bytes",
    ),
    (
        "take()\nplay(50)\nanswer(step()[0] + 1, 1.0)\nplay()",
        "byte 4: number 52, and 51 was asked",
    ),
    (
        "take()\nplay(50)\nanswer(step()[0], 1.0, kind=99)\nplay()",
        "byte 0: kind 99, where VALUES is 7",
    ),
    (
        // The kernel may have no room for the longer one.
        "take()\nplay(50)\nstep()\nfor size in (150_000, 20_000):\n    try: channel.send(b'x' * size)\n    except OSError: continue\n    break\nplay()",
        "answered what is no answer: byte 0: kind 120, where VALUES is 7",
    ),
    (
        "connect()\nwhile True: hello()",
        "answered WELCOME with what is no answer: byte 0: kind 1, where DONE is 4",
    ),
    (
        "connect()\nhello()\nchannel.recv(1 << 17)\nsys.exit(5)",
        "exited with code 5",
    ),
    (
        "take()\nplay(50)\nnumber = step()[0]\nwhile True: answer(number, 0.2)",
        "byte 4: number 51, and 52 was asked",
    ),
    (
        "take()\nplay(50)\nanswer(step()[0] - 1, 0.2)\nplay()",
        "byte 4: number 50, and 51 was asked",
    ),
    (
        "take()\nplay(50)\nchannel.send(HEADER.pack(7, 2, 0, step()[0], 0) + b'no gain')\nplay()",
        "gave up: no gain",
    ),
    ("take()\nplay(50)\nos.abort()", "was ended by signal 6"),
];

/// Returns the number of processes whose working directory is a folder.
pub(crate) fn processes_in(folder: &Path) -> usize {
    let folder = folder.canonicalize().unwrap();
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let folders = processes.filter_map(|process| process.path().join("cwd").read_link().ok());
    folders.filter(|its| *its == folder).count()
}

#[test]
fn a_program_that_breaks_is_named_and_the_current_is_off() {
    let folder = tempfile::tempdir().unwrap();
    for (number, (does, said)) in HOSTILE.into_iter().enumerate() {
        let folder = folder.path().join(number.to_string());
        fs::create_dir(&folder).unwrap();
        let law = law_that(&folder, does);
        for world in [SIMULATED, IN_LOCKSTEP] {
            let runs = folder.join(world[0]);
            let (code, text, run) = played(&law, &runs, world);
            assert_eq!(code, Some(1), "{does}: {text}");
            assert!(text.contains(said), "{said}: {text}");
            assert!(run.join("report.html").exists());
            if does.contains("play(50)") {
                is_without_current(&run);
            }
            for name in ["verdict.json", "junit.xml", "bus.log", "frames.dbc"] {
                assert!(run.join(name).exists(), "{does}: {name}");
            }
            assert_eq!(processes_in(&folder), 0, "{does}");
        }
    }
}

#[test]
fn a_program_that_does_not_answer_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let law = law_that(folder.path(), "take()\nplay(50)\ntime.sleep(60)");
    let (code, text, run) = played(&law, &folder.path().join("runs"), SIMULATED);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("did not answer in 10 s"), "{text}");
    is_without_current(&run);
}

#[test]
fn a_law_is_asked_once_a_cycle() {
    let folder = tempfile::tempdir().unwrap();
    let does = "take()\nasked = 0\nwhile True:\n    message = channel.recv(1 << 17)\n    if message[0] == 5: break\n    \
         asked += 1\n    answer(int.from_bytes(message[4:8], 'little'), 0.2)\nprint(asked)";
    let law = law_that(folder.path(), does);
    let (code, said, run) = played(&law, &folder.path().join("runs"), SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    let asked: usize = fs::read_to_string(run.join("law.log"))
        .unwrap()
        .trim()
        .parse()
        .unwrap();
    let rows = fs::read_to_string(run.join("signals.csv")).unwrap();
    let cycles = rows.lines().count() - 1;
    assert!(
        (cycles..=cycles + 1).contains(&asked),
        "{asked} questions in {cycles} cycles"
    );
}

#[test]
fn a_program_that_breaks_in_real_time_is_named_and_the_current_is_off() {
    for (does, said) in [HOSTILE[4], HOSTILE[5], HOSTILE[15]] {
        in_real_time(|| {
            let folder = tempfile::tempdir().unwrap();
            let law = law_that(folder.path(), does);
            let (code, text, run) = played(&law, &folder.path().join("runs"), IN_REAL_TIME);
            assert_eq!(code, Some(1), "{does}: {text}");
            assert!(text.contains(said), "{said}: {text}");
            is_without_current(&run);
        });
    }
}

/// Returns the statements of a law that takes longer than a cycle of 20 ms if a condition on the number of the cycle
/// holds.
fn slow_when(condition: &str) -> String {
    format!(
        "take()\nwhile True:\n    number = step()[0]\n    if {condition}: time.sleep(0.025)\n    answer(number, 0.2)"
    )
}

#[test]
fn a_late_answer_commands_nothing_in_its_cycle_and_the_run_goes_on() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let law = law_that(folder.path(), &slow_when("number % 10 == 0"));
        let text = fs::read_to_string(&law).unwrap();
        let limit = "[expect]\nmissed_commands_percent = { max = 2.0 }\n";
        fs::write(&law, text + limit).unwrap();
        let (code, said, run) = played(&law, &folder.path().join("runs"), IN_REAL_TIME);
        assert_eq!(code, Some(1), "{said}");
        assert!(!said.contains("the law's process"), "{said}");
        assert!(said.contains("controller: no command in "), "{said}");
        assert!(said.contains("no answer of a law in time in 1"), "{said}");
        let missed = metrics(&run);
        let mut missed = missed.iter();
        let missed = missed.find(|(name, _)| name == "missed_commands_percent");
        assert!(missed.unwrap().1 >= 8.0, "{said}");
        is_without_current(&run);
        // In virtual time no answer is late.
        let (code, said, _) = played(&law, &folder.path().join("simulated"), SIMULATED);
        assert_eq!(code, Some(0), "{said}");
    });
}

#[test]
fn a_law_that_is_always_late_is_given_up() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let law = law_that(folder.path(), &slow_when("number > 50"));
        let (code, said, run) = played(&law, &folder.path().join("runs"), IN_REAL_TIME);
        assert_eq!(code, Some(1), "{said}");
        let expected = "`python3 law.py` did not answer in time in 20 cycles in a row";
        assert!(said.contains(expected), "{said}");
        is_without_current(&run);
    });
}

/// Two processes that refuse to end, the second in its own session; their numbers are in a file.
const STUBBORN: &str = "
import signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
numbers = open('numbers', 'w')
print(os.getpid(), file=numbers, flush=True)
if os.fork() == 0:
    os.setsid()
    print(os.getpid(), file=numbers, flush=True)
    channel.close()
    while True: time.sleep(60)
take()
for _ in range(100): answer(step()[0], 0.2)
while True: time.sleep(60)
";

pub(crate) fn numbers(folder: &Path) -> Vec<Process> {
    let text = fs::read_to_string(folder.join("numbers")).unwrap_or_default();
    let numbers = text.lines().filter_map(|line| line.parse().ok());
    numbers.filter_map(Process::from_raw).collect()
}

#[test]
fn a_program_that_wants_no_end_is_ended_with_all_that_it_started() {
    let folder = tempfile::tempdir().unwrap();
    // It no longer answers after the end of the scenario.
    let law = law_that(
        folder.path(),
        &STUBBORN.replace("range(100)", "range(10 ** 9)"),
    );
    let law_text = fs::read_to_string(&law).unwrap().replace("3.0", "1.0");
    fs::write(&law, law_text).unwrap();
    let does = fs::read_to_string(folder.path().join("law.py")).unwrap();
    let unstoppable = does.replace("answer(step()[0], 0.2)", "serve()");
    let serve = "def serve():\n    message = channel.recv(1 << 17)\n    if message and message[0] == 6:\n        \
         answer(int.from_bytes(message[4:8], 'little'), 0.2)\n    elif not message:\n        time.sleep(60)\n";
    fs::write(
        folder.path().join("law.py"),
        unstoppable.replacen('\n', &format!("\n{serve}"), 1),
    )
    .unwrap();
    for world in [SIMULATED, IN_LOCKSTEP] {
        let runs = folder.path().join(world[0]);
        let (code, said, _) = played(&law, &runs, world);
        assert_eq!(code, Some(0), "{said}");
        let numbers = numbers(folder.path());
        assert_eq!(numbers.len(), 2);
        assert!(numbers.into_iter().all(is_gone));
    }
}

/// Kills canrig in the middle of runs of a file, in each world, and waits for the end of the stubborn processes that are
/// left in its folder.
pub(crate) fn leaves_nothing_when_killed(file: &Path, canrig: impl Fn(&Path, &str) -> Command) {
    let folder = file.parent().unwrap();
    let temporary = folder.join("temporary");
    fs::create_dir_all(&temporary).unwrap();
    let has_part = || {
        let entries = fs::read_dir(&temporary).unwrap();
        let mut names = entries.map(|entry| entry.unwrap().file_name());
        names.any(|name| name.to_string_lossy().starts_with("canrig-part-"))
    };
    for world in [SIMULATED, IN_LOCKSTEP] {
        let _ = fs::remove_file(folder.join("numbers"));
        let mut canrig = canrig(&folder.join(world[0]), world[0]);
        canrig.env("TMPDIR", &temporary);
        canrig.arg(file).args(&world[1..]);
        canrig.stdout(Stdio::null()).stderr(Stdio::null());
        let canrig = Started::new(canrig.spawn().unwrap());
        // In the middle of the run it does not answer.
        wait_for("the program", || numbers(folder).len() == 2);
        let process = Process::from_raw(canrig.id().cast_signed()).unwrap();
        kill_process(process, Signal::KILL).unwrap();
        canrig.ended();
        let left = numbers(folder);
        wait_for("the end of both", || left.iter().copied().all(is_gone));
        wait_for("the end of the file with its part", || !has_part());
    }
}

#[test]
fn a_killed_canrig_leaves_no_program() {
    let folder = tempfile::tempdir().unwrap();
    let law = law_that(folder.path(), STUBBORN);
    leaves_nothing_when_killed(&law, with_python);
}

#[test]
fn what_a_program_prints_is_kept_up_to_a_limit_and_holds_up_nothing() {
    let folder = tempfile::tempdir().unwrap();
    // The output is written at once: a program has ten seconds for each answer.
    let does = "import sys\ntake()\nsys.stdout.write(''.join(f'a line of output {number}\\n' for number in range(1_000_000)))\nplay()";
    let law = law_that(folder.path(), does);
    let (code, said, run) = played(&law, &folder.path().join("runs"), IN_LOCKSTEP);
    assert_eq!(code, Some(0), "{said}");
    let log = fs::read(run.join("law.log")).unwrap();
    let end = String::from_utf8_lossy(&log[16 << 20..]).into_owned();
    assert!(end.trim().ends_with("bytes more are not kept)"), "{end}");
    assert!(log.starts_with(b"a line of output 0\n"));
}

#[test]
fn a_seat_is_taken_once() {
    let folder = tempfile::tempdir().unwrap();
    let does = "take()\nsecond = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)\n\
         print(second.connect_ex(os.environ['CANRIG_PORTS']), os.environ['CANRIG_CLOCK'], os.getcwd(), sys.stdin.read())\nplay()";
    let law = law_that(folder.path(), does);
    let (code, said, run) = played(&law, &folder.path().join("runs"), SIMULATED);
    assert_eq!(code, Some(0), "{said}");
    let log = fs::read_to_string(run.join("law.log")).unwrap();
    let place_of_file = folder.path().canonicalize().unwrap();
    // ENOENT: the socket is gone.
    assert_eq!(log.trim(), format!("2 virtual {}", place_of_file.display()));
}

#[test]
fn a_program_from_elsewhere_and_ports_that_are_none_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let law = law_that(folder.path(), "take()\nplay()");
    let text = fs::read_to_string(&law).unwrap();
    for (is, becomes, said) in [
        (
            "\"python3\"",
            "\"/bin/sh\"",
            "`/bin/sh` cannot be a file of the law",
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
        ("\"law.py\"", "\"/bin/sh\"", "no absolute path, no `..`"),
        ("[\"python3\", \"law.py\"]", "[]", "command"),
        (
            "\"position_millimetres\"",
            "\"positon_millimetres\"",
            "a law cannot read `position.positon_millimetres`",
        ),
        (
            "\"position_millimetres\"",
            "\"position_degrees\"",
            "a law cannot read",
        ),
        (
            "\"current_amperes\"",
            "\"current_volts\"",
            "`position.current_volts` is not a drive command",
        ),
        (
            "reads",
            "terms = [\"current_amperes\"]\nreads",
            "`position.current_amperes` is a command, not a term",
        ),
        (
            "reads",
            "parameters = { kp = nan }\nreads",
            "the parameter `kp` cannot be handed on",
        ),
        (
            "reads",
            "parameter = { kp = 1.0 }\nreads",
            "did you mean `parameters`?",
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

/// Compiles a C file to a shared library.
fn compiled(source: &str, library: &Path) {
    let mut compiler = Command::new("cc");
    compiler.args(["-O2", "-Wall", "-Werror", "-shared", "-fPIC", "-I"]);
    compiler.arg(root().join("include")).arg("-o").arg(library);
    let (code, _, error) = output(compiler.arg(root().join(source)).arg("-lm"));
    assert_eq!(code, Some(0), "{error}");
}

/// Writes the PID in C as an FMU.
fn write_pid_fmu(file: &Path, version: Version, library: &Path) {
    let variable = |name: &str, unit, role| ModelVariable {
        name: name.to_owned(),
        description: String::new(),
        unit,
        role,
    };
    let parameter = |name: &str| {
        let (start, min, max) = (0.0, None, None);
        variable(name, "", Role::Number { start, min, max })
    };
    let gains = [
        "kp",
        "ki",
        "kd",
        "weight",
        "pole",
        "low_amperes",
        "high_amperes",
    ];
    let ports = [
        variable("y", "m", Role::Input(0.0)),
        variable("r", "m", Role::Input(0.0)),
        variable("u", "A", Role::Output),
        variable("sum", "A", Role::Output),
    ];
    let model = Model {
        name: "pid".to_owned(),
        description: String::new(),
        version: "1".to_owned(),
        variables: ports.into_iter().chain(gains.map(parameter)).collect(),
    };
    let file = fs::File::create(file).unwrap();
    write_fmu(file, &model, version, &fs::read(library).unwrap()).unwrap();
}

/// Writes the scenario of the PID in Python with another table of its law.
fn pid_scenario(folder: &Path, name: &str, table: &str) -> PathBuf {
    let text = fs::read_to_string(example("pid_in_python.toml")).unwrap();
    let (before, rest) = text.split_once("[controller.program]").unwrap();
    let (_, after) = rest.split_once("[[reference.hold]]").unwrap();
    let path = folder.join(name);
    fs::write(&path, format!("{before}{table}\n[[reference.hold]]{after}")).unwrap();
    path
}

const GAINS_OF_FMU: &str = "[controller.fmu.parameters]\nkp = 64.8\nki = 489.0\nkd = 3.74\nweight = 0.377\npole = 500.0\n\
    low_amperes = -1.5\nhigh_amperes = 1.5\n";

/// Writes the PID in C as a library and as FMUs of both versions, in this order.
fn in_c(folder: &Path) -> [PathBuf; 3] {
    compiled("docs/examples/pid.c", &folder.join("pid.so"));
    compiled("tests/fmu/pid.c", &folder.join("fmu.so"));
    let text = fs::read_to_string(example("pid_in_python.toml")).unwrap();
    let (_, table) = text.split_once("[controller.program]").unwrap();
    let (table, _) = table.split_once("[[reference.hold]]").unwrap();
    let table = table.replace("command = [\"python3\", \"pid.py\"]", "file = \"pid.so\"");
    let table = format!("[controller.library]{table}")
        .replace("controller.program.", "controller.library.");
    let library = pid_scenario(folder, "library.toml", &table);
    let fmu = |name: &str, version| {
        write_pid_fmu(
            &folder.join(format!("{name}.fmu")),
            version,
            &folder.join("fmu.so"),
        );
        let table = format!(
            "[controller.fmu]\nfile = \"{name}.fmu\"\n\
             reads = {{ y = \"position_millimetres\", r = \"set_point_millimetres\" }}\n\
             writes = {{ u = \"current_amperes\" }}\nterms = {{ sum = \"integral_amperes\" }}\n{GAINS_OF_FMU}"
        );
        pid_scenario(folder, &format!("{name}.toml"), &table)
    };
    [
        library,
        fmu("two", Version::Two),
        fmu("three", Version::Three),
    ]
}

/// Writes the scenario of the PID in Python with the one in Rust.
fn in_rust(folder: &Path) -> PathBuf {
    let gains = Quantities::default().name(&toml::to_string(&gains()).unwrap());
    pid_scenario(folder, "rust.toml", &format!("[controller.pid]\n{gains}"))
}

fn metrics(run: &Path) -> Vec<(String, f64)> {
    let text = fs::read_to_string(run.join("verdict.json")).unwrap();
    let verdict: serde_json::Value = serde_json::from_str(&text).unwrap();
    let rows = verdict["metrics"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|row| {
            let value = row["value"].as_f64().or(row["measured"].as_f64())?;
            Some((row["name"].as_str()?.to_owned(), value))
        });
    rows.collect()
}

#[test]
fn each_pid_controls_as_the_one_in_rust() {
    let folder = tempfile::tempdir().unwrap();
    let rust = in_rust(folder.path());
    let (_, said, rust) = played(&rust, &folder.path().join("rust"), SIMULATED);
    let expected = metrics(&rust);
    assert!(expected.len() > 5, "{said}");
    let scenarios = in_c(folder.path())
        .into_iter()
        .chain([example("pid_in_python.toml")]);
    for scenario in scenarios {
        let name = scenario.file_stem().unwrap().to_string_lossy().into_owned();
        let mut recordings = Vec::new();
        for world in [SIMULATED, IN_LOCKSTEP] {
            let runs = folder.path().join(format!("{name}-{}", world[0]));
            let (code, said, run) = played(&scenario, &runs, world);
            assert_eq!(code, Some(0), "{name}: {said}");
            let ours = metrics(&run);
            assert_eq!(ours.len(), expected.len());
            let compared = ours.iter().zip(&expected);
            // The PID in Rust publishes more terms.
            let compared = compared.filter(|((name, _), _)| name != "bus_load_percent");
            for ((metric, ours), (_, theirs)) in compared {
                let apart = (ours - theirs).abs();
                assert!(
                    apart <= 1e-3 * theirs.abs(),
                    "{name}: {metric}: {ours} {theirs}"
                );
            }
            recordings.push(fs::read(run.join("bus.log")).unwrap());
        }
        assert!(recordings[0] == recordings[1], "{name}");
    }
}

#[test]
fn a_law_in_c_that_breaks_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let [library, ..] = in_c(folder.path());
    let text = fs::read_to_string(root().join("docs/examples/pid.c")).unwrap();
    for (number, (is, becomes, said)) in [
        (
            "writes[0] = current;",
            "*(volatile int *)0 = 1;",
            "was ended by signal 11",
        ),
        (
            "writes[0] = current;",
            "writes[0] = 0.0 / 0.0;",
            "for `command`",
        ),
        (
            "writes[0] = current;",
            "return 5;",
            "gave up: canrig_law_step returned 5",
        ),
        (
            "canrig_law_step",
            "canrig_law_stop",
            "gave up: its library has no function `canrig_law_step`",
        ),
        (
            "\"set_point_weight\"",
            "\"weight\"",
            "gave up: canrig_law_init returned 1: the parameter weight is missing",
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let source = folder.path().join("broken.c");
        fs::write(&source, text.replace(is, becomes)).unwrap();
        compiled(&source.to_string_lossy(), &folder.path().join("pid.so"));
        let runs = folder.path().join(format!("runs{number}"));
        let (code, text, run) = played(&library, &runs, SIMULATED);
        assert_eq!(code, Some(1), "{becomes}: {text}");
        assert!(text.contains(said), "{said}: {text}");
        assert!(run.join("report.html").exists());
    }
}

#[test]
fn a_table_that_does_not_fit_the_fmu_is_refused_at_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let [_, fmu, _] = in_c(folder.path());
    let text = fs::read_to_string(&fmu).unwrap();
    for (is, becomes, said) in [
        (
            "two.fmu",
            "one.fmu",
            "there is no such file beside the scenario",
        ),
        ("two.fmu", "two.toml", "two.toml cannot be this law"),
        ("y = ", "z = ", "variable `z`"),
        ("u = \"current", "y = \"current", "variable `y`"),
        ("kp = 64.8", "k = 64.8", "variable `k`"),
        ("kp = 64.8", "kp = true", "takes a number as its start"),
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
