//! Exit codes and messages as a user meets them.

use std::fs;

use crate::support::{canrig, only_run, output, root, scenario, short_scenario};

#[test]
fn a_broken_scenario_is_underlined_and_ends_in_3() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.toml");
    let text = fs::read_to_string(scenario("step.toml"))
        .unwrap()
        .replace("duration_seconds", "duration_second");
    fs::write(&path, text).unwrap();
    let (code, _, stderr) = output(canrig(&folder.path().join("runs"), "run").arg(&path));
    assert_eq!(code, Some(3));
    assert!(
        stderr.contains("duration_seconds"),
        "no suggestion: {stderr}"
    );
    assert!(stderr.contains("broken.toml:"), "no place: {stderr}");
}

#[test]
fn a_missed_limit_ends_in_1_and_says_by_how_much() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("strict.toml");
    let text = fs::read_to_string(short_scenario(folder.path(), 2.0)).unwrap();
    fs::write(
        &path,
        text + "\n[expect]\ncurrent_amperes_rms = { max = 0.001 }\n",
    )
    .unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, _) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(1), "{stdout}");
    assert!(
        stdout.contains("≤ 0.001") && stdout.contains("FAIL"),
        "{stdout}"
    );
    let junit = fs::read_to_string(only_run(&runs).join("junit.xml")).unwrap();
    assert!(junit.contains("failures=\"1\""), "{junit}");
}

#[test]
fn wrong_usage_ends_in_2() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        vec!["--clock", "sundial", "x.toml"],
        vec![],
        vec!["--bus", "a/b", "x.toml"],
    ] {
        let (code, ..) = output(canrig(folder.path(), "run").args(arguments));
        assert_eq!(code, Some(2));
    }
    let (code, _, stderr) = output(canrig(folder.path(), "run").arg(folder.path()));
    assert_eq!(code, Some(2));
    assert!(stderr.contains("holds no scenario"), "{stderr}");
}

#[test]
fn a_missing_interface_ends_in_4_and_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--bus", "nocan7", "--clock", "lockstep"];
    let (code, _, stderr) = output(
        canrig(folder.path(), "run")
            .args(arguments)
            .arg(scenario("step.toml")),
    );
    assert_eq!(code, Some(4), "{stderr}");
    let says_what_to_do = stderr.contains("ip link add dev nocan7") || stderr.contains("modprobe");
    assert!(says_what_to_do, "{stderr}");
}

#[test]
fn require_vcan_never_falls_back() {
    let folder = tempfile::tempdir().unwrap();
    let (code, _, stderr) = output(
        canrig(folder.path(), "run")
            .args(["--bus", "embedded", "--require-vcan"])
            .arg(scenario("step.toml")),
    );
    assert_eq!(code, Some(4), "{stderr}");
    assert!(stderr.contains("--require-vcan"), "{stderr}");
    assert!(
        fs::read_dir(folder.path()).unwrap().next().is_none(),
        "a run was made all the same"
    );
}

#[test]
fn all_shipped_scenarios_are_valid() {
    let mut canrig = std::process::Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, stdout, stderr) = output(canrig.arg("check").arg(root().join("scenarios")));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stdout.lines().count() >= 8, "{stdout}");
}

/// Limits on real time are for idle machines; they stay out of what CI plays everywhere.
#[test]
fn limits_on_time_are_kept_apart() {
    let has_timing = |path: &std::path::Path| {
        let scenario = scenario::Scenario::load(path).unwrap();
        !scenario.expect.timing.is_empty()
    };
    let scenarios_in = |folder: std::path::PathBuf| {
        let paths = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path());
        let is_toml = |path: &std::path::PathBuf| path.extension().is_some_and(|end| end == "toml");
        paths.filter(is_toml).collect::<Vec<_>>()
    };
    let [apart, others] = ["realtime", "."].map(|name| scenarios_in(scenario(name)));
    assert!(!apart.is_empty() && others.len() >= 8);
    assert!(apart.iter().all(|path| has_timing(path)));
    assert!(!others.iter().any(|path| has_timing(path)));
}

/// Whoever runs the tests has what the README's commands need, and seldom the rest.
#[test]
fn the_doctor_passes_where_only_what_is_optional_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let doctor = || {
        let mut canrig = std::process::Command::new(env!("CARGO_BIN_EXE_canrig"));
        canrig.arg("doctor").current_dir(folder.path());
        canrig
    };
    let (code, stdout, stderr) = output(&mut doctor());
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    for what in [
        "Rust toolchain",
        "C compiler",
        "embedded bus",
        "run folders",
        "kernel CAN",
        "private bus",
        "real-time priority",
        "locked memory",
        "clock source",
        "CPU governor",
        "CPU isolation",
        "viewer",
    ] {
        assert!(stdout.contains(what), "{what} is missing:\n{stdout}");
    }
    let missing = stdout.lines().filter(|line| line.starts_with("  no "));
    assert_eq!(stdout.matches("fix: ").count(), missing.count(), "{stdout}");
    let optional = stdout.matches("\noptional, ").count();
    assert_eq!((optional, stdout.starts_with("needed, ")), (3, true));

    let (code, stdout, _) = output(doctor().env("PATH", folder.path()));
    assert_eq!(code, Some(4), "{stdout}");
    assert!(stdout.contains("  MISSING  Rust toolchain"), "{stdout}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_second_run_overwrites_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    let runs = folder.path().join("runs");
    for _ in 0..2 {
        assert_eq!(output(canrig(&runs, "simulate").arg(&path)).0, Some(0));
    }
    assert_eq!(fs::read_dir(&runs).unwrap().count(), 2);
}
