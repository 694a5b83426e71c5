//! The matrix of requirements: the play of a scenario that counts, and the results of a sweep and torture.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{canrig, only_run, output};

/// Runs `canrig coverage`; returns exit code and output.
fn coverage(arguments: &[&str], folders: &[&Path]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.arg("coverage").args(arguments).args(folders);
    output(canrig.env("NO_COLOR", "1"))
}

/// Writes a short scenario that tests REQ-1 by a limit on its current; 0.0 A makes it fail.
fn scenario_file(folder: &Path, current_amperes_max: f64) -> PathBuf {
    let path = folder.join("hold.toml");
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"hold\"\nduration_seconds = 0.2\n[controller.sliding_mode]\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
         [expect]\ncurrent_amperes_rms = {{ max = {current_amperes_max:.1} }}\n\
         [expect.requirements]\ncurrent_amperes_rms = [\"REQ-1\"]\n"
    );
    fs::write(&path, text).unwrap();
    path
}

/// Plays a scenario; returns the new folder below `runs`.
fn played(runs: &Path, command: &str, arguments: &[&str], scenario: &Path) -> PathBuf {
    let before = if runs.exists() {
        crate::support::runs(runs)
    } else {
        Vec::new()
    };
    output(canrig(runs, command).args(arguments).arg(scenario));
    let after = crate::support::runs(runs).into_iter();
    let mut new = after.filter(|path| !before.contains(path));
    new.next().unwrap()
}

/// Returns the line of a test in the table.
fn row<'a>(stdout: &'a str, test: &str) -> &'a str {
    let mut lines = stdout.lines();
    let line = lines.find(|line| line.contains(test));
    line.unwrap_or_else(|| panic!("{test}: {stdout}"))
}

#[test]
fn the_latest_play_of_a_scenario_counts_and_is_shown_with_its_date_and_program() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let play = |max| {
        let scenario = scenario_file(folder.path(), max);
        played(&runs, "simulate", &[], &scenario)
    };
    let missed = play(0.0);
    let (code, stdout, _) = coverage(&[], &[&missed]);
    assert_eq!(code, Some(1), "{stdout}");
    let met = play(5.0);
    let page = folder.path().join("page.html");
    let with_page = ["--output", page.to_str().unwrap()];
    let (code, stdout, stderr) = coverage(&with_page, &[&met, &missed]);
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let record = fs::read_to_string(met.join("played.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    let at = record["at"].as_str().unwrap();
    let at = format!("{} {} UTC", &at[..10], &at[11..16]);
    let version = format!("canrig {}", env!("CARGO_PKG_VERSION"));
    let page = fs::read_to_string(page).unwrap();
    for said in [at.as_str(), &version, "(the latest of 2)"] {
        assert!(
            stdout.contains(said) && page.contains(said),
            "{said}: {stdout}"
        );
    }
    let (_, stdout, _) = coverage(&["--json"], &[&missed, &met]);
    let matrix: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let test = &matrix[0]["tests"][0];
    assert_eq!(test["run"].as_str(), met.to_str(), "{stdout}");
    assert_eq!(test["played_at"], record["at"], "{stdout}");
    assert_eq!(test["plays"], 2, "{stdout}");
    assert_eq!(test["version"], env!("CARGO_PKG_VERSION"), "{stdout}");

    // The dates and the result survive a copy.
    let copy = folder.path().join("copy");
    let copied = Command::new("cp")
        .arg("-r")
        .arg(&missed)
        .arg(&copy)
        .status();
    assert!(copied.unwrap().success());
    assert_eq!(coverage(&[], &[&met, &copy]).0, Some(0));
    let again = play(0.0);
    assert_eq!(coverage(&[], &[&again, &met]).0, Some(1));
    // Without dates, the worst play counts.
    for run in [&met, &missed] {
        fs::remove_file(run.join("played.json")).unwrap();
    }
    let (code, stdout, _) = coverage(&[], &[&missed, &met]);
    assert_eq!(code, Some(1), "{stdout}");
    assert!(stdout.contains("no date"), "{stdout}");
    assert_eq!(coverage(&[], &[&met, &copy]).0, Some(1));
}

#[test]
fn a_play_with_another_value_of_the_command_line_is_another_test() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let scenario = scenario_file(folder.path(), 5.0);
    let set = ["--set", "expect.current_amperes_rms.max=0.0"];
    let missed = played(&runs, "simulate", &set, &scenario);
    let met = played(&runs, "simulate", &[], &scenario);
    let (code, stdout, _) = coverage(&["--json"], &[&missed, &met]);
    assert_eq!(code, Some(1), "{stdout}");
    let matrix: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let tests = matrix[0]["tests"]
        .as_array()
        .unwrap()
        .iter()
        .map(|test| (test["scenario"].as_str().unwrap(), &test["outcome"]));
    let other = "hold (--set expect.current_amperes_rms.max=0.0)";
    let [pass, fail] = ["pass", "fail"].map(serde_json::Value::from);
    assert_eq!(Vec::from_iter(tests), [(other, &fail), ("hold", &pass)]);
}

#[test]
fn a_sweep_counts_by_its_worst_run_and_one_that_lacks_runs_is_incomplete() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let scenario = scenario_file(folder.path(), 5.0);
    let text = fs::read_to_string(&scenario).unwrap();
    let swept = folder.path().join("swept.toml");
    let axis = |values: &str| {
        let axis = format!(
            "[sweep]\n[[sweep.list]]\nkey = \"expect.current_amperes_rms.max\"\nvalues = {values}\n"
        );
        fs::write(&swept, format!("{text}{axis}")).unwrap();
    };
    axis("[5.0, 4.0, 0.0, 0.1]");
    let sweep = played(&runs, "sweep", &[], &swept);
    let page = folder.path().join("page.html");
    let with_page = ["--output", page.to_str().unwrap()];
    let run = played(&runs, "simulate", &[], &scenario);
    let (code, stdout, stderr) = coverage(&with_page, &[&sweep, &run]);
    assert_eq!((code, stderr.as_str()), (Some(1), ""), "{stdout}");
    assert!(row(&stdout, "hold (sweep)").contains("FAIL"), "{stdout}");
    assert!(stdout.contains("(the worst of 4 runs: case 3)"), "{stdout}");
    let page = fs::read_to_string(page).unwrap();
    let link = sweep
        .strip_prefix(folder.path())
        .unwrap()
        .join("report.html")
        .display()
        .to_string();
    assert!(page.contains(&link), "{page}");

    axis("[5.0, 4.0]");
    let later = played(&runs, "sweep", &[], &swept);
    let (code, stdout, _) = coverage(&[], &[&later, &sweep]);
    assert_eq!(code, Some(0), "{stdout}");
    assert!(stdout.contains("(all 2 runs)"), "{stdout}");
    let rows = fs::read_to_string(later.join("rows.jsonl")).unwrap();
    fs::write(later.join("rows.jsonl"), &rows[..rows.len() - 9]).unwrap();
    let (code, stdout, _) = coverage(&[], &[&later, &sweep]);
    assert_eq!(code, Some(1), "{stdout}");
    assert!(
        row(&stdout, "hold (sweep)").contains("incomplete"),
        "{stdout}"
    );
    // A part does not replace the whole; the merged result of all parts is the latest.
    let parts = folder.path().join("parts");
    let part = |part: &str| played(&parts, "sweep", &["--shard", part], &swept);
    let [first, second] = ["1/2", "2/2"].map(part);
    let (code, stdout, _) = coverage(&[], &[&first, &second]);
    assert_eq!(code, Some(1), "{stdout}");
    assert!(
        stdout.contains("(not all runs of the sweep were played)"),
        "{stdout}"
    );
    let whole = folder.path().join("whole");
    output(canrig(&whole, "merge").args([&first, &second]));
    let whole = only_run(&whole);
    let (code, stdout, _) = coverage(&[], &[&whole, &first, &second]);
    assert_eq!(code, Some(0), "{stdout}");
}

#[test]
fn torture_tests_no_requirement_and_its_folders_are_named_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = scenario_file(folder.path(), 5.0);
    let torture = |part: &str| {
        let parts = folder.path().join("parts");
        played(
            &parts,
            "torture",
            &["--runs", "4", "--shard", part],
            &scenario,
        )
    };
    let torture = torture("1/2");
    let (code, _, stderr) = coverage(&[], &[&torture]);
    assert_eq!(code, Some(3), "{stderr}");
    let reason = format!("{} is the folder of torture", torture.display());
    assert!(stderr.contains(&reason), "{stderr}");
    let run = played(&folder.path().join("runs"), "simulate", &[], &scenario);
    let (code, stdout, stderr) = coverage(&[], &[&torture, &run]);
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert!(
        stderr.contains(&reason) && stderr.contains("it is left out"),
        "{stderr}"
    );
}

#[test]
fn a_folder_of_run_folders_stands_for_them() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let scenario = scenario_file(folder.path(), 5.0);
    let first = played(&runs, "simulate", &["--set", "seed=1"], &scenario);
    let second = played(&runs, "simulate", &["--set", "seed=2"], &scenario);
    let mut both = [&*first, &*second];
    both.sort();
    let expected = coverage(&[], &both);
    assert_eq!(coverage(&[], &[&runs]), expected);
    assert!(expected.1.contains("seed=1") && expected.1.contains("seed=2"));
    let page = folder.path().join("page.html");
    let mut report = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, _, stderr) = output(report.arg("report").arg(&runs).arg("-o").arg(&page));
    assert_eq!(code, Some(0), "{stderr}");
    let page = fs::read_to_string(page).unwrap();
    for run in [first, second] {
        let name = run.file_name().unwrap().to_str().unwrap();
        assert!(page.contains(name), "{name}");
    }
}

#[test]
fn coverage_shows_what_is_met_missed_broken_off_and_never_tested() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, max: f64, requirements: &str| {
        let path = folder.path().join(format!("{name}.toml"));
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"{name}\"\n{requirements}\nduration_seconds = 0.2\n[controller.sliding_mode]\n\
             [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
             [expect]\ncurrent_amperes_rms = {{ max = {max:.1} }}\n\
             [expect.requirements]\ncurrent_amperes_rms = [\"REQ-1\"]\n\
             [[expect.signal]]\nname = \"current_amperes\"\nstays = {{ max = 1.0 }}\nrequirements = [\"REQ-2\"]\n"
        );
        fs::write(&path, text).unwrap();
        let runs = folder.path().join(name);
        output(canrig(&runs, "simulate").arg(&path));
        only_run(&runs)
    };
    let met = write("met", 5.0, "requirements = [\"REQ-3\"]");
    let missed = write("missed", 0.0, "requirements = [\"REQ-3\"]");
    let broken = write("broken", 5.0, "requirements = [\"REQ-4\"]");
    fs::remove_file(broken.join("verdict.json")).unwrap();

    let junit = fs::read_to_string(met.join("junit.xml")).unwrap();
    for id in ["REQ-1", "REQ-2", "REQ-3"] {
        let property = format!("<property name=\"requirement\" value=\"{id}\"/>");
        assert!(junit.contains(&property), "{junit}");
    }

    let list = folder.path().join("list.csv");
    fs::write(&list, "id,text\nREQ-2,\"small, always\"\nREQ-9,forgotten\n").unwrap();
    let page = folder.path().join("coverage.html");
    let with_list = [
        "--requirements",
        list.to_str().unwrap(),
        "--output",
        page.to_str().unwrap(),
    ];
    let (code, stdout, stderr) = coverage(&with_list, &[&met, &missed, &broken]);
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    let row = |text: &str| stdout.lines().find(|line| line.contains(text)).unwrap();
    assert!(row("REQ-9 forgotten").contains("never tested"), "{stdout}");
    assert!(row("REQ-2 small, always").contains("pass"), "{stdout}");
    let broken = |line: &&str| line.contains(" broken ") && line.contains("incomplete");
    assert_eq!(stdout.lines().filter(broken).count(), 3, "{stdout}");
    assert!(
        row("REQ-4 (not in the list)").contains("broken"),
        "{stdout}"
    );
    assert!(
        stdout.contains("5 requirements: 2 failed, 2 incomplete, 1 never tested"),
        "{stdout}"
    );
    let page = fs::read_to_string(&page).unwrap();
    assert!(
        page.contains(" (limit ≤ ")
            && page.contains("never tested")
            && page.contains("/report.html"),
        "{page}"
    );

    let (code, stdout, _) = coverage(&["--json"], &[&met]);
    assert_eq!(code, Some(0), "{stdout}");
    assert!(stdout.contains("\"outcome\": \"pass\""), "{stdout}");
    let (code, _, stderr) = coverage(&[], &[folder.path()]);
    assert_eq!(code, Some(3), "{stderr}");
    fs::write(&list, "name\nREQ-2\n").unwrap();
    let (code, _, stderr) = coverage(&with_list, &[&met]);
    assert_eq!(code, Some(3), "{stderr}");
    assert!(stderr.contains("must name the column `id`"), "{stderr}");
}

/// A scenario that passes because nothing was judged meets no requirement, and neither does a sweep of it.
#[test]
fn a_requirement_is_not_covered_where_no_limit_is_judged() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, added: &str| {
        let path = folder.path().join(format!("{name}.toml"));
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"{name}\"\nrequirements = [\"REQ-1\"]\nduration_seconds = 0.2\n\
             [controller.sliding_mode]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n{added}"
        );
        fs::write(&path, text).unwrap();
        path
    };
    let sweep = "[sweep]\n[[sweep.list]]\nkey = \"seed\"\nvalues = [1, 2]\n";
    let timing = "[expect.timing]\nround_trip_microseconds = { p99 = { max = 900.0 } }\n";
    let limit = "[expect]\ncurrent_amperes_rms = { max = 5.0 }\n";
    let nothing = "nothing is limited";
    let untimed = "only timing is limited, which virtual time does not judge";
    for (name, command, added, why) in [
        ("free", "simulate", "", Some(nothing)),
        ("swept", "sweep", sweep, Some(nothing)),
        ("timed", "simulate", timing, Some(untimed)),
        ("limited", "simulate", limit, None),
    ] {
        let run = played(&folder.path().join(name), command, &[], &write(name, added));
        let page = folder.path().join("page.html");
        let (code, stdout, _) = coverage(&["--output", page.to_str().unwrap()], &[&run]);
        let page = fs::read_to_string(&page).unwrap();
        let (_, json, _) = coverage(&["--json"], &[&run]);
        let matrix: serde_json::Value = serde_json::from_str(&json).unwrap();
        let test = &matrix[0]["tests"][0];
        let Some(why) = why else {
            assert_eq!(code, Some(0), "{stdout}");
            assert_eq!(test["outcome"], "pass", "{json}");
            continue;
        };
        assert_eq!(code, Some(1), "{stdout}");
        assert!(stdout.contains("1 requirement: 1 not covered"), "{stdout}");
        let said = Vec::from_iter(stdout.split_whitespace()).join(" ");
        assert!(said.contains(why.split(' ').next().unwrap()), "{said}");
        assert!(page.contains("not covered") && page.contains(why), "{page}");
        assert!(test["outcome"].is_null(), "{json}");
        assert_eq!(test["uncovered"], why, "{json}");
    }
}
