//! Checks on any signal: refused if wrong, judged alike in every world, never silently passed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{canrig, only_run, output, root, scenario};

const PLAYED: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"checked\"\nseed = 7\nduration_seconds = 1.0\n\n[controller.sliding_mode]\n\n\
    [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\n\
    [[fault.node.crash]]\nfrom_seconds = 0.6\nnode = \"controller\"\n\n";

/// One check of each kind, and events in their order; all of them pass.
const MET: &str = "[[expect.signal]]\nname = \"Current actual value\"\nuntil_seconds = 0.6\nstays = { min = 0.0, max = 1.0 }\n\
    rate_per_second = { max = 1000.0 }\n\n\
    [[expect.signal]]\nname = \"drive_tpdo1.position_millimetres\"\nreaches = { min = 9.9 }\n\n\
    [[expect.signal]]\nname = \"position_millimetres\"\nfollows = { file = \"golden.csv\", tolerance = 0.001 }\n\n\
    [[expect.sequence]]\nname = \"frame loss\"\nfrom_seconds = 0.5\nevent = [\n\
    { text = \"loss: no SYNC\" },\n\
    { emcy = \"drive 0x8130\", within_milliseconds = 120.0 },\n\
    { signal = \"plant_current_amperes\", reaches = { max = 0.0 }, for_milliseconds = 50.0, within_milliseconds = 60.0 },\n]\n";

fn write(folder: &Path, checks: &str, course: Option<&Path>) -> PathBuf {
    let path = folder.join("checked.toml");
    fs::write(&path, format!("{PLAYED}{checks}")).unwrap();
    if let Some(course) = course {
        fs::copy(course, folder.join("golden.csv")).unwrap();
    }
    path
}

/// Plays a scenario without checks up to the crash, as the reference for a later run.
fn golden(folder: &Path) -> PathBuf {
    let runs = folder.join("golden");
    let path = write(folder, "", None);
    output(canrig(&runs, "simulate").arg(path));
    let signals = only_run(&runs).join("signals.csv");
    let table = fs::read_to_string(&signals).unwrap();
    let until_crash: Vec<&str> = table.lines().take(590).collect();
    fs::write(&signals, until_crash.join("\n")).unwrap();
    signals
}

#[test]
fn checks_are_judged_alike_in_one_process_in_three_and_again() {
    let folder = tempfile::tempdir().unwrap();
    let signals = golden(folder.path());
    let path = write(folder.path(), MET, Some(&signals));
    let verdict = |runs: &str, command: &str, arguments: &[&str]| {
        let runs = folder.path().join(runs);
        let (code, stdout, stderr) = output(canrig(&runs, command).args(arguments).arg(&path));
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        let run = only_run(&runs);
        (fs::read_to_string(run.join("verdict.json")).unwrap(), run)
    };
    let (simulated, run) = verdict("one", "simulate", &[]);
    let lockstep = ["--clock", "lockstep", "--bus", "embedded"];
    assert_eq!(verdict("three", "run", &lockstep).0, simulated);
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (_, replayed, stderr) = output(replay.args(["replay", "--json"]).arg(&run));
    assert_eq!(replayed, simulated, "{stderr}");
    for row in [
        "Current actual value stays until 0.6 s",
        "drive_tpdo1.position_millimetres reaches at least 9.9 within seconds",
        "position_millimetres follows golden.csv",
        "frame loss, 3: plant_current_amperes at most 0 for 50 ms within milliseconds",
    ] {
        assert!(simulated.contains(row), "{row}: {simulated}");
        let junit = fs::read_to_string(run.join("junit.xml")).unwrap();
        assert!(junit.contains(row), "{row}: {junit}");
        let page = fs::read_to_string(run.join("report.html")).unwrap();
        assert!(page.replace("<wbr>", "").contains(row), "{row}");
    }
    assert!(simulated.contains("\"at_seconds\""), "{simulated}");
}

/// Each kind of check fails in an impossible version, with its message.
#[test]
fn every_check_can_fail_and_says_when() {
    let folder = tempfile::tempdir().unwrap();
    let course = folder.path().join("course.csv");
    fs::write(
        &course,
        "time_seconds,position_millimetres\n0.1,50.0\n0.5,50.0\n",
    )
    .unwrap();
    let signal = |name: &str, demand: &str| {
        format!("[[expect.signal]]\nname = \"{name}\"\nuntil_seconds = 0.5\n{demand}\n\n")
    };
    let checks = [
        signal("current_amperes", "stays = { max = 0.1 }"),
        signal("current_amperes", "reaches = { min = 5.0 }"),
        signal("current_amperes", "rate_per_second = { max = 0.0 }"),
        signal("position_millimetres", "from_seconds = 0.1\nfollows = { file = \"golden.csv\", tolerance = 1.0 }"),
        signal("convection_factor", "stays = { max = 1.0 }"),
        signal("drive_emergency.error_code", "stays = { max = 0.0 }"),
        "[[expect.signal]]\nname = \"target_current_amperes\"\nstays = { max = 1.0 }\n\n".to_owned(),
        "[[expect.sequence]]\nname = \"no loss\"\nuntil_seconds = 0.5\nevent = [{ text = \"loss\" }]\n".to_owned(),
    ];
    let path = write(folder.path(), &checks.concat(), Some(&course));
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(1), "{stderr}");
    let failed = stdout.lines().filter(|line| line.contains("FAIL ")).count();
    assert_eq!(failed, checks.len(), "{stdout}");
    for text in [
        "1.000 at 0.0",
        "not reached, only 1 at 0.",
        "disturbance_rpdo1.convection_factor never was on the bus",
        "no sample; the first comes at 0.6",
        "silent from 0.599 to 1.000 s",
        "did not come after 0.000 s",
    ] {
        assert!(stdout.contains(text), "{text}: {stdout}");
    }
}

#[test]
fn a_wrong_name_is_reported_before_any_run() {
    let folder = tempfile::tempdir().unwrap();
    let check = "[[expect.signal]]\nname = \"drive_tpdo1.curent_amperes\"\nstays = { max = 1.0 }\n";
    let path = write(folder.path(), check, None);
    let mut checking = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, _, stderr) = output(checking.arg("check").arg(&path).env("NO_COLOR", "1"));
    assert_eq!(code, Some(3));
    for text in [
        "no signal is called `drive_tpdo1.curent_amperes`",
        "did you mean `drive_tpdo1.current_amperes`?",
        "canrig signals SCENARIO",
    ] {
        assert!(stderr.contains(text), "{text}: {stderr}");
    }
    let runs = folder.path().join("runs");
    let (code, ..) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!((code, runs.exists()), (Some(3), false));
}

fn signals(arguments: &[&str], source: Option<&Path>) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.arg("signals").args(arguments).args(source);
    output(canrig.env("NO_COLOR", "1"))
}

#[test]
fn every_signal_is_listed_with_unit_sender_message_and_range() {
    let (code, stdout, stderr) = signals(&[], None);
    assert_eq!(code, Some(0), "{stderr}");
    let row = |name: &str| stdout.lines().find(|line| line.contains(name)).unwrap();
    for (name, parts) in [
        ("│ current_amperes ", ["A", "drive", "drive_tpdo1", " … "]),
        (
            "│ statusword_warning ",
            ["drive", "drive_tpdo1", "0 no", "1 yes"],
        ),
    ] {
        for part in parts {
            assert!(row(name).contains(part), "{part}: {}", row(name));
        }
    }
    let (code, json, _) = signals(&["--json"], None);
    let listed: Vec<serde_json::Value> = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (code, listed.len()),
        (Some(0), stdout.matches("\n│ ").count() - 1)
    );
    assert!(
        listed
            .iter()
            .any(|signal| signal["path"] == "drive_tpdo1.position_millimetres")
    );
}

/// Each name is listed with the loop of its `[[expect.LOOP.signal]]`, and is found there.
#[test]
fn the_signals_of_several_loops_are_listed_by_loop() {
    let scenario = root().join("scenarios/two_axes_circle.toml");
    let (code, stdout, stderr) = signals(&["--json"], Some(&scenario));
    assert_eq!(code, Some(0), "{stderr}");
    let listed: Vec<serde_json::Value> = serde_json::from_str(&stdout).unwrap();
    let loops_of = |path: &str| {
        let same = listed.iter().filter(|signal| signal["path"] == path);
        Vec::from_iter(same.map(|signal| signal["loop"].as_str()))
    };
    for name in ["x", "y"] {
        let sample = loops_of(&format!("{name}_tpdo1.position_millimetres"));
        assert_eq!(sample, [Some(name)]);
    }
    assert_eq!(loops_of("controller_heartbeat.nmt_state"), [None]);
    let (_, table, _) = signals(&[], Some(&scenario));
    assert!(table.contains("In [[expect.LOOP.signal]] write"), "{table}");
}

/// The list also works for a scenario with a wrong name, whose author needs it most. A run's frames are those of its
/// `frames.dbc`.
#[test]
fn the_signals_of_a_scenario_and_of_a_run_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("motor.toml");
    let text = fs::read_to_string(scenario("motor_step.toml")).unwrap();
    let wrong = "[[expect.signal]]\nname = \"winding\"\nstays = { max = 1.0 }\n";
    fs::write(&path, format!("{text}\n{wrong}")).unwrap();
    let (code, of_scenario, stderr) = signals(&[], Some(&path));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        of_scenario.contains("winding_temperature_celsius"),
        "{of_scenario}"
    );
    assert!(!signals(&[], None).1.contains("winding_temperature_celsius"));
    let circle = folder.path().join("circle.toml");
    let text = fs::read_to_string(scenario("two_axes_circle.toml")).unwrap();
    let wrong = wrong.replace("expect", "expect.x");
    fs::write(&circle, format!("{text}\n{wrong}")).unwrap();
    let (code, listed, stderr) = signals(&[], Some(&circle));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(listed.contains("winding_temperature_celsius"), "{listed}");

    let runs = folder.path().join("runs");
    output(canrig(&runs, "simulate").arg(write(folder.path(), "", None)));
    let run = only_run(&runs);
    let frames = run.join("frames.dbc");
    let renamed = fs::read_to_string(&frames).unwrap();
    fs::write(&frames, renamed.replace("sync_counter", "counter_of_sync")).unwrap();
    let (code, of_run, stderr) = signals(&[], Some(&run));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(of_run.contains("│ counter_of_sync "), "{of_run}");
    assert_eq!(signals(&[], Some(folder.path())).0, Some(3));
}
