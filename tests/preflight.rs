//! The pre-flight of an external drive, with the emulator in its place: each check passes, and fails if its condition
//! is violated. The unit tests of `crates/worlds/src/preflight` cover behaviour that the emulated drive lacks.

use std::fs;
use std::path::{Path, PathBuf};

use rustix::process::{Pid, Signal, kill_process};

use crate::external::{Run, start, stop};
use crate::real_time::{in_real_time, wait_for};

/// Returns a scenario for bench and emulator; the emulator's has faults that the bench does not know.
fn scenario_text(faults: &str) -> String {
    let seconds = if faults.is_empty() { 1 } else { 10 };
    format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"flown\"\nduration_seconds = {seconds}.0\n[bus]\nsync_period_milliseconds = 20.0\n\
         [controller.sliding_mode]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n{faults}"
    )
}

/// Writes a rig whose drive is the emulator, with limits, a ramp and patience that make a test quick; `drive` are
/// further keys of the drive. With faster heating the load continues for 35 mm after the quick stop, close to the
/// limit.
fn rig_file(folder: &Path, drive: &str, bring_up_seconds: f64) -> PathBuf {
    let path = folder.join("emulated.toml");
    let drive = format!(
        "{drive}\nlimits = {{ current_amperes = 1.0, min = -1.5, max = 59.5, rate_max = 1e4 }}\n\
         preflight = {{ ramp_amperes_per_second = 0.25, heating_seconds_max = 5.0, cooling_seconds = 0.5 }}\n\
         [node.drive.timeouts]\nbring_up_seconds = {bring_up_seconds:?}\ndrive_lost_milliseconds = 1000\n\
         controller_lost_milliseconds = 1000"
    );
    fs::write(&path, crate::external::rig_of_a_drive(20.0, &drive)).unwrap();
    path
}

/// Returns exit code and output of a pre-flight without a scenario, of a drive with these keys and faults.
fn flown(drive: &str, faults: &str) -> (Option<i32>, String) {
    let folder = tempfile::tempdir().unwrap();
    flown_in(folder.path(), drive, faults)
}

fn flown_in(folder: &Path, drive: &str, faults: &str) -> (Option<i32>, String) {
    let rig = rig_file(folder, drive, 20.0);
    let run = dry_run(folder, &rig);
    let emulated = folder.join("drive.toml");
    fs::write(&emulated, scenario_text(faults)).unwrap();
    let drive = start(&run.address, "plant-emulator", &emulated);
    let printed = run.printed();
    stop(drive);
    printed
}

fn dry_run(folder: &Path, rig: &Path) -> Run {
    let arguments = ["--rig", rig.to_str().unwrap(), "--dry-run"];
    Run::of(&scenario_text(""), folder, &arguments)
}

/// After a failed pre-flight the next scenario is not played.
#[test]
fn nothing_is_played_after_a_pre_flight_that_failed() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let rig = rig_file(folder.path(), "", 1.0);
        let second = folder.path().join("second.toml");
        fs::write(&second, scenario_text("")).unwrap();
        let arguments = ["--rig", rig.to_str().unwrap(), second.to_str().unwrap()];
        let (code, text) = Run::of(&scenario_text(""), folder.path(), &arguments).printed();
        assert_eq!(code, Some(3), "{text}");
        assert_eq!(text.matches("pre-flight:").count(), 1, "{text}");
        assert_eq!(text.matches("run folder").count(), 1, "{text}");
    });
}

/// Asserts that the last check is the failed one, with its message.
fn fails((code, text): (Option<i32>, String), line: &str) {
    assert_eq!(code, Some(3), "{text}");
    let checks: Vec<&str> = text.lines().filter(|line| line.starts_with("  ")).collect();
    let last = checks.last().unwrap_or(&"");
    assert!(
        last.starts_with(&format!("  ✗ {line}")),
        "{line} is not in\n{text}"
    );
    assert!(text.contains("canrig: the pre-flight fails: "), "{text}");
}

#[test]
fn every_check_passes_on_the_emulator() {
    in_real_time(|| {
        let (code, text) = flown("", "");
        assert_eq!(code, Some(0), "{text}");
        let passed = [
            "✓ interface",
            "· bit rate",
            "✓ other manager none is heard",
            "✓ nodes         found: drive (node 16)",
            "✓ identity      as in the EDS",
            "✓ objects       8 read, 3 written",
            "✓ configuration PDOs 0x190 (8 bytes) and 0x210 (4 bytes)",
            "✓ drive         Operation enabled",
            "✓ position      0.00 to 0.00 mm without current",
            "✓ direction     rises by ",
            "✓ quick stop    no current after ",
            "✓ NMT stop      Stopped in a heartbeat after ",
            "✓ error frames  none",
        ];
        for line in passed {
            assert!(text.contains(line), "{line} is not in\n{text}");
        }
        // There is no further output.
        assert!(!text.contains("metric"), "{text}");
    });
}

#[test]
fn a_run_begins_with_the_pre_flight_and_heating_can_be_declined() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let rig = rig_file(folder.path(), "", 20.0);
        let arguments = ["--rig", rig.to_str().unwrap(), "--no-heating"];
        let run = Run::of(&scenario_text(""), folder.path(), &arguments);
        let (code, text, run) = run.end_beside("plant-emulator");
        // A busy machine may leave the scenario undecided.
        assert!(matches!(code, Some(0 | 5)), "{code:?} {text}");
        assert!(text.contains("· direction     not heated"), "{text}");
        assert!(text.contains("run folder"), "{text}");
        let flights = fs::read_dir(&run).unwrap().filter(|entry| {
            let name = entry.as_ref().unwrap().file_name();
            name.to_string_lossy().starts_with("pre-flight-")
        });
        let flight = flights.last().expect("the pre-flight is kept").unwrap();
        let log = fs::read_to_string(flight.path().join("bus.log")).unwrap();
        assert!(log.contains(" 000#0210"), "no NMT stop:\n{log}");
    });
}

#[test]
fn nobody_there_and_somebody_else_leading_are_reported() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let rig = rig_file(folder.path(), "", 1.0);
        let absent = dry_run(folder.path(), &rig).printed();
        fails(
            absent,
            "nodes         drive (node 16) answered no SDO for 1 s",
        );

        let folder = tempfile::tempdir().unwrap();
        let rig = rig_file(folder.path(), "", 20.0);
        let run = dry_run(folder.path(), &rig);
        let other = run.start("controller");
        let (code, text) = run.printed();
        stop(other);
        assert_eq!(code, Some(4), "{text}");
        let last = text.lines().rfind(|line| line.starts_with("  "));
        assert!(
            last.is_some_and(|line| line.contains("✗ other manager")),
            "{text}"
        );
        assert!(text.contains("canrig: a second master: "), "{text}");
    });
}

#[test]
fn another_drive_and_objects_that_it_has_not_are_reported() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let eds = dbc::DRIVE_EDS.replace("DefaultValue=0x00020192", "DefaultValue=0x00030192");
        assert_ne!(eds, dbc::DRIVE_EDS);
        fs::write(folder.path().join("other.eds"), eds).unwrap();
        let other = flown_in(folder.path(), "eds = \"other.eds\"", "");
        fails(
            other,
            "identity      0x1000:00 (Device type) is 0x20192, in the EDS 0x30192",
        );

        let folder = tempfile::tempdir().unwrap();
        let eds = dbc::DRIVE_EDS.replace("6064", "6063");
        fs::write(folder.path().join("other.eds"), eds).unwrap();
        let drive = "eds = \"other.eds\"\nposition = { object = \"0x6063\" }";
        let other = flown_in(folder.path(), drive, "");
        fails(other, "objects       0x6063:00 ");
    });
}

#[test]
fn an_object_that_the_drive_does_not_map_is_reported() {
    in_real_time(|| {
        // It exists, has the right kind and is writable, but is in no PDO.
        let other = flown("current = { object = \"0x1017\" }", "");
        fails(
            other,
            "configuration the drive did not accept 0x10170010 for ",
        );
    });
}

#[test]
fn a_position_that_cannot_be_is_reported_before_current_flows() {
    in_real_time(|| {
        let other = flown("position = { increments_at_zero = 50000.0 }", "");
        fails(
            other,
            "position      -50.00 to -50.00 mm without current, beyond the limits",
        );
        let noise = "[node.drive.sensor]\nnoise_rms = 0.3\n";
        fails(flown("", noise), "position      it moves from ");
    });
}

#[test]
fn a_wrong_sign_and_a_load_that_does_not_move_are_reported() {
    in_real_time(|| {
        let other = flown("position = { increments_per_unit = -1000.0 }", "");
        fails(other, "direction     falls by ");
        let dead = "[[fault.amplifier.dead]]\nfrom_seconds = 0.0\n";
        fails(flown("", dead), "direction     ");
    });
}

#[test]
fn a_current_that_nobody_commands_is_reported() {
    in_real_time(|| {
        let stuck = "[[fault.amplifier.stuck_on]]\nfrom_seconds = 1.2\ncurrent_amperes = 0.7\n";
        let line = "direction     the drive (node 16) ";
        fails(flown("", stuck), line);
    });
}

#[test]
fn a_limit_of_the_rig_holds_under_the_ramp_too() {
    in_real_time(|| {
        // 0x6064 is the position in micrometres, so 30 mm are reported as 60 mm.
        let drive = "position = { increments_per_unit = 500.0, resolution = 10.0 }";
        let other = flown(drive, "");
        // No motion is seen, so the load rises until the limit.
        fails(
            other,
            "direction     canrig stopped the drive: limit of the rig: the position is ",
        );
    });
}

#[test]
fn ctrl_c_under_the_ramp_takes_the_current_away() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        // This motion is never reached.
        let rig = rig_file(folder.path(), "position = { resolution = 10.0 }", 20.0);
        let run = dry_run(folder.path(), &rig);
        let drive = run.start("plant-emulator");
        let log = || {
            let runs = fs::read_dir(&run.runs).into_iter().flatten();
            let logs = runs.map(|run| run.unwrap().path().join("bus.log"));
            logs.filter_map(|log| fs::read_to_string(log).ok())
                .last()
                .unwrap_or_default()
        };
        // This is a command of 256 mA or more while the drive is enabled.
        let is_heated = |log: &str| {
            log.lines()
                .any(|line| line.contains(" 210#0F00") && !line.ends_with("00"))
        };
        wait_for("the drive to be heated", || is_heated(&log()));
        let canrig = Pid::from_raw(run.canrig.id().cast_signed()).unwrap();
        kill_process(canrig, Signal::INT).unwrap();
        let (code, text, folder) = run.end();
        stop(drive);
        assert_eq!(code, Some(130), "{text}");
        let log = fs::read_to_string(folder.join("bus.log")).unwrap();
        let (_, after) = log.split_once(" 210#02000000\n").expect("quick stop");
        assert!(after.contains(" 000#0210"), "no NMT stop:\n{after}");
        let last = after.lines().rev().find(|line| line.contains(" 190#"));
        assert!(last.is_some_and(|line| line.ends_with("0000")), "{last:?}");
    });
}

/// The emulated press represents a foreign one: its loop is in degrees.
#[test]
fn a_drive_in_degrees_is_flown_in_degrees() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let shipped = crate::support::scenario("press_turn.toml");
        let rig = fs::read_to_string(shipped.with_file_name("rigs").join("press.toml")).unwrap();
        // A light load lifts off under a small current.
        let light = rig.replace("load_kilograms = 2.0", "load_kilograms = 0.1");
        let slow = light.replace("period_milliseconds = 2.0", "period_milliseconds = 20.0");
        assert!(slow != light && light != rig);
        fs::write(folder.path().join("press.toml"), slow).unwrap();
        let text = fs::read_to_string(&shipped)
            .unwrap()
            .replace("rig = \"press\"", "rig = \"press.toml\"");
        let run = Run::of(
            &text,
            folder.path(),
            &["--external", "spindle", "--dry-run"],
        );
        let drive = start(&run.address, "plant-emulator", &run.scenario);
        let (code, text) = run.printed();
        stop(drive);
        assert_eq!(code, Some(0), "{text}");
        for line in [
            "✓ position      0.00 to 0.00 deg without current",
            "✓ direction     rises by ",
            " deg at 0.",
        ] {
            assert!(text.contains(line), "{line} is not in\n{text}");
        }
        assert!(!text.contains(" mm"), "{text}");
    });
}
