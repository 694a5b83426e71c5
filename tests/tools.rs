//! The tools to debug nodes, on the embedded bus: next to a running `canrig run`, and on buses of their own.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use platform::bus::BusAddress;
use platform::hub::Hub;
use platform::recorder::Recorder;
use rustix::process::{Pid, Signal, kill_process};

use crate::real_time::{Started, in_real_time, wait_for};
use crate::support::{canrig, only_run, output, scenario, short_scenario, unhurried_scenario};

/// Returns a tool that finds embedded buses in `runtime` only.
fn tool(runtime: &Path, arguments: &[&str]) -> Command {
    let mut tool = Command::new(env!("CARGO_BIN_EXE_canrig"));
    tool.args(arguments)
        .env("NO_COLOR", "1")
        .env("XDG_RUNTIME_DIR", runtime)
        .env("TMPDIR", runtime);
    tool
}

/// A run in real time, with its bus in its own folder.
struct Run {
    canrig: Started,
    folder: tempfile::TempDir,
}

impl Run {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let runtime = folder.path().join("runtime");
        fs::create_dir(&runtime).unwrap();
        let canrig = canrig(&folder.path().join("runs"), "run")
            .arg(unhurried_scenario(folder.path(), 120.0))
            .args(["--bus", "embedded"])
            .env("XDG_RUNTIME_DIR", &runtime)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let canrig = Started::new(canrig);
        let run = Self { canrig, folder };
        wait_for("the controller to lead the drive", || {
            run.log().contains(" 210#0F00")
        });
        run
    }

    fn runtime(&self) -> PathBuf {
        self.folder.path().join("runtime")
    }

    fn log(&self) -> String {
        let runs = fs::read_dir(self.folder.path().join("runs"));
        let run = runs
            .ok()
            .and_then(|mut runs| Some(runs.next()?.ok()?.path()));
        let log = run.map(|run| fs::read_to_string(run.join("bus.log")));
        log.and_then(Result::ok).unwrap_or_default()
    }

    fn tool(&self, arguments: &[&str]) -> (Option<i32>, String, String) {
        output(&mut tool(&self.runtime(), arguments))
    }

    /// Ends the run; returns its output and its whole log.
    fn end(self) -> (String, String) {
        kill_process(Pid::from_child(&self.canrig), Signal::INT).unwrap();
        let Self { canrig, folder } = self;
        let ended = canrig.ended();
        let run = fs::read_dir(folder.path().join("runs"))
            .unwrap()
            .next()
            .unwrap();
        let log = fs::read_to_string(run.unwrap().path().join("bus.log")).unwrap();
        (String::from_utf8(ended.stdout).unwrap(), log)
    }
}

/// Returns the number of frames with this identifier.
fn frames(log: &str, id: &str) -> usize {
    log.lines()
        .filter(|line| line.contains(&format!(" {id}#")))
        .count()
}

fn sdo_reads_and_writes_beside_the_controller(run: &Run) {
    let (code, stdout, stderr) = run.tool(&["sdo", "read", "drive", "Modes of operation display"]);
    assert_eq!(
        (code, stdout.as_str()),
        (
            Some(0),
            "0x6061:00  Modes of operation display (INTEGER8) = 10\n"
        ),
        "{stderr}"
    );
    let (code, _, stderr) = run.tool(&["sdo", "write", "0x10", "1017", "30"]);
    assert_eq!(code, Some(2), "{stderr}");
    assert!(
        stderr.contains("name the bus, --bus embedded:/"),
        "{stderr}"
    );
    let (code, stdout, stderr) =
        run.tool(&["sdo", "write", "0x10", "1017", "30", "--bus", "embedded"]);
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(
        stdout,
        "0x1017:00  Producer heartbeat time (UNSIGNED16) = 30 (0x001E)  written\n"
    );
    let (code, _, stderr) = run.tool(&[
        "sdo",
        "write",
        "drive",
        "Statusword",
        "0",
        "--bus",
        "embedded",
    ]);
    assert_eq!(code, Some(4));
    let refused = "canrig: object 0x6041:00 of node 0x10: abort 0x0601_0002: attempt to write a read only object\n";
    assert!(stderr.ends_with(refused), "{stderr}");
    assert!(
        stderr.starts_with("canrig: on the bus of your run, embedded:/"),
        "{stderr}"
    );
    for object in ["Controlword", "1800:5"] {
        let (code, _, stderr) =
            run.tool(&["sdo", "write", "drive", object, "0", "--bus", "embedded"]);
        assert_eq!(code, Some(4), "{stderr}");
        assert!(
            stderr.contains("a controller is running") && stderr.contains("--force"),
            "{stderr}"
        );
    }
    let (code, stdout, stderr) = run.tool(&[
        "sdo", "write", "drive", "1800:5", "0", "--force", "--bus", "embedded",
    ]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stdout.ends_with("written\n"), "{stdout}");
    let (code, _, stderr) = run.tool(&["sdo", "read", "disturbance", "6411:1"]);
    assert_eq!(code, Some(4));
    assert!(
        stderr.contains("the default SDO channel of node 17 belongs to the running controller"),
        "{stderr}"
    );
}

#[test]
fn tools_join_a_run_and_leave_the_controllers_sdo_channel_alone() {
    in_real_time(|| {
        let run = Run::start();
        let [request, answer] = ["610", "590"].map(|id| frames(&run.log(), id));
        assert!(
            request > 10 && answer > 10,
            "the controller configured the drive by SDO"
        );

        let (code, stdout, stderr) = run.tool(&["nodes"]);
        assert_eq!(code, Some(0), "{stderr}");
        let row = |node: &str| {
            let row = stdout.lines().find(|line| line.contains(node));
            row.unwrap_or_else(|| panic!("no {node} in {stdout}"))
                .to_owned()
        };
        for (node, expected) in [
            ("1 (0x01)", &["operational", "controller.eds"][..]),
            ("16 (0x10)", &["operational", "CiA 402", "drive.eds"]),
            (
                "17 (0x11)",
                &["operational", "not asked", "disturbance.eds?"],
            ),
        ] {
            let row = row(node);
            expected
                .iter()
                .for_each(|word| assert!(row.contains(word), "{word} in {row}"));
        }

        sdo_reads_and_writes_beside_the_controller(&run);

        let (code, stdout, stderr) =
            run.tool(&["monitor", "--only", "drive_tpdo1", "--count", "5"]);
        assert_eq!(code, Some(0), "{stderr}");
        assert_eq!(stdout.lines().count(), 5, "{stdout}");
        for line in stdout.lines() {
            for part in [
                "190  drive_tpdo1",
                "statusword_state=\"operation enabled\"",
                " mm  current_amperes=",
            ] {
                assert!(line.contains(part), "{part} in {line}");
            }
        }

        let (printed, log) = run.end();
        assert!(printed.contains("bus address: embedded:"), "{printed}");
        // The drive's second channel was used, and only the controller used a default channel of a slave.
        assert!(frames(&log, "690") >= 8 && frames(&log, "6D0") >= 8);
        assert_eq!(["610", "590"].map(|id| frames(&log, id)), [request, answer]);
        assert_eq!(frames(&log, "611"), 0);
    });
}

/// A bus of the test, with the plant emulator on it and no manager.
struct Bench {
    hub: Hub,
    recorder: Recorder,
    plant_emulator: Child,
    runtime: tempfile::TempDir,
}

impl Bench {
    fn start() -> Self {
        Self::of(&scenario("step.toml"), &[], 0x711)
    }

    /// Starts an emulator, and waits until its last node has booted.
    fn of(scenario: &Path, more: &[&str], boot_up: u16) -> Self {
        let (hub, mut recorder) = Hub::start().unwrap();
        let runtime = tempfile::tempdir().unwrap();
        let plant_emulator = tool(
            runtime.path(),
            &[
                "node",
                "plant-emulator",
                "--bus",
                &hub.address().to_string(),
            ],
        )
        .arg("--scenario")
        .arg(scenario)
        .args(more)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
        wait_for("the nodes' boot-up", || {
            recorder
                .next()
                .is_some_and(|stamped| stamped.frame.standard_id() == Some(boot_up))
        });
        Self {
            hub,
            recorder,
            plant_emulator,
            runtime,
        }
    }

    fn tool(&self, arguments: &[&str]) -> (Option<i32>, String, String) {
        let address = self.hub.address().to_string();
        output(tool(self.runtime.path(), arguments).args(["--bus", &address]))
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.plant_emulator.stdin.take());
        let _ = self.plant_emulator.wait();
    }
}

/// Two drives in the rig, of which one is present.
#[test]
fn nodes_are_known_by_the_names_of_the_rig() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/worlds/tests/data");
    let (two_axes, rig) = (data.join("two_axes.toml"), data.join("two_axes_rig.toml"));
    in_real_time(|| {
        let bench = Bench::of(&two_axes, &["--plant", "gantry_y"], 0x712);
        // A rig file and a scenario have the same nodes.
        for names in [&rig, &two_axes] {
            let names = ["--rig", names.to_str().unwrap()];
            let tool = |arguments: &[&str]| bench.tool(&[arguments, &names].concat());
            let (code, stdout, stderr) = tool(&["nodes", "--listen", "0.3"]);
            assert_eq!(code, Some(0), "{stderr}");
            assert!(stdout.contains("18 (0x12) y"), "{stdout}");
            let absent = "not on the bus: 1 (0x01) controller, 16 (0x10) x";
            assert!(stdout.contains(absent), "{stdout}");
            let (code, stdout, stderr) = tool(&["sdo", "read", "y", "1801:2"]);
            assert_eq!(code, Some(0), "{stderr}");
            assert!(stdout.ends_with(" = 5 (0x05)\n"), "{stdout}");
            let (code, _, stderr) = tool(&["sdo", "read", "gantry", "1801:2"]);
            assert!(
                code == Some(2) && stderr.contains("one of controller, x, y"),
                "{stderr}"
            );
            let (code, stdout, stderr) = tool(&["monitor", "--only", "y_", "--count", "3"]);
            assert_eq!(code, Some(0), "{stderr}");
            assert!(
                stdout.lines().all(|line| line.contains("y_heartbeat")),
                "{stdout}"
            );
        }
    });
}

#[test]
fn each_node_has_an_eds() {
    let rig = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../crates/worlds/tests/data/two_axes_rig.toml"
    );
    let folder = tempfile::tempdir().unwrap();
    let sheets = folder.path().join("sheets");
    let write = || {
        let arguments = ["eds", rig, "--to", sheets.to_str().unwrap()];
        output(&mut tool(folder.path(), &arguments))
    };
    let (code, stdout, stderr) = write();
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stdout.contains("y.eds  node 18 (0x12)"), "{stdout}");
    for (name, node_id) in [("controller", 1), ("x", 0x10), ("y", 0x12)] {
        let text = fs::read_to_string(sheets.join(format!("{name}.eds"))).unwrap();
        assert!(text.contains(&format!("\nNodeID=0x{node_id:02X}\nNodeName={name}\n")));
        let objects = canopen::eds::parse(&text, node_id).unwrap();
        let pace = (name != "controller").then_some(5);
        assert_eq!(
            objects.unsigned(0x1801, 2).filter(|_| name != "controller"),
            pace
        );
    }
    let name = fs::read_to_string(sheets.join("x.eds")).unwrap();
    assert!(name.contains("\nDefaultValue=two axes x\n"), "{name}");
    assert!(!name.contains("SMA wire"), "{name}");
    let (code, _, stderr) = write();
    assert!(
        code == Some(4) && stderr.contains("is there already; remove it"),
        "{stderr}"
    );
}

#[test]
fn without_a_controller_every_node_answers() {
    in_real_time(|| {
        let mut bench = Bench::start();
        let (code, stdout, stderr) = bench.tool(&["nodes"]);
        assert_eq!(code, Some(0), "{stderr}");
        for (node, eds) in [
            ("16 (0x10)", " drive.eds"),
            ("17 (0x11)", " disturbance.eds"),
        ] {
            let row = stdout
                .lines()
                .find(|line| line.contains(node))
                .unwrap_or_else(|| panic!("no {node} in {stdout}"));
            assert!(
                row.contains("pre-operational") && row.contains(eds),
                "{row}"
            );
        }
        assert!(
            !stdout.contains("not asked") && !stdout.contains("controller"),
            "{stdout}"
        );

        let object = ["disturbance", "6411:2"];
        let (code, stdout, stderr) = bench.tool(&["sdo", "write", object[0], object[1], "-300"]);
        assert_eq!(code, Some(0), "{stderr}");
        assert!(stdout.contains("added_load_grams=-30.0 g"), "{stdout}");
        let (_, stdout, _) = bench.tool(&["sdo", "read", object[0], object[1]]);
        assert!(
            stdout.starts_with("0x6411:02  Added load (INTEGER16) = -300\n"),
            "{stdout}"
        );
        let name = bench
            .tool(&["sdo", "read", "drive", "Manufacturer device name"])
            .1;
        assert_eq!(
            name,
            "0x1008:00  Manufacturer device name (VISIBLE_STRING) = \"SMA wire drive\"\n"
        );
        let mut ids =
            std::iter::from_fn(|| bench.recorder.next()).map(|stamped| stamped.frame.standard_id());
        assert!(
            ids.any(|id| id == Some(0x67F)),
            "no node-ID was left out of the call"
        );
    });
}

#[test]
fn monitor_decodes_changes_and_ends_at_its_time() {
    in_real_time(|| {
        let bench = Bench::start();
        let earliest_end = Instant::now() + Duration::from_secs(1);
        let (code, stdout, stderr) = bench.tool(&["monitor", "--changes", "--duration", "1"]);
        assert_eq!(code, Some(0), "{stderr}");
        assert!(Instant::now() >= earliest_end, "it ended before its time");
        let heartbeats: Vec<_> = stdout
            .lines()
            .filter(|line| line.contains("drive_heartbeat"))
            .collect();
        assert_eq!(heartbeats.len(), 1, "the state did not change: {stdout}");
        assert!(
            heartbeats[0].contains("nmt_state=\"pre-operational\""),
            "{}",
            heartbeats[0]
        );
    });
}

#[test]
fn ctrl_c_ends_the_monitor_cleanly() {
    in_real_time(|| {
        let bench = Bench::start();
        let arguments = ["monitor", "--bus", &bench.hub.address().to_string()];
        let monitor = tool(bench.runtime.path(), &arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(500));
        kill_process(Pid::from_child(&monitor), Signal::INT).unwrap();
        let ended = monitor.wait_with_output().unwrap();
        assert_eq!(ended.status.code(), Some(0), "{ended:?}");
        assert!(ended.stderr.is_empty(), "{ended:?}");
        let text = String::from_utf8(ended.stdout).unwrap();
        assert!(
            text.contains("drive_heartbeat") && text.ends_with('\n'),
            "{text}"
        );
    });
}

#[test]
fn the_help_of_sdo_says_how_numbers_are_read() {
    for arguments in [&["sdo", "--help"][..], &["sdo", "write", "--help"]] {
        let (code, stdout, _) = output(&mut tool(Path::new("/nowhere"), arguments));
        assert_eq!(code, Some(0));
        for expected in [
            "Index and sub-index are hexadecimal, with or without 0x",
            "Values and node numbers are decimal; with 0x they are hexadecimal.",
            "canrig sdo write 16 1017:00 50",
        ] {
            assert!(stdout.contains(expected), "{expected}: {stdout}");
        }
    }
}

#[test]
fn what_the_user_got_wrong_is_reported() {
    let runtime = tempfile::tempdir().unwrap();
    for (arguments, code, expected) in [
        (
            &["sdo", "read", "motor", "6064"][..],
            2,
            "\"motor\" is not a node",
        ),
        (
            &["sdo", "read", "drive", "warp"],
            2,
            "drive.eds has no object \"warp\"",
        ),
        (
            &["sdo", "write", "drive", "1017", "fast"],
            2,
            "a whole number is expected",
        ),
        (
            &["sdo", "write", "drive", "1017", "70000"],
            2,
            "does not fit UNSIGNED16",
        ),
        (
            &["sdo", "write", "5", "2000:1", "50"],
            2,
            "no EDS gives the type of 0x2000:01, so the size of \"50\" is not known",
        ),
        (&["monitor", "--duration=-1"], 2, "0 to 604800 seconds"),
        (
            &["monitor", "--dbc", "nowhere.dbc"],
            2,
            "nowhere.dbc` cannot be read",
        ),
        (&["nodes", "--bus", "a/b"], 2, "is not a bus"),
        (&["nodes"], 4, "no embedded bus of yours is running"),
        (
            &["nodes", "--bus", "embedded:/nowhere"],
            4,
            "no bus is at /nowhere",
        ),
    ] {
        let (ended, _, stderr) = output(&mut tool(runtime.path(), arguments));
        assert_eq!(ended, Some(code), "{arguments:?}: {stderr}");
        assert!(stderr.contains(expected), "{expected} in {stderr}");
    }
}

#[test]
fn a_silent_bus_has_no_node() {
    in_real_time(|| {
        let (hub, _recorder) = Hub::start().unwrap();
        let BusAddress::Embedded(path) = hub.address() else {
            panic!("a hub's address is its socket");
        };
        let runtime = tempfile::tempdir().unwrap();
        let address = format!("embedded:{}", path.display());
        let (code, stdout, _) = output(&mut tool(
            runtime.path(),
            &["nodes", "--listen", "0.2", "--bus", &address],
        ));
        assert_eq!(code, Some(0));
        assert_eq!(
            stdout,
            "no node: no heartbeat in 0.2 s and no answer to SDO\n"
        );
    });
}

/// A recording does not have the plants on which the objects of an io node depend.
#[test]
fn a_run_has_the_same_eds_files_as_its_rig() {
    let folder = tempfile::tempdir().unwrap();
    let sheets = |from: &str, to: &str| {
        let to = folder.path().join(to);
        let arguments = ["eds", from, "--to", to.to_str().unwrap()];
        let (code, _, stderr) = output(&mut tool(folder.path(), &arguments));
        assert_eq!(code, Some(0), "{stderr}");
        let files = fs::read_dir(to).unwrap().map(|file| file.unwrap());
        let text =
            |file: fs::DirEntry| (file.file_name(), fs::read_to_string(file.path()).unwrap());
        BTreeMap::from_iter(files.map(text))
    };
    let scenario = short_scenario(folder.path(), 0.1);
    let runs = folder.path().join("runs");
    let (code, said, stderr) = output(canrig(&runs, "simulate").arg(&scenario));
    assert!(matches!(code, Some(0 | 1)), "{said}{stderr}");
    let run = only_run(&runs);
    let of_run = sheets(run.to_str().unwrap(), "of_run");
    let of_rig = sheets(scenario.to_str().unwrap(), "of_rig");
    assert!(
        of_run.contains_key(OsStr::new("disturbance.eds")),
        "{:?}",
        of_run.keys()
    );
    assert_eq!(of_run, of_rig);
}
