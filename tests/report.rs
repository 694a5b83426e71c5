//! The pages of a run, and those made from run folders. `tests/system/test_pages.py` tests them in a browser.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{canrig, only_run, output, scenario, short_scenario};

/// Returns the elements of a page, after a check of its script: only that of the plots, which loads nothing.
pub(crate) fn elements(page: &str) -> &str {
    assert_eq!(page.matches("<script").count(), 1);
    assert!(page.contains("default-src 'none'; img-src data:;"));
    for loads in ["src=", "url(", "@import", "http://", "https://"] {
        assert!(!page.contains(loads), "{loads}");
    }
    page.split_once("<script>").expect("a script").0
}

/// Runs the program with a command that makes no runs.
fn tool(arguments: &[&str], paths: &[&Path]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    output(canrig.args(arguments).args(paths).env("NO_COLOR", "1"))
}

/// Reads a page without the marks for breaks in names.
fn unbroken(page: &Path) -> String {
    fs::read_to_string(page).unwrap().replace("<wbr>", "")
}

fn simulated(folder: &Path, name: &str) -> PathBuf {
    let runs = folder.join(name);
    assert_eq!(
        output(canrig(&runs, "simulate").arg(scenario(name))).0,
        Some(0)
    );
    only_run(&runs)
}

#[test]
fn the_page_of_a_chirp_has_gain_and_phase_over_frequency() {
    let folder = tempfile::tempdir().unwrap();
    let page = unbroken(&simulated(folder.path(), "chirp.toml").join("report.html"));
    for part in [
        "Frequency response",
        "Gain",
        "frequency (Hz)",
        "chirp 1",
        "gain",
    ] {
        assert!(page.contains(part), "{part} is missing");
    }
    let numbers = page.split("as numbers").nth(1).unwrap();
    assert!(
        numbers
            .split("</table>")
            .next()
            .unwrap()
            .matches("<tr>")
            .count()
            > 60
    );
    assert!(!elements(&page).contains("NaN"));
    let other = unbroken(&simulated(folder.path(), "step.toml").join("report.html"));
    assert!(!other.contains("Frequency response"));
}

#[test]
fn a_page_holds_the_whole_run_and_loads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), "fan.toml");
    let page = unbroken(&run.join("report.html"));
    assert!(page.len() < 1_000_000, "{} bytes", page.len());
    let parts = [
        "Verdict",
        "<td class=\"name\">maximum_deviation_millimetres</td>",
        "Position",
        "Hysteresis",
        "Sliding variable",
        "Parts of the law",
        "Bus load",
        "SYNC to SYNC",
        "drive: operation enabled",
        "[[disturbance.fan]]",
        "canrig simulate",
        "prefers-color-scheme: dark",
    ];
    for part in parts {
        assert!(page.contains(part), "{part} is missing");
    }
    let shown = elements(&page);
    assert!(!shown.contains("NaN") && !shown.contains("inf\""));
    // Every plot has an axis and its curve, and at least one point.
    assert_eq!(page.matches("<svg").count(), page.matches("</svg>").count());
    assert!(page.matches("<svg").count() >= 12);
}

#[test]
fn a_page_made_again_is_the_same_to_the_byte() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), "step.toml");
    let place = run.join("report.html");
    let first = fs::read(&place).unwrap();
    for name in ["report.html", "signals.csv", "junit.xml"] {
        fs::remove_file(run.join(name)).unwrap();
    }
    assert_eq!(tool(&["report"], &[&run]).0, Some(0));
    assert!(fs::read(&place).unwrap() == first);
}

#[test]
fn several_runs_are_compared_on_one_page() {
    let folder = tempfile::tempdir().unwrap();
    let (step, fan) = (
        simulated(folder.path(), "step.toml"),
        simulated(folder.path(), "fan.toml"),
    );
    let place = folder.path().join("all.html");
    let (code, _, stderr) = tool(
        &["report", "--output", place.to_str().unwrap()],
        &[&step, &fan],
    );
    assert_eq!(code, Some(0), "{stderr}");
    let page = unbroken(&place);
    assert!(page.contains("2 of 2 runs passed"), "{page}");
    for run in [&step, &fan] {
        let link = run.strip_prefix(folder.path()).unwrap().join("report.html");
        assert!(
            page.contains(&format!("href=\"{}\"", link.display())),
            "{page}"
        );
    }
    // Scenarios have their names; their folders appear only if two have the same scenario.
    assert!(page.contains(">25 mm step from a warm hold</a>"), "{page}");
    assert!(!page.contains("<div class=\"soft\">25-mm-step"), "{page}");
    let head = page
        .split("<thead>")
        .nth(1)
        .unwrap()
        .split("</thead>")
        .next()
        .unwrap();
    let names: Vec<&str> = head.split("<th class=\"number\">").skip(1).collect();
    assert!(names.len() <= 8, "{head}");
    assert!(names[0].starts_with("settling_time_seconds"), "{head}");
    // The fan scenario limits the first metric; the second one has no limit.
    let place = |name: &str| page.find(&format!(">{name}</th>")).unwrap();
    assert!(place("recovery_time_seconds") < place("tracking_error_millimetres_rms"));
    // No run has this metric, as there is no sine.
    assert!(!page.contains("sine_gain</th>"));
}

#[test]
fn runs_of_one_scenario_differ_by_their_folders() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    let runs = folder.path().join("runs");
    for _ in 0..2 {
        output(canrig(&runs, "simulate").arg(&path));
    }
    let runs: Vec<PathBuf> = fs::read_dir(&runs)
        .unwrap()
        .map(|run| run.unwrap().path())
        .collect();
    let place = folder.path().join("all.html");
    let arguments = ["report", "--output", place.to_str().unwrap()];
    assert_eq!(tool(&arguments, &[&runs[0], &runs[1]]).0, Some(0));
    let page = unbroken(&place);
    for run in &runs {
        let name = run.file_name().unwrap().to_str().unwrap();
        assert!(page.contains(&format!("<div class=\"soft\">{name}</div>")));
    }
}

#[test]
fn a_failed_run_names_what_it_missed_and_what_was_set() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let set = "expect.overshoot_percent.max=0.01";
    let mut simulate = canrig(&runs, "simulate");
    simulate.arg(scenario("step.toml")).args(["--set", set]);
    assert_eq!(output(&mut simulate).0, Some(1));
    let run = only_run(&runs);
    let page = unbroken(&run.join("report.html"));
    let (head, _) = page.split_once(">Verdict</h2>").unwrap();
    let place = |text: &str| head.find(text).unwrap_or_else(|| panic!("{text}"));
    assert!(place("Missed: overshoot_percent 0.1560 (limit ≤ 0.01).") < place("Without a limit:"));
    assert!(head.contains(&format!("--set {set}")));
    let name = if page.contains("program, build ID") {
        40
    } else {
        64
    };
    let verdict = fs::read_to_string(run.join("verdict.json")).unwrap();
    let verdict: serde_json::Value = serde_json::from_str(&verdict).unwrap();
    assert_eq!(verdict["identity"]["program"].as_str().unwrap().len(), name);
    // Made again, it is the same.
    let first = fs::read(run.join("report.html")).unwrap();
    assert_eq!(tool(&["report"], &[&run]).0, Some(0));
    assert!(fs::read(run.join("report.html")).unwrap() == first);
    let all = folder.path().join("all.html");
    let arguments = ["report", "--output", all.to_str().unwrap()];
    assert_eq!(tool(&arguments, &[&runs]).0, Some(0));
    assert!(unbroken(&all).contains(&format!("--set {set}")));
}

/// In virtual time every play leaves the same page, so its date is in `played.json` alone.
#[test]
fn the_page_of_a_run_in_real_time_has_its_date_and_its_machine() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    for (command, is_dated) in [("run", true), ("simulate", false)] {
        let runs = folder.path().join(command);
        output(canrig(&runs, command).arg(&path));
        let run = only_run(&runs);
        let played = fs::read_to_string(run.join("played.json")).unwrap();
        let played: serde_json::Value = serde_json::from_str(&played).unwrap();
        let [at, host] = ["at", "host"].map(|key| played[key].as_str().unwrap());
        let (day, minute) = (&at[..10], &at[11..16]);
        let page = fs::read_to_string(run.join("report.html")).unwrap();
        let entry = format!("<dt>played</dt><dd>{day} {minute} UTC on {host}</dd>");
        assert_eq!(page.contains(&entry), is_dated, "{command}: {entry}");
        assert_eq!(page.contains("<dt>played</dt>"), is_dated, "{command}");
        assert_eq!(tool(&["report"], &[&run]).0, Some(0));
        let again = fs::read_to_string(run.join("report.html")).unwrap();
        assert!(again == page, "{command}");
    }
}

#[test]
fn a_signal_without_values_is_not_the_same_and_a_metric_of_one_run_is_only_there() {
    let folder = tempfile::tempdir().unwrap();
    let (step, fan) = (
        simulated(folder.path(), "step.toml"),
        simulated(folder.path(), "fan.toml"),
    );
    let place = folder.path().join("compared.html");
    let arguments = ["compare", "--output", place.to_str().unwrap()];
    let (code, stdout, _) = tool(&arguments, &[&step, &fan]);
    assert_eq!(code, Some(1), "{stdout}");
    let page = unbroken(&place);
    let row = |name: &str| {
        let (_, rest) = page
            .split_once(&format!("\"name\">{name}</td>"))
            .expect(name);
        rest.split_once("</tr>").unwrap().0
    };
    assert!(row("convection_factor").contains(">no values<"));
    // Both runs are headed by links to their pages, rig and seed.
    for run in [&step, &fan] {
        let page = run.strip_prefix(folder.path()).unwrap().join("report.html");
        let link = format!("href=\"{}\">{}</a>", page.display(), run.display());
        assert!(row("folder").contains(&link), "{}", row("folder"));
    }
    assert_eq!(row("rig").matches("SMA wire actuator").count(), 2);
    assert_eq!(row("seed").matches("<div>0</div>").count(), 2);
    assert!(row("settling_time_seconds").contains(">only in A<"));
    assert!(row("recovery_time_seconds").contains(">only in B<"));
}

#[test]
fn what_a_scenario_says_cannot_become_part_of_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    let text = fs::read_to_string(&path).unwrap();
    let evil = text.replace("\"short\"", "\"</style><script>alert(1)</script>\"");
    fs::write(&path, evil + "# </pre><img src=x>\n").unwrap();
    let runs = folder.path().join("runs");
    assert_eq!(output(canrig(&runs, "simulate").arg(&path)).0, Some(0));
    let page = fs::read_to_string(only_run(&runs).join("report.html")).unwrap();
    assert_eq!(page.matches("<script").count(), 1);
    assert!(!page.contains("<script>alert") && !page.contains("<img"));
    assert_eq!(page.matches("</style>").count(), 1);
}

#[test]
fn a_run_that_never_began_has_a_page_too() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), "step.toml");
    fs::write(run.join("bus.log"), "").unwrap();
    assert_eq!(tool(&["report"], &[&run]).0, Some(0));
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("The scenario never began"));
}

#[test]
fn what_is_no_run_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing");
    for (path, reason) in [
        (
            folder.path(),
            "is not a run folder (no scenario.toml in it)",
        ),
        (&missing, "cannot be read: No such file or directory"),
    ] {
        for command in ["report", "replay", "coverage"] {
            let (code, _, stderr) = tool(&[command], &[path]);
            assert_eq!(code, Some(3), "{command}: {stderr}");
            assert!(stderr.contains(reason), "{command}: {stderr}");
        }
    }
}

#[test]
fn the_folder_of_a_sweep_is_no_run_and_beside_runs_it_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let path = short_scenario(folder.path(), 1.0);
    assert_eq!(output(canrig(&runs, "simulate").arg(&path)).0, Some(0));
    let run = only_run(&runs);
    let text = fs::read_to_string(&path).unwrap();
    let axis = "[sweep]\n[[sweep.list]]\nkey = \"seed\"\nvalues = [1, 2]\n";
    fs::write(&path, format!("{text}{axis}")).unwrap();
    assert_eq!(output(canrig(&runs, "sweep").arg(&path)).0, Some(0));
    let is_other = |path: &PathBuf| *path != run;
    let sweep = crate::support::runs(&runs)
        .into_iter()
        .find(is_other)
        .unwrap();
    let page = fs::read(sweep.join("report.html")).unwrap();
    let reason = format!(
        "`{}` is the folder of a sweep or of torture, not of a run",
        sweep.display()
    );
    for command in ["report", "replay", "export --format=csv"] {
        let words: Vec<&str> = command.split(' ').collect();
        let (code, stdout, stderr) = tool(&words, &[&sweep]);
        assert_eq!(code, Some(3), "{command}: {stderr}");
        assert!(stderr.contains(&reason), "{command}: {stderr}");
        assert_eq!(stdout, "", "{command}");
    }
    let (code, _, stderr) = tool(&["compare"], &[&run, &sweep]);
    assert_eq!(code, Some(3), "{stderr}");
    let place = folder.path().join("all.html");
    let arguments = ["report", "--output", place.to_str().unwrap()];
    let (code, _, stderr) = tool(&arguments, &[&run, &sweep]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        stderr.contains(&format!("{reason}; it is left out")),
        "{stderr}"
    );
    assert!(unbroken(&place).contains("1 of 1 runs passed"));
    assert!(fs::read(sweep.join("report.html")).unwrap() == page);
}

#[test]
fn what_cannot_be_read_of_a_log_is_said_on_the_page_of_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), "step.toml");
    let log = fs::read(run.join("bus.log")).unwrap();
    fs::write(run.join("bus.log"), &log[..log.len() / 2]).unwrap();
    let (code, _, stderr) = tool(&["report"], &[&run]);
    assert_eq!(code, Some(0), "{stderr}");
    let remark = format!("{}: the log breaks off (", run.display());
    assert!(stderr.contains(&remark), "{stderr}");
    assert!(unbroken(&run.join("report.html")).contains("the log breaks off ("));
}

/// A run that was killed before its log existed has a verdict that reports it.
#[test]
fn a_run_that_has_ended_and_lost_its_log_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path(), "step.toml");
    fs::remove_file(run.join("bus.log")).unwrap();
    let page = fs::read(run.join("report.html")).unwrap();
    for command in ["report", "replay", "export --format=csv"] {
        let words: Vec<&str> = command.split(' ').collect();
        let (code, stdout, stderr) = tool(&words, &[&run]);
        assert_eq!(code, Some(3), "{command}: {stderr}");
        let reason = "bus.log` cannot be read: No such file";
        assert!(stderr.contains(reason), "{command}: {stderr}");
        assert_eq!(stdout, "", "{command}");
    }
    assert!(fs::read(run.join("report.html")).unwrap() == page);
    let verdict = fs::read_to_string(run.join("verdict.json")).unwrap();
    assert!(verdict.contains("\"outcome\": \"pass\""), "{verdict}");
    let killed = verdict.replace("\"outcome\": \"pass\"", "\"outcome\": \"incomplete\"");
    fs::write(run.join("verdict.json"), killed).unwrap();
    assert_eq!(tool(&["report"], &[&run]).0, Some(0));
    assert_eq!(tool(&["replay"], &[&run]).0, Some(4));
}

/// Nodes send 0 for signals that they lack.
#[test]
fn a_page_draws_no_signal_that_the_run_does_not_have() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    let text = fs::read_to_string(&path).unwrap();
    let drawn = |name: &str, text: &str| {
        fs::write(&path, text).unwrap();
        let runs = folder.path().join(name);
        let (code, _, stderr) = output(canrig(&runs, "simulate").arg(&path));
        assert_eq!(code, Some(0), "{stderr}");
        fs::read_to_string(only_run(&runs).join("report.html")).unwrap()
    };
    let law = "[controller.sliding_mode]";
    assert!(text.contains(law), "{text}");
    let parts = ["Sliding variable", "Parts of the law", ">estimated"];
    let page = drawn("sliding", &text);
    assert!(parts.iter().all(|part| page.contains(part)));
    let page = drawn("pid", &text.replace(law, "[controller.pid]"));
    assert!(parts.iter().all(|part| !page.contains(part)));
}

/// Two wires turn one joint: the second drive has no set-point, and there is no step.
#[test]
fn a_page_explains_what_it_shows_in_the_unit_of_its_loop() {
    let folder = tempfile::tempdir().unwrap();
    let page = |name| unbroken(&simulated(folder.path(), name).join("report.html"));
    let disturbed = page("sma_pair_disturbance.toml");
    let (first, second) = disturbed.split_once(">Loop extensor</h2>").unwrap();
    assert!(first.contains("<strong>Error</strong> (deg)") && !second.contains(">Error<"));
    assert!(disturbed.contains("Yellow: a disturbance acts."));
    assert!(!disturbed.contains("Green: settling band"));
    // The truth is drawn in the same plot as the measurement.
    assert!(!disturbed.contains("Position of the load before the sensor"));
    let steps = page("sma_pair_step.toml");
    assert_eq!(steps.matches("Green: settling band of a step.").count(), 1);
    assert!(!steps.contains("Yellow: a disturbance acts."));
    assert!(!steps.contains("Violet"));
    // Each loop shows the loss of the drive of one loop.
    let lost = page("sma_pair_drive_lost.toml");
    assert_eq!(lost.matches("Violet: a fault acts").count(), 2);
    assert!(lost.contains("class=\"fault\""));
}
