//! A foreign master on the bus of a run: it is noticed and named, and the run does not pass.

use std::fs;
use std::path::Path;
use std::process::{Child, Command};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use can::{CanFrame, Filter};
use platform::bus::{Bus, BusAddress};

use crate::external::{LAW, Run, stop};
use crate::real_time::{in_real_time, wait_for};
use crate::support::{only_run, output};

const PERIOD: Duration = Duration::from_millis(100);

fn scenario_text(expect: &str) -> String {
    format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"shared\"\nduration_seconds = 3.0\n[bus]\nsync_period_milliseconds = 100.0\n\
         {LAW}[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
         [expect]\nposition_millimetres_max = {{ max = 59.0 }}\n{expect}"
    )
}

fn join(address: &str) -> Box<dyn Bus> {
    let address: BusAddress = address.parse().unwrap();
    platform::open(&address, &[Filter::ALL]).unwrap()
}

/// Begins a run that leads an emulated drive as an external one, and waits for the first command to it.
fn begin_beside_a_drive(folder: &Path) -> (Run, Child) {
    let arguments = ["--external", "drive", "--no-heating"];
    let run = Run::of(&scenario_text(""), folder, &arguments);
    let drive = run.start("plant-emulator");
    let runs = run.runs.clone();
    wait_for("the first command", || log(&runs).contains(" 210#0F00"));
    (run, drive)
}

/// Calls `work` while a foreign producer sends SYNC on the bus.
fn beside_a_producer<T>(address: &str, work: impl FnOnce() -> T) -> T {
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut bus = join(address);
            let sync = CanFrame::new(0x080, &[]);
            while !is_over.load(Ordering::Relaxed) && bus.send(&sync).is_ok() {
                thread::sleep(PERIOD);
            }
        });
        let result = work();
        is_over.store(true, Ordering::Relaxed);
        result
    })
}

fn log(runs: &Path) -> String {
    fs::read_to_string(only_run(runs).join("bus.log")).unwrap_or_default()
}

#[test]
fn a_foreign_producer_of_sync_is_named_and_no_run_beside_it_passes() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::of(&scenario_text(""), folder.path(), &[]);
        let runs = run.runs.clone();
        wait_for("the first command", || log(&runs).contains(" 210#0F00"));
        let address = run.address.clone();
        let (code, text, run) = beside_a_producer(&address, || run.end());
        assert_eq!(code, Some(5), "{text}");
        let reason = "inconclusive: a second master: 0x080 (SYNC), ";
        assert!(text.contains(reason), "{text}");
        let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
        let (code, text, stderr) = output(replay.arg("replay").arg(run));
        assert_eq!(code, Some(5), "{text}{stderr}");
        let same = "the same verdict as that of the run";
        assert!(text.contains(reason) && text.contains(same), "{text}");
    });
}

#[test]
fn beside_a_real_drive_a_second_master_ends_the_run_without_current() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let (run, drive) = begin_beside_a_drive(folder.path());
        let address = run.address.clone();
        let (code, text, run) = beside_a_producer(&address, || run.end());
        stop(drive);
        assert_eq!(code, Some(5), "{text}");
        let reason = "inconclusive: a second master: 0x080 (SYNC";
        assert!(text.contains(reason), "{text}");
        let log = fs::read_to_string(run.join("bus.log")).unwrap();
        // The foreign SYNC has no counter.
        let (_, foreign) = log.split_once(" 080#\n").expect("a foreign SYNC");
        let (until_stop, after) = foreign.split_once(" 000#0210\n").expect("NMT stop");
        let syncs = until_stop.matches(" 080#").count();
        assert!(syncs <= 4, "{syncs} SYNCs until the stop:\n{until_stop}");
        let is_heated = |line: &str| line.contains(" 190#37") && !line.ends_with("0000");
        assert!(
            !after.lines().any(is_heated),
            "the current flows on:\n{after}"
        );
    });
}

/// On an embedded bus the hub knows who sent a frame, so one in a drive's name is not the drive's.
#[test]
fn a_frame_in_the_name_of_a_drive_is_the_other_clients() {
    let said = [
        (
            CanFrame::new(0x710, &[0x04]),
            "0x710 (drive_heartbeat), 1 frame",
        ),
        (
            CanFrame::new(0x090, &[0x10, 0x23, 0x02, 0, 0, 0, 0, 0]),
            "0x090 (drive_emergency), 1 frame",
        ),
    ];
    for (frame, expected) in said {
        in_real_time(|| {
            let folder = tempfile::tempdir().unwrap();
            let (run, drive) = begin_beside_a_drive(folder.path());
            join(&run.address).send(&frame).unwrap();
            let (code, text, run) = run.end();
            stop(drive);
            assert_eq!(code, Some(5), "{text}");
            let reason =
                format!("inconclusive: a second master: {expected} of another client, from ");
            assert!(text.contains(&reason), "{text}");
            let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
            let (code, text, stderr) = output(replay.arg("replay").arg(run));
            assert_eq!(code, Some(5), "{text}{stderr}");
            assert!(
                text.contains(&reason) && text.contains("the same verdict"),
                "{text}"
            );
        });
    }
}

#[test]
fn a_bench_is_heard_during_its_pre_flight_and_its_pause() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let rig = folder.path().join("rig.toml");
        // With faster heating the load continues to its limit after the quick stop.
        let drive = "limits = { current_amperes = 1.0, min = -1.5, max = 59.5, rate_max = 1e4 }\n\
             timeouts = { drive_lost_milliseconds = 1000, controller_lost_milliseconds = 1000 }\n\
             preflight = { ramp_amperes_per_second = 0.25, heating_seconds_max = 5.0, cooling_seconds = 1.0 }";
        fs::write(&rig, crate::external::rig_of_a_drive(20.0, drive)).unwrap();
        let arguments = ["--rig", rig.to_str().unwrap(), "--dry-run"];
        let text = scenario_text("").replace("= 100.0", "= 20.0");
        let run = Run::of(&text, folder.path(), &arguments);
        let mut bus = join(&run.address);
        let drive = run.start("plant-emulator");
        let (code, text, waiting) = thread::scope(|scope| {
            let ended = scope.spawn(|| run.printed());
            let mut waiting = 0;
            while !ended.is_finished() {
                let heard = bus.receive(Duration::from_millis(100));
                let Ok(heard) = heard else { break };
                waiting += usize::from(heard == Some(CanFrame::new(0x701, &[0x7F])));
            }
            let (code, text) = ended.join().unwrap();
            (code, text, waiting)
        });
        stop(drive);
        assert_eq!(code, Some(0), "{text}");
        // This is 1 s of cooling, and the interview before it.
        assert!(waiting >= 15, "{waiting} heartbeats of a waiting manager");
    });
}

#[test]
fn a_pre_flight_that_hears_another_bench_wait_ends() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let arguments = ["--external", "drive", "--dry-run"];
        let run = Run::of(&scenario_text(""), folder.path(), &arguments);
        let mut bus = join(&run.address);
        let (code, text) = thread::scope(|scope| {
            let ended = scope.spawn(|| run.printed());
            let heartbeat = CanFrame::new(0x701, &[0x7F]);
            while !ended.is_finished() && bus.send(&heartbeat).is_ok() {
                thread::sleep(Duration::from_millis(50));
            }
            ended.join().unwrap()
        });
        assert_eq!(code, Some(4), "{text}");
        let reason =
            "canrig: a second master: the pre-flight hears the heartbeat of the manager, node 1";
        assert!(text.contains(reason), "{text}");
    });
}
