//! Exit codes and messages of the command line.

use std::fs;
use std::process::Command;

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

/// `script` of util-linux runs a command on a terminal.
#[test]
fn a_terminal_gets_colours_and_no_escape_sequence_is_text() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    let on_terminal = |arguments: &str| {
        let command = format!("{} {arguments}", env!("CARGO_BIN_EXE_canrig"));
        let mut script = Command::new("script");
        script.args(["-qec", &command, "/dev/null"]);
        script.env_remove("NO_COLOR").env("TERM", "xterm-256color");
        output(script.current_dir(folder.path())).1
    };
    let limit = "expect.position_millimetres_max.max=";
    let shown = [
        format!("simulate {} --set {limit}1", path.display()),
        format!("check {} --set duration_second=1", path.display()),
    ];
    for arguments in shown {
        let text = on_terminal(&arguments);
        assert!(text.contains("\u{1b}["), "{text}");
        assert!(!text.contains("\\u001b"), "{text}");
    }
}

/// A program finds the message and the path whole, however long they are.
#[test]
fn an_error_for_a_program_is_not_wrapped() {
    let folder = tempfile::tempdir().unwrap();
    let check = || {
        let mut check = Command::new(env!("CARGO_BIN_EXE_canrig"));
        check.arg("check");
        check
    };
    let deep = folder
        .path()
        .join("a folder with a long-winded name/".repeat(6));
    fs::create_dir_all(&deep).unwrap();
    let path = short_scenario(&deep, 1.0);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("duration_seconds", "duration_second")).unwrap();
    let (code, _, stderr) = output(check().arg(&path));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(stderr.contains(path.to_str().unwrap()), "{stderr}");
    let none = deep.join("none.toml");
    let (code, _, stderr) = output(check().arg(&none));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(stderr.contains(none.to_str().unwrap()), "{stderr}");
}

#[test]
fn the_current_of_a_recording_plays_again_to_the_same_motion() {
    let folder = tempfile::tempdir().unwrap();
    let positions = |run: &std::path::Path| {
        let text = fs::read_to_string(run.join("signals.csv")).unwrap();
        let mut lines = text.lines();
        let header = lines.next().unwrap().split(',');
        let place = header
            .take_while(|name| *name != "position_millimetres")
            .count();
        let cells = lines.map(|line| line.split(',').nth(place).unwrap().to_owned());
        cells.collect::<Vec<_>>()
    };
    let closed = folder.path().join("closed");
    output(canrig(&closed, "simulate").arg(scenario("step.toml")));
    let closed = only_run(&closed);
    fs::copy(
        closed.join("signals.csv"),
        folder.path().join("recorded.csv"),
    )
    .unwrap();
    let again = folder.path().join("again.toml");
    fs::write(
        &again,
        "schema = 1\nrig = \"sma_actuator\"\nname = \"again\"\nduration_seconds = 12.0\n[[controller.open_loop.table]]\nfrom_seconds = 0.0\n\
         file = \"recorded.csv\"\ncolumn = \"target_current_amperes\"\n",
    )
    .unwrap();
    let open = folder.path().join("open");
    let (code, stdout, stderr) = output(canrig(&open, "simulate").arg(&again));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let (closed, open) = (positions(&closed), positions(&only_run(&open)));
    assert!(closed.iter().any(|position| position.starts_with("35.")));
    assert_eq!(closed, open);
    // The run in several processes reads the tables of the run folder.
    let bus = folder.path().join("bus");
    let arguments = ["--clock", "lockstep"];
    let (code, stdout, stderr) = output(canrig(&bus, "run").arg(&again).args(arguments));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert_eq!(positions(&only_run(&bus)), open);
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
}

#[test]
fn a_folder_without_scenarios_ends_in_3() {
    let folder = tempfile::tempdir().unwrap();
    for command in ["run", "simulate", "check"] {
        let (code, _, stderr) = output(
            Command::new(env!("CARGO_BIN_EXE_canrig"))
                .arg(command)
                .arg(folder.path()),
        );
        assert_eq!(code, Some(3), "{command}: {stderr}");
        assert!(stderr.contains("holds no scenario"), "{stderr}");
    }
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

/// Limits on real time need idle machines, so they are not in the scenarios that CI plays everywhere.
#[test]
fn limits_on_time_are_kept_apart() {
    let has_timing = |path: &std::path::Path| {
        let scenario: toml::Table = fs::read_to_string(path).unwrap().parse().unwrap();
        let has_timing_table = |table: &toml::Value| table.get("timing").is_some();
        let expect = scenario.get("expect").and_then(toml::Value::as_table);
        expect.is_some_and(|expect| {
            expect.contains_key("timing") || expect.values().any(has_timing_table)
        })
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

/// Every machine that runs the tests has the requirements of the README's commands, but usually not the optional ones.
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

#[test]
fn a_scenario_that_ships_is_found_by_its_name_from_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let play = |name: &str| {
        let mut command = canrig(&folder.path().join("runs"), "simulate");
        output(command.arg(name).arg("--quiet").current_dir(folder.path()))
    };
    let (code, _, stderr) = play("motor_step");
    assert_eq!(code, Some(0), "{stderr}");
    let played = only_run(&folder.path().join("runs")).join("scenario.toml");
    let shipped = fs::read_to_string(scenario("motor_step.toml")).unwrap();
    assert_eq!(fs::read_to_string(played).unwrap(), shipped);
    let (code, _, stderr) = play("motor_stepp");
    assert_eq!(code, Some(3));
    assert!(stderr.contains("did you mean `motor_step`?"), "{stderr}");
    // A file of this name has priority.
    fs::write(folder.path().join("step"), "schema = 7\n").unwrap();
    let (code, _, stderr) = play("step");
    assert_eq!(code, Some(3));
    assert!(stderr.contains("schema"), "{stderr}");
}

#[test]
fn a_rig_that_ships_is_found_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut check = Command::new(env!("CARGO_BIN_EXE_canrig"));
    check.args(["check", "rigs/rig"]).current_dir(folder.path());
    let (code, stdout, _) = output(&mut check);
    assert_eq!(code, Some(0));
    assert!(
        stdout.starts_with("rigs/rig: valid (rig: actuator on can0)\n"),
        "{stdout}"
    );
    // A real drive keeps its own time: the rig is read first, and then the clock is refused.
    let play = |rig| {
        let mut run = canrig(&folder.path().join("runs"), "run");
        run.args(["step", "--clock", "lockstep", "--rig", rig])
            .current_dir(folder.path());
        output(&mut run)
    };
    let (code, stdout, stderr) = play("rigs/rig");
    assert_eq!(code, Some(3));
    assert!(
        format!("{stdout}{stderr}").contains("keeps its own time"),
        "{stdout}{stderr}"
    );
    let (code, _, stderr) = play("rigs/another");
    assert_eq!(code, Some(3));
    assert!(stderr.contains("rigs/another"), "{stderr}");
}

#[test]
fn what_ships_is_copied_as_it_is_in_the_repository() {
    let folder = tempfile::tempdir().unwrap();
    let copy = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_canrig"));
        output(
            command
                .args(["examples", "--to"])
                .arg(folder.path().join("a b")),
        )
    };
    assert_eq!(copy().0, Some(0));
    for name in [
        "step.toml",
        "faults/bus_errors.toml",
        "schema.json",
        "rig_schema.json",
        "requirements.csv",
    ] {
        let copied = fs::read_to_string(folder.path().join("a b").join(name)).unwrap();
        assert_eq!(
            copied,
            fs::read_to_string(scenario(name)).unwrap(),
            "{name}"
        );
    }
    let rig = fs::read_to_string(folder.path().join("a b/rigs/rig.toml")).unwrap();
    assert!(rig.starts_with("#:schema ../rig_schema.json\n"), "{rig}");
    let (code, _, stderr) = copy();
    assert_eq!(code, Some(4));
    assert!(stderr.contains("nothing is overwritten"), "{stderr}");
}

#[test]
fn a_value_of_the_command_line_is_played_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = short_scenario(folder.path(), 0.2);
    let runs = folder.path().join("runs");
    let play = |value: &str| {
        let mut command = canrig(&runs, "simulate");
        output(command.arg(&scenario).args(["--json", "--set", value]))
    };
    let (code, stdout, stderr) = play("reference.hold[0].position_millimetres=12");
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let signals = fs::read_to_string(only_run(&runs).join("signals.csv")).unwrap();
    assert!(
        signals
            .lines()
            .skip(1)
            .all(|row| row.split(',').nth(2) == Some("12"))
    );
    for (value, said) in [
        (
            "reference.hold[1].position_millimetres=12",
            "there is no hold 1",
        ),
        ("duration_second=1", "duration_seconds"),
        ("duration_seconds=-1", "out of range"),
    ] {
        let (code, _, stderr) = play(value);
        assert_eq!(code, Some(3), "{value}");
        assert!(stderr.contains(said), "{value}: {stderr}");
    }
    assert_eq!(play("duration_seconds").0, Some(2));
}

#[test]
fn events_are_lines_of_json_that_end_with_the_run_folder() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = short_scenario(folder.path(), 0.2);
    let runs = folder.path().join("runs");
    let (code, stdout, _) = output(canrig(&runs, "simulate").arg(&scenario).arg("--events"));
    assert_eq!(code, Some(0));
    let events: Vec<serde_json::Value> = stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let kinds: Vec<&str> = events
        .iter()
        .map(|event| event["event"].as_str().unwrap())
        .collect();
    assert_eq!(kinds.first(), Some(&"note"));
    assert_eq!(kinds[kinds.len() - 2..], ["judged", "ended"]);
    let judged = &events[events.len() - 2];
    assert_eq!(
        judged["folder"].as_str().unwrap(),
        only_run(&runs).to_str().unwrap()
    );
    assert_eq!(judged["exit"], 0);
}
