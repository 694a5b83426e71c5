//! Whole runs on a kernel CAN bus.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use libtest_mimic::Failed;
use socketcan::{CanFdFrame, CanFdSocket, EmbeddedFrame, Socket, StandardId};

use crate::support::{self, canrig, only_run, output, root, scenario};
use crate::{INTERFACE, Test};

/// Tests that need the interface for themselves.
pub(crate) const TESTS: [(&str, Test); 10] = [
    (
        "lockstep_over_vcan_leaves_the_same_bytes_as_one_process",
        same_bytes,
    ),
    (
        "two_axes_over_vcan_leave_the_same_bytes_as_one_process",
        same_bytes_of_two_axes,
    ),
    (
        "four_drives_over_vcan_leave_the_same_bytes_as_one_process",
        same_bytes_of_four_drives,
    ),
    (
        "two_drives_on_one_plant_over_vcan_leave_the_same_bytes_as_one_process",
        same_bytes_of_a_pair,
    ),
    (
        "a_motor_as_fmu_over_vcan_leaves_the_same_bytes_as_one_process",
        same_bytes_of_an_fmu,
    ),
    ("real_time_over_vcan_is_recorded_whole", real_time),
    ("a_foreign_frame_in_lockstep_is_refused", foreign_frame),
    (
        "errors_that_a_driver_reports_are_events_and_judged",
        bus_errors,
    ),
    (
        "a_second_bench_on_an_interface_ends_and_names_the_first",
        second_bench,
    ),
    ("fd_frames_are_counted_and_named", fd_frames),
];

/// Tests that make buses themselves, in the common namespace.
pub(crate) const PRIVATE_BUS_TESTS: [(&str, Test); 3] = [
    (
        "private_vcans_of_an_ordinary_user_never_meet_and_leave_nothing",
        private_buses,
    ),
    ("auto_prefers_a_private_vcan", auto_is_private),
    (
        "two_axes_on_a_private_vcan_leave_the_same_bytes_as_one_process",
        two_axes_in_private,
    ),
];

fn same_bytes() -> Result<(), Failed> {
    is_simulated_alike(&scenario("step.toml"))
}

fn same_bytes_of_two_axes() -> Result<(), Failed> {
    is_simulated_alike(&scenario("two_axes_circle.toml"))
}

fn same_bytes_of_four_drives() -> Result<(), Failed> {
    is_simulated_alike(&scenario("four_drives_courses.toml"))
}

fn same_bytes_of_a_pair() -> Result<(), Failed> {
    is_simulated_alike(&scenario("sma_pair_step.toml"))
}

fn same_bytes_of_an_fmu() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    for name in ["motor_rig.toml", "motor_step.toml"] {
        let example = root().join("docs/examples").join(name);
        fs::copy(example, folder.path().join(name))?;
    }
    let mut export = Command::new(env!("CARGO_BIN_EXE_canrig"));
    export.args(["fmu", "--export", "dc_motor", "--output"]);
    let (code, stdout, stderr) = output(export.arg(folder.path().join("motor.fmu")));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    is_simulated_alike(&folder.path().join("motor_step.toml"))
}

/// Returns the folder of two axes, a scenario and its rig file.
fn two_axes() -> PathBuf {
    root().join("crates/worlds/tests/data")
}

fn is_simulated_alike(scenario: &Path) -> Result<(), Failed> {
    let (simulated, crossed) = (tempfile::tempdir()?, tempfile::tempdir()?);
    let (code, stdout, stderr) = output(canrig(simulated.path(), "simulate").arg(scenario));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    let arguments = ["--bus", INTERFACE, "--require-vcan", "--clock", "lockstep"];
    let (code, stdout, stderr) =
        output(canrig(crossed.path(), "run").args(arguments).arg(scenario));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    for name in ["bus.log", "signals.csv", "verdict.json"] {
        let same = fs::read(only_run(simulated.path()).join(name))?
            == fs::read(only_run(crossed.path()).join(name))?;
        assert!(same, "{name} differs");
    }
    Ok(())
}

/// Plays in real time. A busy machine may hold up a node until its partner gives up, or the recorder until the kernel
/// drops frames, and the program reports this. A missing SYNC in the recording without such a report is an error.
fn real_time() -> Result<(), Failed> {
    let mut refusals = Vec::new();
    for _ in 0..3 {
        let folder = tempfile::tempdir()?;
        let short = support::short_scenario(folder.path(), 2.0);
        let runs = folder.path().join("runs");
        let arguments = ["--bus", INTERFACE, "--require-vcan"];
        let (code, stdout, stderr) = output(canrig(&runs, "run").args(arguments).arg(short));
        let printed = format!("{code:?}\n{stdout}\n{stderr}");
        if printed.contains("the recorder lost") {
            return Ok(());
        }
        if matches!(code, Some(0 | 5)) || printed.contains("too busy for real time") {
            let log = fs::read_to_string(only_run(&runs).join("bus.log"))?;
            let counters: Vec<u8> = log
                .lines()
                .filter_map(|line| line.split_once(" 080#"))
                .map(|(_, counter)| u8::from_str_radix(counter, 16).unwrap())
                .collect();
            // Their number depends on the machine; none may be missing between two others.
            assert!(counters.len() > 20, "{} SYNCs\n{printed}", counters.len());
            let gaps = counters
                .windows(2)
                .filter(|pair| pair[1] != pair[0] % 240 + 1)
                .count();
            assert_eq!(gaps, 0, "of {} SYNCs\n{printed}", counters.len());
            return Ok(());
        }
        refusals.push(printed);
    }
    Err(refusals.join("\n").into())
}

/// Another program on the bus would distort virtual time, so the nodes refuse to continue.
fn foreign_frame() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let arguments = ["--bus", INTERFACE, "--clock", "lockstep"];
    let mut canrig = canrig(folder.path(), "run");
    let run = canrig
        .args(arguments)
        .arg(scenario("step.toml"))
        .stderr(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()?;
    let mut bus = platform::open(
        &platform::bus::BusAddress::Interface(INTERFACE.to_owned()),
        &[],
    )?;
    for _ in 0..20 {
        std::thread::sleep(std::time::Duration::from_millis(100));
        bus.send(&can::CanFrame::new(0x190, &[0; 8]))?;
    }
    let ended = run.wait_with_output()?;
    let [stdout, stderr] = [ended.stdout, ended.stderr].map(String::from_utf8);
    let (stdout, stderr) = (stdout?, stderr?);
    assert_eq!(ended.status.code(), Some(4), "{stdout}{stderr}");
    assert!(
        stderr.contains("is another program sending on this bus?"),
        "{stderr}"
    );
    Ok(())
}

/// A vcan has no errors of its own, but passes on the messages by which a driver reports some.
fn bus_errors() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let scenario = support::unhurried_scenario(folder.path(), 3.0);
    let mut text = fs::read_to_string(&scenario)?;
    text += "[expect]\nno_event = [\"no acknowledgement\"]\n";
    fs::write(&scenario, text)?;
    let runs = folder.path().join("runs");
    let mut canrig = canrig(&runs, "run");
    let run = canrig
        .args(["--bus", INTERFACE])
        .arg(&scenario)
        .stderr(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()?;
    let address = platform::bus::BusAddress::Interface(INTERFACE.to_owned());
    let mut bus = platform::open(&address, &[])?;
    // The scenario begins within the first second.
    std::thread::sleep(std::time::Duration::from_millis(1500));
    // There are two missing acknowledgements, then the warning level of sending.
    let reported = [(0x020, 0), (0x020, 0), (0x004, 0x08)];
    for (class, controller) in reported {
        let data = [0, controller, 0, 0, 0, 0, 0, 0];
        let message = can::CanFrame::from_raw(can::frame::ERROR_FLAG | class, 8, data);
        bus.send(&message.ok_or("a frame")?)?;
    }
    let ended = run.wait_with_output()?;
    let (stdout, stderr) = (
        String::from_utf8(ended.stdout)?,
        String::from_utf8(ended.stderr)?,
    );
    assert_eq!(ended.status.code(), Some(1), "{stdout}\n{stderr}");
    let verdict = fs::read_to_string(only_run(&runs).join("verdict.json"))?;
    for reported_once in [" s bench: no acknowledgement", " s bench: error warning"] {
        let count = verdict.matches(reported_once).count();
        assert_eq!(count, 1, "{reported_once}: {verdict}");
    }
    Ok(())
}

/// Both would hear no other node at first, and lead then.
fn second_bench() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let scenario = support::unhurried_scenario(folder.path(), 3.0);
    let run = |name: &str| {
        let mut canrig = canrig(&folder.path().join(name), "run");
        canrig.args(["--bus", INTERFACE]).arg(&scenario);
        canrig
    };
    let first = run("first")
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()?;
    let process = first.id();
    std::thread::sleep(std::time::Duration::from_millis(1500));
    let (code, _, stderr) = output(&mut run("second"));
    assert_eq!(code, Some(4), "{stderr}");
    let said = format!("a second master: process {process} of this machine plays on {INTERFACE}");
    assert!(stderr.contains(&said), "{stderr}");
    first.wait_with_output()?;
    let (code, _, stderr) = output(&mut run("third"));
    assert!(matches!(code, Some(0 | 5)), "{stderr}");
    Ok(())
}

fn fd_frames() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let scenario = support::unhurried_scenario(folder.path(), 4.0);
    let runs = folder.path().join("runs");
    let mut canrig = canrig(&runs, "run");
    let run = canrig
        .args(["--bus", INTERFACE])
        .arg(&scenario)
        .stdout(std::process::Stdio::piped())
        .spawn()?;
    let log = || match fs::read_dir(&runs).ok().and_then(|mut runs| runs.next()) {
        Some(Ok(run)) => fs::read_to_string(run.path().join("bus.log")).unwrap_or_default(),
        _ => String::new(),
    };
    while !log().contains(" 080#") {
        std::thread::sleep(std::time::Duration::from_millis(100));
    }
    let mut monitor = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let monitor = monitor
        .args(["monitor", "--bus", INTERFACE, "--duration", "3"])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::piped())
        .spawn()?;
    std::thread::sleep(std::time::Duration::from_millis(1000));
    let socket = CanFdSocket::open(INTERFACE)?;
    let id = StandardId::new(0x123).ok_or("an identifier")?;
    let frame = CanFdFrame::new(id, &[7; 12]).ok_or("a frame")?;
    for _ in 0..3 {
        socket.write_frame(&frame)?;
    }
    let stderr = String::from_utf8(monitor.wait_with_output()?.stderr)?;
    assert!(
        stderr.contains("3 CAN FD frames were on the bus"),
        "{stderr}"
    );
    let stdout = String::from_utf8(run.wait_with_output()?.stdout)?;
    assert!(stdout.contains("3 CAN FD frames on the bus"), "{stdout}");
    let run = only_run(&runs);
    let stored = fs::read_to_string(run.join("verdict.json"))?;
    assert!(stored.contains("\"fd_frames\": 3"), "{stored}");
    let log = fs::read_to_string(run.join("bus.log"))?;
    assert!(!log.contains(" 123#"), "an FD frame is no classical one");
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (_, again, stderr) = output(replay.args(["replay", "--json"]).arg(&run));
    assert_eq!(again, stored, "{stderr}");
    Ok(())
}

/// A folder for an ordinary user, with the program and a scenario in it: root's checkout may be closed to others.
struct Guest {
    folder: tempfile::TempDir,
}

impl Guest {
    fn new() -> Result<Self, Failed> {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir_in("/dev/shm")?;
        fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o777))?;
        fs::copy(env!("CARGO_BIN_EXE_canrig"), folder.path().join("canrig"))?;
        support::short_scenario(folder.path(), 1.0);
        Ok(Self { folder })
    }

    /// Returns the program as an ordinary user, with its runs in the folder `name`, on a short scenario.
    fn canrig(&self, command: &str, name: &str) -> Command {
        let mut canrig = self.canrig_alone(command, name);
        canrig.arg(self.folder.path().join("short.toml"));
        canrig
    }

    /// Returns the same without a scenario.
    fn canrig_alone(&self, command: &str, name: &str) -> Command {
        let program = self.folder.path().join("canrig");
        let mut canrig = if rustix::process::geteuid().is_root() {
            let mut setpriv = Command::new("setpriv");
            setpriv.args(["--reuid", "65534", "--regid", "65534", "--clear-groups"]);
            setpriv.arg(program);
            setpriv
        } else {
            Command::new(program)
        };
        canrig.arg(command).arg("--output");
        canrig.arg(self.folder.path().join(name));
        canrig
    }

    fn log(&self, name: &str) -> Result<Vec<u8>, Failed> {
        self.file(name, "bus.log")
    }

    /// Returns a file of a run.
    fn file(&self, name: &str, file: &str) -> Result<Vec<u8>, Failed> {
        let run = only_run(&self.folder.path().join(name));
        Ok(fs::read(run.join(file))?)
    }
}

/// Returns the frames that have crossed the common interface, if there is one.
fn frames_on_the_common_bus() -> Option<String> {
    fs::read_to_string(format!("/sys/class/net/{INTERFACE}/statistics/tx_packets")).ok()
}

/// Returns the number of processes with another namespace.
fn processes_elsewhere() -> Result<usize, Failed> {
    let ours = fs::read_link("/proc/self/ns/net")?;
    let processes = fs::read_dir("/proc")?.filter_map(|entry| Some(entry.ok()?.path()));
    let theirs = processes.filter_map(|path| fs::read_link(path.join("ns/net")).ok());
    Ok(theirs.filter(|theirs| *theirs != ours).count())
}

fn private_buses() -> Result<(), Failed> {
    let guest = Guest::new()?;
    let before = (frames_on_the_common_bus(), processes_elsewhere()?);
    let runs = ["one", "other"].map(|name| {
        let mut canrig = guest.canrig("run", name);
        canrig.args(["--bus", "private", "--require-vcan", "--clock", "lockstep"]);
        canrig.arg("--quiet").spawn()
    });
    for run in runs {
        assert_eq!(run?.wait()?.code(), Some(0));
    }
    let (code, stdout, stderr) = output(&mut guest.canrig("simulate", "simulated"));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    let simulated = guest.log("simulated")?;
    assert!(guest.log("one")? == simulated && guest.log("other")? == simulated);
    assert_eq!((frames_on_the_common_bus(), processes_elsewhere()?), before);
    Ok(())
}

fn auto_is_private() -> Result<(), Failed> {
    let guest = Guest::new()?;
    let (code, stdout, stderr) = output(guest.canrig("run", "auto").args(["--clock", "lockstep"]));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    assert!(stdout.contains("bus: private"), "{stdout}");
    Ok(())
}

fn two_axes_in_private() -> Result<(), Failed> {
    let guest = Guest::new()?;
    for name in ["two_axes.toml", "two_axes_rig.toml"] {
        fs::copy(two_axes().join(name), guest.folder.path().join(name))?;
    }
    let scenario = guest.folder.path().join("two_axes.toml");
    let in_private = ["--bus", "private", "--require-vcan", "--clock", "lockstep"];
    for (command, arguments) in [("simulate", &[][..]), ("run", &in_private)] {
        let mut canrig = guest.canrig_alone(command, command);
        let (code, stdout, stderr) = output(canrig.args(arguments).arg(&scenario));
        assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    }
    for name in ["bus.log", "signals.csv", "verdict.json"] {
        let is_same = guest.file("simulate", name)? == guest.file("run", name)?;
        assert!(is_same, "{name} differs");
    }
    Ok(())
}
