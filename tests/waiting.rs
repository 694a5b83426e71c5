//! Nodes that wait for ever: virtual time without an event left is an end, and a signal ends a run whatever it waits for.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use rustix::process::{Pid, Signal, kill_process};

use crate::laws::processes_in;
use crate::real_time::{Started, soon, wait_for};
use crate::support::{canrig, only_run, root};

const SIMULATED: &[&str] = &["simulate"];
const IN_LOCKSTEP: &[&str] = &["run", "--clock", "lockstep", "--bus", "embedded"];

/// A node that reports its boot-up and then waits for frames that never come.
const AT_BOOT: &str = "
class Waits(node.Node):
    filters = [0x7F]

    def on_start(self):
        self.send(0x700 + node.part().node_id, b'\\0')

Waits.run()
";

/// A controller that enables the drive, sends some SYNCs, and then waits.
const CONTROLLER_IN_MID_RUN: &str = "
import struct

class Waits(node.Node):
    filters = [0x720]
    sent = 0

    def on_start(self):
        self.send(0x701, b'\\0')
        self.send(0x000, b'\\1\\0')
        self.at(0.01, 'cycle')

    def on_time(self, name):
        self.sent += 1
        controlword = 6 if self.sent < 5 else 7 if self.sent < 10 else 15
        self.send(0x220, struct.pack('<Hh', controlword, 0))
        self.send(0x080, b'')
        if self.sent < 100:
            self.at(self.now + 0.005, 'cycle')

Waits.run()
";

/// A node that does not come back from its first timer.
const SLEEPS: &str = "
import time

class Sleeps(node.Node):
    filters = []

    def on_start(self):
        self.send(0x700 + node.part().node_id, b'\\0')
        self.at(0.1, 'sleep')

    def on_time(self, name):
        print('sleeps', flush=True)
        time.sleep(1000)

Sleeps.run()
";

/// Bench whose drive, and whose controller if it is not canrig's, are programs in Python without a timer.
struct Bench(tempfile::TempDir);

impl Bench {
    /// Makes the bench of `tests/data/programs` without its fan. A program that is `None` is the working one: the drive of
    /// that folder without its heartbeat, or canrig's controller.
    fn new(drive: Option<&str>, controller: Option<&str>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let data = root().join("tests/data/programs");
        let read = |name: &str| fs::read_to_string(data.join(name)).unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        let copy = |from: &str, to: &str| fs::copy(root().join(from), folder.path().join(to));
        copy("tests/foreign/servo.eds", "servo.eds").unwrap();
        copy("python/canrig/node.py", "canrig_node.py").unwrap();
        let program = |body: &str| format!("import canrig_node as node\n{body}");
        let working = read("drive.py").replace("        self.every(0.05, \"heartbeat\")\n", "");
        write("drive.py", &drive.map_or(working, program));
        let mut rig = read("rig.toml")
            .split("[node.fan]")
            .next()
            .unwrap()
            .to_owned();
        if let Some(controller) = controller {
            write("controller.py", &program(controller));
            let led = "node_id = 0x01\nprogram = [\"python3\", \"controller.py\"]\n";
            rig = rig.replace("node_id = 0x01\n", led);
        }
        write("rig.toml", &rig);
        let step = read("step.toml");
        let step = step.split("[[disturbance").next().unwrap();
        write("step.toml", step);
        let sweep = format!("{step}\n[[sweep.list]]\nkey = \"seed\"\nvalues = [1, 2]\n");
        write("sweep.toml", &sweep);
        Self(folder)
    }

    fn place(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self, world: &[&str], runs: &Path) -> std::process::Command {
        let mut canrig = canrig(runs, world[0]);
        let file = if world[0] == "sweep" {
            "sweep.toml"
        } else {
            "step.toml"
        };
        canrig.args(&world[1..]).arg(self.place(file));
        canrig
    }
}

#[test]
fn a_run_without_an_event_left_ends_and_names_its_node() {
    let other_identity = fs::read_to_string(root().join("tests/data/programs/drive.py")).unwrap();
    let other_identity = other_identity
        .replace("0x00000077", "0x00000078")
        .replace("        self.every(0.05, \"heartbeat\")\n", "");
    let never_began = "controller: the scenario did not begin within 15 s";
    for (drive, controller, said) in [
        (
            Some(AT_BOOT),
            None,
            "0x1000:00 of node 0x20: no answer within 500 ms",
        ),
        (
            Some(&other_identity),
            None,
            "is 0x00000078 instead of 0x00000077",
        ),
        (None, Some(AT_BOOT), never_began),
        (Some(AT_BOOT), Some(AT_BOOT), never_began),
        (
            None,
            Some(CONTROLLER_IN_MID_RUN),
            "controller: waits for ever, as all nodes do: none has a frame to send or a timer left at 0.445 s",
        ),
    ] {
        let bench = Bench::new(drive, controller);
        for (number, world) in [SIMULATED, IN_LOCKSTEP].into_iter().enumerate() {
            let runs = bench.place(&number.to_string());
            let (code, stdout, stderr) = soon(&mut bench.command(world, &runs));
            assert_eq!(code, Some(1), "{stdout}{stderr}");
            assert!((stdout + &stderr).contains(said), "{said}");
            let log = fs::read_to_string(only_run(&runs).join("bus.log")).unwrap();
            assert!(log.contains("720#00"), "{log}");
        }
        let (code, stdout, stderr) = soon(&mut bench.command(&["sweep"], &bench.place("swept")));
        assert_eq!(code, Some(1), "{stdout}{stderr}");
        assert!(stdout.contains("2 runs: 2 fail"), "{stdout}");
    }
}

/// A fault ends the controller, and the drive has no timer: the run cannot come to its end.
#[test]
fn a_run_with_faults_and_without_an_event_left_ends_too() {
    let bench = Bench::new(None, Some(CONTROLLER_IN_MID_RUN));
    let fault = "\n[[fault.node.crash]]\nnode = \"controller\"\nfrom_seconds = 0.2\n";
    let step = fs::read_to_string(bench.place("step.toml")).unwrap();
    let unlimited = step.split("[expect]").next().unwrap();
    fs::write(bench.place("step.toml"), format!("{unlimited}{fault}")).unwrap();
    let (code, stdout, stderr) = soon(&mut bench.command(SIMULATED, &bench.place("runs")));
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    assert!(
        (stdout + &stderr).contains("controller: waits for ever"),
        "{code:?}"
    );
}

#[test]
fn a_signal_ends_a_run_that_waits_for_a_program() {
    let never_comes = "import time\nprint('sleeps', flush=True)\ntime.sleep(1000)\n";
    let of_controller = (None, Some(SLEEPS));
    let worlds = [SIMULATED, IN_LOCKSTEP, &["sweep"]];
    let cases = [
        (Some(SLEEPS), None),
        (Some(never_comes), None),
        of_controller,
    ];
    for ((drive, controller), world, signal) in cases.into_iter().flat_map(|(drive, controller)| {
        let signals = [Signal::INT, Signal::TERM].into_iter();
        signals
            .zip(worlds)
            .map(move |(signal, world)| ((drive, controller), world, signal))
    }) {
        let bench = Bench::new(drive, controller);
        let runs = bench.place("runs");
        let mut command = bench.command(world, &runs);
        if world[0] != "sweep" {
            command.args(["--patience", "none"]);
        }
        let command = command.stdout(Stdio::null()).stderr(Stdio::null());
        let canrig = Started::new(command.spawn().unwrap());
        let pid = Pid::from_raw(i32::try_from(canrig.id()).unwrap()).unwrap();
        wait_for("the programs", || processes_in(bench.0.path()) > 0);
        kill_process(pid, signal).unwrap();
        assert_eq!(canrig.ended().status.code(), Some(130), "{world:?}");
        wait_for("their ends", || processes_in(bench.0.path()) == 0);
    }
}
