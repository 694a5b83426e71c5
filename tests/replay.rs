//! Recordings after the run: judged again, compared, handed on.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::real_time::in_real_time;
use crate::support::{canrig, only_run, output, scenario, short_scenario, unhurried_scenario};

/// The program with a command that makes no runs.
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

/// As other recorders write logs: another interface, times of a clock, whatever else is on the bus.
#[test]
fn a_foreign_log_needs_its_scenario_only() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(&folder.path().join("runs"), &scenario("step.toml"));
    let foreign = folder.path().join("foreign.log");
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let log = log
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
    assert_eq!(
        stdout,
        fs::read_to_string(run.join("verdict.json")).unwrap()
    );
}

/// What a killed run or a full disk leaves.
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
    let text_of = fs::read_to_string(scenario("step.toml")).unwrap();
    // A plant that is not the one of the other run: the load is heavier.
    fs::write(
        &path,
        text_of.replace(
            "[expect]",
            "[plant.mechanics]\nload_kilograms = 0.05\n\n[expect]",
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
    assert!(stdout.contains("DIVERGE, first in"), "{stdout}");
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
    assert_eq!(tool(&["man", text(folder.path())]).0, Some(0));
    for page in ["canrig.1", "canrig-compare.1", "canrig-run.1"] {
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
