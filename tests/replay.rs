//! Recordings after the run: judged again, compared, exported.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use plan::catalogue::Catalogue;
use runner::recorded::Recorded;

use crate::real_time::in_real_time;
use crate::support::{canrig, only_run, output, scenario, short_scenario, unhurried_scenario};

/// Runs the program with a command that makes no runs.
fn tool(arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    output(canrig.args(arguments).env("NO_COLOR", "1"))
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn simulated(folder: &Path, path: &Path) -> PathBuf {
    let (code, stdout, stderr) = output(canrig(folder, "simulate").arg(path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    only_run(folder)
}

#[test]
fn a_recording_gives_its_verdict_again_to_the_byte() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), &scenario("step.toml"));
    let stored = fs::read_to_string(run.join("verdict.json")).unwrap();
    for recording in [run.clone(), run.join("bus.log")] {
        let (code, stdout, stderr) = tool(&["replay", "--json", text(&recording)]);
        assert_eq!(
            (code, stdout.as_str()),
            (Some(0), stored.as_str()),
            "{stderr}"
        );
    }
    let (_, stdout, _) = tool(&["replay", text(&run)]);
    assert!(
        stdout.contains("the same verdict as that of the run"),
        "{stdout}"
    );
}

/// Table of a plant that no bench has; the frames are those of the motor.
const CUSTOM_PLANT: &str = "[plant.motor.my_motor]\nwindings = \"two\"\n";
/// Message of a command that needs to know the plant.
const UNKNOWN_PLANT: &str = "unknown plant model `my_motor`";

/// Plays the DC motor, and then changes its rig file to an unknown plant.
fn run_of_an_unknown_plant(folder: &Path) -> PathBuf {
    let place = tempfile::tempdir().unwrap();
    let played = fs::read_to_string(scenario("rigs/dc_motor.toml")).unwrap();
    fs::write(place.path().join("motor.toml"), &played).unwrap();
    let step = fs::read_to_string(scenario("motor_step.toml")).unwrap();
    let path = place.path().join("motor_step.toml");
    fs::write(&path, step.replace("\"dc_motor\"", "\"motor.toml\"")).unwrap();
    let run = simulated(folder, &path);
    let unknown = played.replace("[plant.motor.dc_motor]\n", CUSTOM_PLANT);
    assert_ne!(unknown, played);
    fs::write(run.join("motor.toml"), unknown).unwrap();
    run
}

#[test]
fn a_recording_is_judged_again_without_its_plant_in_the_catalogue() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), &scenario("motor_step.toml"));
    let recorded = Recorded::load(&run, None, &Catalogue::shipped()).unwrap();
    let timelines = recorded.timelines().unwrap();
    let verdict = recorded.judge(&timelines).unwrap().to_json();
    assert_eq!(
        verdict,
        fs::read_to_string(run.join("verdict.json")).unwrap()
    );
}

#[test]
fn a_recording_of_a_plant_from_outside_is_read_by_the_files_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let run = run_of_an_unknown_plant(&runs);
    let stored = fs::read_to_string(run.join("verdict.json")).unwrap();
    let limits = run.join("scenario.toml");
    for arguments in [
        &["replay", "--json", text(&run)][..],
        &["replay", "--json", text(&run.join("bus.log"))],
        &["replay", "--json", text(&run), "--scenario", text(&limits)],
    ] {
        let (code, stdout, stderr) = tool(arguments);
        assert_eq!((code, stdout), (Some(0), stored.clone()), "{stderr}");
    }
    let (code, stdout, stderr) = tool(&["export", text(&run), "--format", "csv"]);
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(stdout, fs::read_to_string(run.join("signals.csv")).unwrap());
    for arguments in [
        &["report", text(&run)][..],
        &["compare", text(&run), text(&run)],
    ] {
        let (code, stdout, stderr) = tool(arguments);
        assert_eq!(code, Some(0), "{stdout}{stderr}");
    }
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("Motor speed") || page.contains("motor_speed"));
    let refused = tool(&["identify", text(&run), "--output", text(folder.path())]);
    assert_eq!(refused.0, Some(3));
    assert!(refused.2.contains("its plant is `my_motor`"), "{refused:?}");
    // A plant must be known to be played.
    for command in ["check", "simulate"] {
        let (code, _, stderr) = tool(&[command, text(&limits)]);
        assert_eq!(code, Some(3));
        assert!(stderr.contains(UNKNOWN_PLANT), "{stderr}");
    }
}

#[test]
fn a_run_folder_without_its_frames_is_read_by_the_catalogue() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["step.toml", "motor_step.toml"] {
        let run = simulated(&folder.path().join(name), &scenario(name));
        let stored = fs::read_to_string(run.join("verdict.json")).unwrap();
        fs::remove_file(run.join("frames.dbc")).unwrap();
        let (code, stdout, stderr) = tool(&["replay", "--json", text(&run)]);
        assert_eq!((code, stdout), (Some(0), stored), "{stderr}");
    }
    let run = run_of_an_unknown_plant(&folder.path().join("strange"));
    fs::remove_file(run.join("frames.dbc")).unwrap();
    let (code, _, stderr) = tool(&["replay", text(&run)]);
    assert_eq!(code, Some(3));
    assert!(stderr.contains(UNKNOWN_PLANT), "{stderr}");
}

#[test]
fn broken_frames_are_refused_by_file_and_place() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(
        &folder.path().join("runs"),
        &short_scenario(folder.path(), 1.0),
    );
    let frames = run.join("frames.dbc");
    let good = fs::read_to_string(&frames).unwrap();
    let position = " SG_ position_millimetres : 16|32@1-";
    assert!(good.contains(position));
    let cut = &good[..good.find(position).unwrap() + position.len()];
    let place = format!(" --> {}:", cut.lines().count());
    let overlap = good.replace(position, " SG_ position_millimetres : 15|32@1-");
    let absent = good.replace(" position_millimetres ", " whereabouts ");
    let double = good.replace(" current_amperes ", " target_current_amperes ");
    let long = "x".repeat(2 << 20);
    for (content, reason) in [
        (cut, place.as_str()),
        (&overlap, "message drive_tpdo1: signals"),
        (&absent, "no signal drive_tpdo1.position_millimetres"),
        (&double, "are called `target_current_amperes`"),
        (&long, "longer than 1048576 bytes"),
        (&long[..900_000], "1:1"),
        ("", "the DBC has no signal"),
    ] {
        fs::write(&frames, content).unwrap();
        for command in ["replay", "report", "identify"] {
            let (code, _, stderr) = tool(&[command, text(&run)]);
            assert_eq!(code, Some(3), "{stderr}");
            assert!(stderr.contains(reason), "{reason} is not in {stderr}");
            assert!(stderr.len() < 2000, "{} bytes", stderr.len());
            let names_it = stderr.contains("frames.dbc") || stderr.contains("the DBC has");
            assert!(names_it, "{stderr}");
        }
    }
}

#[test]
fn a_recording_is_held_against_other_limits() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(&folder.path().join("runs"), &scenario("step.toml"));
    let strict = folder.path().join("strict.toml");
    let played = fs::read_to_string(scenario("step.toml")).unwrap();
    let (rest, _) = played.split_once("[expect]").unwrap();
    let limits = "[expect]\nsettling_time_seconds = { max = 0.01 }\n";
    fs::write(&strict, format!("{rest}{limits}")).unwrap();
    let (code, stdout, _) = tool(&["replay", text(&run), "--scenario", text(&strict)]);
    assert_eq!(code, Some(1), "{stdout}");
    assert!(
        stdout.contains("≤ 0.01") && stdout.contains("FAIL"),
        "{stdout}"
    );
    assert!(
        !stdout.contains("≤ 5"),
        "the run's own limits still count: {stdout}"
    );
}

/// Limits apply to the loops of the recording, each by its name.
#[test]
fn a_recording_of_several_loops_is_held_against_the_limits_of_each() {
    let folder = tempfile::tempdir().unwrap();
    let played = scenario("two_axes_circle.toml");
    let run = simulated(&folder.path().join("runs"), &played);
    let strict = folder.path().join("strict.toml");
    let source = fs::read_to_string(&played).unwrap();
    let (rest, _) = source.split_once("[expect").unwrap();
    let limits = "[expect.y]\ntracking_error_millimetres_rms = { max = 0.0001 }\n";
    fs::write(&strict, format!("{rest}{limits}")).unwrap();
    let held = |limits: &Path| tool(&["replay", text(&run), "--scenario", text(limits)]);
    let (code, stdout, stderr) = held(&strict);
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    assert!(stdout.contains("≤ 0.0001"), "{stdout}");
    let failed: Vec<_> = stdout.lines().filter(|row| row.contains("FAIL ")).collect();
    assert_eq!(failed.len(), 1, "{stdout}");
    assert!(
        failed[0].contains("y.tracking_error_millimetres_rms"),
        "{stdout}"
    );
    let (code, stdout, stderr) = held(&scenario("step.toml"));
    assert_eq!(code, Some(3), "{stdout}");
    assert!(
        stderr.contains("step.toml` has other loops than the recording"),
        "{stderr}"
    );
}

/// A log as other recorders write it: with another interface, times of a clock, and further frames on the bus.
#[test]
fn a_foreign_log_needs_its_scenario_only() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(&folder.path().join("runs"), &scenario("step.toml"));
    let foreign = folder.path().join("foreign.log");
    let log = fs::read_to_string(run.join("bus.log"))
        .unwrap()
        .replace("(00000", "(17000")
        .replace(") can0 ", ") slcan1 ");
    let other =
        "(1700000000.000001) slcan1 18FEF100#0102030405060708\n(1700000000.000002) slcan1 7DF#R\n";
    fs::write(&foreign, format!("{other}{log}")).unwrap();
    let (code, _, stderr) = tool(&["replay", text(&foreign)]);
    assert_eq!(code, Some(3));
    assert!(stderr.contains("--scenario"), "{stderr}");
    let played = scenario("step.toml");
    let (code, stdout, stderr) = tool(&[
        "replay",
        "--json",
        text(&foreign),
        "--scenario",
        text(&played),
    ]);
    assert_eq!(code, Some(0), "{stderr}");
    // A log does not contain the program that recorded it.
    let json = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap();
    let mut stored = json(&fs::read_to_string(run.join("verdict.json")).unwrap());
    stored.as_object_mut().unwrap().remove("identity").unwrap();
    assert_eq!(json(&stdout), stored);
}

/// The remains of a killed run or a full disk.
#[test]
fn a_cut_recording_is_judged_up_to_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), &scenario("step.toml"));
    let log = fs::read(run.join("bus.log")).unwrap();
    let cut = log
        .iter()
        .skip(1_000_000)
        .position(|byte| *byte == b'#')
        .unwrap()
        + 1_000_003;
    fs::write(run.join("bus.log"), &log[..cut]).unwrap();
    fs::remove_file(run.join("verdict.json")).unwrap();
    let (code, stdout, stderr) = tool(&["replay", text(&run)]);
    assert_eq!(code, Some(4), "{stdout}{stderr}");
    assert!(stdout.contains("incomplete"), "{stdout}");
    assert!(stderr.contains("cut before its end"), "{stderr}");
    assert_eq!(tool(&["report", text(&run)]).0, Some(0));
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("incomplete") && page.contains("Hysteresis"));
}

/// Every 20th position is removed from a recording in virtual time: only the drive can have left it out.
#[test]
fn a_drive_that_leaves_positions_out_fails() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), &scenario("step.toml"));
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let mut positions = 0;
    let kept: String = log
        .lines()
        .filter(|line| {
            positions += usize::from(line.contains(" 190#"));
            !(line.contains(" 190#") && positions % 20 == 0)
        })
        .flat_map(|line| [line, "\n"])
        .collect();
    fs::write(run.join("bus.log"), kept).unwrap();
    let (code, stdout, stderr) = tool(&["replay", text(&run)]);
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    assert!(stdout.contains("FAIL: drive: no position in "), "{stdout}");
    assert!(!stdout.contains("busy"), "{stdout}");
}

/// A disk has lost a line: its content is unknown, so the recording does not pass.
#[test]
fn an_unreadable_line_is_named_and_its_recording_does_not_pass() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), &scenario("step.toml"));
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let lines: Vec<&str> = log.lines().collect();
    let with_unreadable = |number: usize| {
        let mut lines = lines.clone();
        lines[number - 1] = "(00000000x1.234567) can0 190#01";
        fs::write(run.join("bus.log"), lines.join("\n") + "\n").unwrap();
        tool(&["replay", text(&run)])
    };
    let (code, stdout, stderr) = with_unreadable(5000);
    assert_eq!(code, Some(5), "{stdout}{stderr}");
    let reason = "a line of the log is no frame, line 5000: not a line of candump -L";
    assert!(
        stdout.contains(reason) && stderr.contains(reason),
        "{stdout}{stderr}"
    );
    // The stop of the nodes after the scenario's end is not judged.
    let (code, stdout, stderr) = with_unreadable(lines.len() - 1);
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let reason = format!("line {}: not a line", lines.len() - 1);
    assert!(stderr.contains(&reason), "{stderr}");
}

#[test]
fn remote_frames_error_messages_and_fd_frames_leave_a_log_readable() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(&folder.path().join("runs"), &scenario("step.toml"));
    let path = folder.path().join("foreign.log");
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let (first, rest) = log.split_once('\n').unwrap();
    let time = first.split_once(' ').unwrap().0;
    let added = ["7DF#R8", "20000004#R8", "123##1AABB"]
        .map(|frame| format!("{time} can0 {frame}\n"))
        .concat();
    fs::write(&path, format!("{first}\n{added}{rest}")).unwrap();
    let played = scenario("step.toml");
    let arguments = ["replay", text(&path), "--scenario", text(&played)];
    let (code, stdout, stderr) = tool(&arguments);
    assert_eq!((code, stderr.as_str()), (Some(0), ""), "{stdout}");
    assert!(stdout.contains("1 CAN FD frame"), "{stdout}");
}

#[test]
fn a_file_that_is_no_log_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("readme.log");
    fs::write(&path, "This is\nno log.\n").unwrap();
    let played = scenario("step.toml");
    let (code, _, stderr) = tool(&["replay", text(&path), "--scenario", text(&played)]);
    assert_eq!(code, Some(3));
    assert!(stderr.contains("line 1"), "{stderr}");
}

#[test]
fn two_runs_of_one_scenario_agree_and_of_two_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stronger.toml");
    let source = fs::read_to_string(scenario("step.toml")).unwrap();
    // The plant is not that of the other run: its load is heavier.
    fs::write(
        &path,
        source.replace(
            "[expect]",
            "[plant.wire.mechanics]\nload_kilograms = 0.05\n\n[expect]",
        ),
    )
    .unwrap();
    let runs = |name: &str, path: &Path| {
        let runs = folder.path().join(name);
        let _ = output(canrig(&runs, "simulate").arg(path));
        only_run(&runs)
    };
    let (a, b, other) = (
        runs("a", &scenario("step.toml")),
        runs("b", &scenario("step.toml")),
        runs("c", &path),
    );
    let (code, stdout, _) = tool(&["compare", text(&a), text(&b)]);
    assert_eq!(code, Some(0), "{stdout}");
    assert!(stdout.contains("agree in all 11999 cycles"), "{stdout}");
    let page = folder.path().join("compared.html");
    let (code, stdout, stderr) =
        tool(&["compare", text(&a), text(&other), "--output", text(&page)]);
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    assert!(stdout.contains("The runs diverge, first in"), "{stdout}");
    assert!(
        fs::read_to_string(page)
            .unwrap()
            .contains("class=\"apart\"")
    );
    let (_, there, _) = tool(&["compare", "--json", text(&a), text(&other)]);
    let (_, back, _) = tool(&["compare", "--json", text(&other), text(&a)]);
    let largest = |json: &str| {
        let value: serde_json::Value = serde_json::from_str(json).unwrap();
        value["signals"][0]["largest"].clone()
    };
    assert_eq!(largest(&there), largest(&back), "not the same both ways");
}

#[test]
fn what_one_of_two_laws_does_not_compute_is_not_compared() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    let sliding_mode = simulated(&folder.path().join("sliding_mode"), &path);
    let source = fs::read_to_string(&path).unwrap();
    let other = source.replace("[controller.sliding_mode]", "[controller.pid]");
    assert_ne!(source, other);
    fs::write(&path, other).unwrap();
    let pid = simulated(&folder.path().join("pid"), &path);
    let (_, stdout, stderr) = tool(&["compare", "--json", text(&sliding_mode), text(&pid)]);
    let compared: serde_json::Value = serde_json::from_str(&stdout).expect(&stderr);
    let is_compared = |name: &str| {
        let mut signals = compared["signals"].as_array().unwrap().iter();
        signals.any(|one| one["name"] == name && one["largest"].is_number())
    };
    assert!(!is_compared("estimated_temperature_celsius"));
    assert!(is_compared("wire_temperature_celsius"));
}

#[test]
fn a_tolerance_for_nothing_is_wrong_usage() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(
        &folder.path().join("runs"),
        &short_scenario(folder.path(), 1.0),
    );
    let (code, _, stderr) = tool(&[
        "compare",
        text(&run),
        text(&run),
        "--tolerance",
        "possition=1",
    ]);
    assert_eq!(code, Some(2));
    assert!(stderr.contains("possition"), "{stderr}");
}

#[test]
fn the_exported_table_is_that_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(
        &folder.path().join("runs"),
        &short_scenario(folder.path(), 1.0),
    );
    let (code, stdout, _) = tool(&["export", text(&run), "--format", "csv"]);
    assert_eq!(code, Some(0));
    assert_eq!(stdout, fs::read_to_string(run.join("signals.csv")).unwrap());
}

#[test]
fn completions_and_manual_know_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let (code, stdout, _) = tool(&["completions", shell]);
        assert_eq!(code, Some(0));
        assert!(
            stdout.contains("simulate") && stdout.contains("compare"),
            "{shell}"
        );
    }
    let to = ["--to", text(folder.path())];
    assert_eq!(tool(&[&["man"], &to[..]].concat()).0, Some(0));
    assert_eq!(
        tool(&[&["completions", "fish"], &to[..]].concat()).0,
        Some(0)
    );
    for page in [
        "canrig.1",
        "canrig-compare.1",
        "canrig-run.1",
        "canrig.fish",
    ] {
        assert!(folder.path().join(page).exists(), "{page} is missing");
    }
}

#[test]
fn a_run_in_real_time_gives_its_verdict_again_with_its_timing() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let runs = folder.path().join("runs");
        let short = unhurried_scenario(folder.path(), 2.0);
        let (of_run, ..) = output(canrig(&runs, "run").args(["--bus", "embedded"]).arg(short));
        let run = only_run(&runs);
        let stored = fs::read_to_string(run.join("verdict.json")).unwrap();
        assert!(stored.contains("wake_up_lateness"), "{stored}");
        let (code, stdout, stderr) = tool(&["replay", "--json", text(&run)]);
        assert_eq!((code, stdout), (of_run, stored), "{stderr}");
        let page = fs::read_to_string(run.join("report.html")).unwrap();
        assert!(page.contains("wake-up lateness, controller"));
    });
}

/// The verdict is that of the files in the folder, which are not those that were played.
#[test]
fn a_replay_names_files_that_were_changed_since_the_play() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    output(canrig(&runs, "simulate").arg(short_scenario(folder.path(), 0.5)));
    let run = only_run(&runs);
    let replay = || {
        let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
        output(replay.arg("replay").arg(&run))
    };
    let (code, stdout, stderr) = replay();
    assert_eq!((code, stderr.as_str()), (Some(0), ""), "{stdout}");
    let path = run.join("scenario.toml");
    let text = fs::read_to_string(&path).unwrap();
    let limit = "[expect]\nposition_millimetres_max = { max = 1.0 }\n";
    fs::write(&path, format!("{text}{limit}")).unwrap();
    let (code, stdout, stderr) = replay();
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    assert!(
        stderr.contains("scenario.toml` has another SHA-256 than the file that was played"),
        "{stderr}"
    );
}

/// The outcome is open, since the line may have been any frame, and no device is blamed for what is
/// behind it.
#[test]
fn a_line_of_a_log_whose_time_jumps_ahead_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    output(canrig(&runs, "simulate").arg(short_scenario(folder.path(), 1.0)));
    let run = only_run(&runs);
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let mut lines = Vec::from_iter(log.lines().map(str::to_owned));
    let middle = lines.len() / 2;
    let (seconds, _) = lines[middle][1..].split_once('.').unwrap();
    let ahead = seconds.parse::<u64>().unwrap() + 7;
    lines.insert(middle, format!("({ahead:010}.000000) can0 123#00"));
    fs::write(run.join("bus.log"), lines.join("\n") + "\n").unwrap();
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, stdout, stderr) = output(replay.arg("replay").arg(&run));
    assert_eq!(code, Some(5), "{stdout}{stderr}");
    let line = format!("line {}: it is later than a frame below", middle + 1);
    assert!(stderr.contains(&line), "{stderr}");
}
