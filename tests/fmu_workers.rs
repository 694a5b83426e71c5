//! The processes that load FMUs: the result of a run when one is killed or too slow, and the remains.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use rustix::process::{Pid, Signal, kill_process, test_kill_process};

use crate::fmus::{cart, is_without_current};
use crate::processes::{Run, is_gone, last_command};
use crate::real_time::{Started, in_real_time, wait_for};
use crate::support::{canrig, only_run, output};

/// Writes a steady current on a cart with these start values. The cycle is so long that the nodes do not lose each
/// other on a busy machine.
fn steady(folder: &Path, duration_seconds: f64, mode: u32, from_seconds: f64) -> PathBuf {
    let path = cart(folder, "");
    let rig = folder.join("rigs/cart.toml");
    let text = fs::read_to_string(&rig).unwrap();
    let bus = "[bus]\nsync_period_milliseconds = 20.0\n[plant.cart.fmu]\n";
    fs::write(&rig, text.replacen("[plant.cart.fmu]\n", bus, 1)).unwrap();
    let text = format!(
        "schema = 1\nrig = \"rigs/cart.toml\"\nname = \"steady\"\nduration_seconds = {duration_seconds:?}\n\
         [plant.cart.start]\nmode = {mode}\nfrom_seconds = {from_seconds:?}\n\
         [[controller.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.05\n\
         [expect]\nmissed_cycles_percent = {{ max = 1.0 }}\n"
    );
    fs::write(&path, text).unwrap();
    path
}

/// Returns the fields of a process's `stat` from its state on.
fn stat(number: i32) -> Option<Vec<String>> {
    let stat = fs::read_to_string(format!("/proc/{number}/stat")).ok()?;
    let (_, fields) = stat.rsplit_once(')')?;
    Some(fields.split_whitespace().map(str::to_owned).collect())
}

/// Returns the only child of a process.
fn child(of: Pid) -> Option<Pid> {
    let of = of.as_raw_nonzero().to_string();
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let mut numbers = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let number = numbers.find(|number| stat(*number).is_some_and(|stat| stat[1] == of))?;
    Pid::from_raw(number)
}

/// Returns the process with the FMU of another process; its keeper is between them.
fn worker(process: Pid) -> Pid {
    let worker = || child(child(process)?);
    wait_for("the worker", || worker().is_some());
    worker().unwrap()
}

/// Returns policy and priority of a process: 1 is SCHED_FIFO.
fn scheduling(process: Pid) -> [i32; 2] {
    let stat = stat(process.as_raw_nonzero().get()).unwrap();
    [&stat[38], &stat[37]].map(|field| field.parse().unwrap())
}

/// Returns the remains of unpacked FMUs.
fn left(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.collect()
}

/// Returns a text without its line ends.
fn flat(text: &str) -> String {
    Vec::from_iter(text.split_whitespace()).join(" ")
}

/// Returns the emulator's process of a run, and its worker.
fn emulator_and_worker(run: &Run) -> (Pid, Pid) {
    wait_for("the emulator", || run.find_node("plant-emulator").is_some());
    let emulator = run.node("plant-emulator");
    (emulator, worker(emulator))
}

/// Asserts that the run names the FMU, its plant and its end, and leaves no process, no current and no file.
fn is_named_and_nothing_stays(run: Run, worker: Pid) {
    let nodes = ["controller", "plant-emulator"].map(|node| run.node(node));
    kill_process(worker, Signal::KILL).unwrap();
    let runtime = run.runtime();
    let (code, text, folder) = run.end();
    let flat = flat(&text);
    assert_eq!(code, Some(1), "{flat}");
    for said in [
        "the plant `cart` cannot go on",
        "cart.fmu: the process that had it loaded was ended by signal 9",
        "while it stepped; only this run is lost",
    ] {
        assert!(flat.contains(said), "{said}: {flat}");
    }
    assert!(nodes.into_iter().chain([worker]).all(is_gone));
    assert_eq!(left(&runtime), [""; 0]);
    fs::remove_dir(runtime).unwrap();
    is_without_current(&only_run(folder.path()));
}

#[test]
fn a_worker_killed_in_lockstep_is_named_and_nothing_stays() {
    let folder = tempfile::tempdir().unwrap();
    // The FMU stops its worker by itself, which leaves time to act; virtual time leaves none.
    let steady = steady(folder.path(), 10.0, 8, 4.0);
    let run = Run::begin(&steady, "lockstep");
    let (_, worker) = emulator_and_worker(&run);
    let is_stopped = || stat(worker.as_raw_nonzero().get()).is_some_and(|stat| stat[0] == "T");
    wait_for("the worker to stop", is_stopped);
    is_named_and_nothing_stays(run, worker);
}

#[test]
fn a_worker_killed_in_real_time_is_named_and_nothing_stays() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let steady = steady(folder.path(), 20.0, 0, 0.0);
        let run = Run::start(&steady, "real-time");
        let (emulator, worker) = emulator_and_worker(&run);
        // It is as urgent as the node that waits for it, if the system permits that, but delays no other one.
        let [policy, priority] = scheduling(emulator);
        let expected = [policy, (priority - 1).max(0)];
        assert_eq!(scheduling(worker), expected);
        is_named_and_nothing_stays(run, worker);
    });
}

/// A step takes 30 ms, and a cycle 20. On a busy machine the controller may give up the drive.
#[test]
fn an_fmu_that_is_too_slow_in_real_time_fails_its_run_and_its_drive_is_named() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let steady = steady(folder.path(), 6.0, 9, 3.0);
        let runs = folder.path().join("runs");
        let mut canrig = canrig(&runs, "run");
        let (code, stdout, stderr) = output(canrig.args(["--bus", "embedded"]).arg(steady));
        let flat = flat(&(stdout + &stderr));
        assert_eq!(code, Some(1), "{flat}");
        let is_named = ["lift: no position in ", "from the drive (node 16)"];
        assert!(
            is_named.iter().any(|message| flat.contains(message)),
            "{flat}"
        );
    });
}

/// Starts a simulation of the cart that hangs at once, which leaves time to act, with its temporary files in a folder;
/// returns it with its worker.
fn hanging(folder: &Path, name: &str) -> (Started, Pid) {
    let mut canrig = canrig(&folder.join(name), "simulate");
    canrig
        .arg(folder.join("step.toml"))
        .args(["--set", "plant.cart.start.mode=2"])
        .args(["--set", "plant.cart.start.from_seconds=0.0"])
        .env("TMPDIR", folder.join("temporary"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let canrig = Started::new(canrig.spawn().unwrap());
    let bench = Pid::from_raw(canrig.id().cast_signed()).unwrap();
    let worker = worker(bench);
    (canrig, worker)
}

#[test]
fn a_worker_ends_with_who_started_it_and_a_killed_one_costs_the_run() {
    let folder = tempfile::tempdir().unwrap();
    cart(folder.path(), "");
    let temporary = folder.path().join("temporary");
    fs::create_dir(&temporary).unwrap();
    let (bench, worker) = hanging(folder.path(), "bench");
    let id = Pid::from_raw(bench.id().cast_signed()).unwrap();
    kill_process(id, Signal::KILL).unwrap();
    wait_for("the worker's end", || test_kill_process(worker).is_err());
    drop(bench);
    // No process was left to remove the unpacked files; the next one that unpacks does it.
    assert_eq!(left(&temporary).len(), 1);
    let (bench, worker) = hanging(folder.path(), "worker");
    kill_process(worker, Signal::KILL).unwrap();
    let ended = bench.ended();
    let told = String::from_utf8_lossy(&[ended.stdout, ended.stderr].concat()).into_owned();
    assert!(matches!(ended.status.code(), Some(1 | 3)), "{told}");
    assert!(told.contains("was ended by signal 9"), "{told}");
    assert_eq!(left(&temporary), [""; 0]);
}

/// The bench continues, but does not know the folder of its node.
#[test]
fn what_a_killed_emulator_unpacked_is_removed_by_the_next_one() {
    let folder = tempfile::tempdir().unwrap();
    let steady = steady(folder.path(), 2.0, 2, 0.0);
    let run = Run::begin(&steady, "lockstep");
    let (emulator, worker) = emulator_and_worker(&run);
    let runtime = run.runtime();
    kill_process(emulator, Signal::KILL).unwrap();
    let (code, text, _folder) = run.end();
    assert_eq!(code, Some(4), "{text}");
    wait_for("the worker's end", || is_gone(worker));
    assert_eq!(left(&runtime).len(), 1, "{:?}", left(&runtime));
    let mut next = canrig(&folder.path().join("next"), "simulate");
    let sound = ["--set", "plant.cart.start.mode=0"];
    let next = next.arg(steady).args(sound).env("TMPDIR", &runtime);
    let (code, stdout, stderr) = output(next);
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert_eq!(left(&runtime), [""; 0]);
}

/// A cycle takes 30 ms: the recorded part is on the disk soon, and a signal of the user is handled.
#[test]
fn a_slow_plant_in_lockstep_holds_up_neither_the_log_nor_a_signal() {
    let folder = tempfile::tempdir().unwrap();
    let steady = steady(folder.path(), 100.0, 9, 0.0);
    let run = Run::start(&steady, "lockstep");
    kill_process(run.id(), Signal::INT).unwrap();
    let runtime = run.runtime();
    let (code, text, folder) = run.end();
    assert_eq!(code, Some(130), "{text}");
    assert_eq!(left(&runtime), [""; 0]);
    fs::remove_dir(runtime).unwrap();
    let log = fs::read_to_string(only_run(folder.path()).join("bus.log")).unwrap();
    let last = last_command(&log);
    assert!(last.ends_with("0000"), "{last}");
    let cycles = log.lines().filter(|line| line.contains(" 080#")).count();
    assert!(cycles < 500, "{cycles}");
}
