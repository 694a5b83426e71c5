//! The second net for changes that keep the behaviour: it covers what the first one, `every_shipped_scenario_passes`,
//! does not. The expected results are in `tests/data/net/*.txt`, line by line, and are written anew by
//! `UPDATE_SNAPSHOTS=1 cargo test --release -p canrig --test tests net`.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Parser;
use controller::catalogue::{LawRow, register_laws};
use fmu::description::Version;
use plant_emulator::catalogue::{PlantRow, register_plants};
use runner::commands::simulate::{SimulateArgs, simulate};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::fmus::{cart, motor};
use crate::mutator::mutant;
use crate::programs::drive_and_fan;
use crate::support::{canrig, only_run, output, root};

/// The law of two loops that `canrig new law --loops 2` writes.
#[path = "../canrig/src/new/law/loops/lib.rs"]
#[expect(unreachable_pub, reason = "it is the library of a crate")]
mod my_law;
/// The plant that `canrig new plant` writes.
#[path = "../canrig/src/new/plant/lib.rs"]
#[expect(
    unreachable_pub,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "it is the library of a crate with other lints"
)]
mod my_plant;

/// Folder of the net in the checkout.
const NET: &str = "tests/data/net";

/// Runs the program without colours, with paths relative to a folder.
fn program(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let plain = canrig
        .env_remove("FORCE_COLOR")
        .env_remove("CLICOLOR_FORCE");
    output(
        plain
            .env("NO_COLOR", "1")
            .current_dir(folder)
            .args(arguments),
    )
}

fn utf8(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn hash(bytes: impl AsRef<[u8]>) -> String {
    let digest = Sha256::digest(bytes);
    let digits = digest[..8].iter().map(|byte| format!("{byte:02x}"));
    digits.collect()
}

/// Returns the lines that differ from those of a stored file, grouped by subject.
fn changes(name: &str, now: &[String]) -> Vec<String> {
    let path = root().join(NET).join(name);
    let text = now.join("\n") + "\n";
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        fs::write(&path, &text).unwrap();
    }
    let stored = fs::read_to_string(&path).unwrap_or_default();
    let [before, after] = [&stored, &text].map(|text| BTreeSet::from_iter(text.lines()));
    let gone = before.difference(&after).map(|line| (line, '-'));
    let mut changes = Vec::from_iter(gone.chain(after.difference(&before).map(|line| (line, '+'))));
    changes.sort_unstable();
    let mut changes = Vec::from_iter(changes.iter().map(|(line, sign)| format!("{sign} {line}")));
    if changes.is_empty() && stored != text {
        changes.push("the same lines, in another order or number".to_owned());
    }
    changes
}

#[track_caller]
fn hold(name: &str, now: &[String]) {
    let changes = changes(name, now);
    let count = changes.len();
    assert!(
        changes.is_empty(),
        "{count} changes to {NET}/{name}:\n{}",
        changes.join("\n")
    );
}

/// Folders with scenarios and rig files for the mutator.
pub(crate) const MUTATED: [&str; 7] = [
    "crates/worlds/tests/data",
    "docs/examples",
    "scenarios",
    "tests/data/net/rigs",
    "tests/data/net/sweeps",
    "tests/foreign",
    "tests/oracle",
];

/// Copies the files that a scenario can name, with their folders; lists the TOML files.
pub(crate) fn copy_files(from: &Path, to: &Path, copied: &mut Vec<PathBuf>) {
    fs::create_dir_all(to).unwrap();
    let mut paths = Vec::from_iter(
        fs::read_dir(from)
            .unwrap()
            .map(|entry| entry.unwrap().path()),
    );
    paths.sort();
    for path in paths {
        let copy = to.join(path.file_name().unwrap());
        match path.extension().map(|end| end.to_str().unwrap()) {
            None if path.is_dir() => copy_files(&path, &copy, copied),
            Some("toml" | "eds" | "csv") => {
                fs::copy(&path, &copy).unwrap();
                copied.extend(
                    copy.extension()
                        .filter(|end| *end == "toml")
                        .map(|_| copy.clone()),
                );
            }
            _ => {}
        }
    }
}

/// Returns the problems of a report on one line.
fn problems(report: &str) -> String {
    let mut problems: Vec<String> = Vec::new();
    for line in report.lines() {
        if let Some(problem) = line.strip_prefix("  × ") {
            problems.push(problem.to_owned());
        } else if let (Some(more), Some(last)) = (line.strip_prefix("  │ "), problems.last_mut())
        {
            *last += " ";
            *last += more;
        }
    }
    problems.retain(|problem| !problem.contains(" is not a valid "));
    problems.join("; ")
}

/// Returns the output of `check` on a file with a mistake, and on a scenario that names the file.
fn report_on(folder: &Path, file: &str, user: Option<&String>) -> (String, String) {
    let arguments = Vec::from_iter(["check", file].into_iter().chain(user.map(String::as_str)));
    let (code, stdout, stderr) = program(folder, &arguments);
    assert!(
        matches!(code, Some(0 | 3)),
        "{file}: {code:?}\n{stdout}{stderr}"
    );
    let kind = match code {
        Some(0) => "valid".to_owned(),
        _ => problems(&stderr),
    };
    (kind, format!("{stdout}{stderr}"))
}

/// The report on each of some 300 files with a mistake is unchanged: its hash, and its problems as text.
#[test]
fn reports_on_mistakes_are_those_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut files = Vec::new();
    for name in MUTATED {
        copy_files(&root().join(name), &folder.join(name), &mut files);
    }
    motor(&folder.join("docs/examples"), Version::Three);
    let name = |path: &Path| utf8(path.strip_prefix(folder).unwrap()).to_owned();
    let texts = Vec::from_iter(files.iter().map(|path| fs::read_to_string(path).unwrap()));
    let mut lines = Vec::new();
    let mut reports = Vec::new();
    for (path, text) in files.iter().zip(&texts) {
        let file = name(path);
        let is_user = |(other, text): &(&PathBuf, &String)| {
            let named = path.strip_prefix(other.parent().unwrap());
            named.is_ok_and(|named| text.contains(&format!("\nrig = \"{}\"", utf8(named))))
        };
        let user = files.iter().zip(&texts).find(is_user);
        let user = user.map(|(path, _)| name(path));
        // The cases of the catalogue of faults are similar.
        let mutants = if file.contains("/faults/") { 1 } else { 5 };
        for number in 1..=mutants {
            let (changed, told) = mutant(text, &format!("{file} {number}"));
            fs::write(path, &changed).unwrap();
            let (kind, report) = report_on(folder, &file, user.as_ref());
            lines.push(format!(
                "{file} {number} ({told}): {} {kind}",
                hash(&report)
            ));
            reports.push(report);
        }
        fs::write(path, text).unwrap();
    }
    assert!(lines.len() >= 300, "{} mutants", lines.len());
    let changes = changes("mutants.txt", &lines);
    let is_changed = |line: &String| changes.contains(&format!("+ {line}"));
    let changed = lines
        .iter()
        .zip(&reports)
        .filter(|(line, _)| is_changed(line));
    let changed = changed
        .take(10)
        .map(|(line, report)| format!("{line}\n{report}"));
    assert!(
        changes.is_empty(),
        "{} changes to {NET}/mutants.txt:\n{}\nThe first reports, as they are now:\n{}",
        changes.len(),
        changes.join("\n"),
        Vec::from_iter(changed).join("\n")
    );
}

/// Scenarios of the checkout that the first net does not play.
const PLAYED: [&str; 10] = [
    "crates/worlds/tests/data/two_axes.toml",
    "docs/examples/excitation.toml",
    "docs/examples/feed_and_press.toml",
    "docs/examples/lift.toml",
    "docs/examples/metrics/load.toml",
    "tests/data/net/rigs/pair_and_axis.toml",
    "tests/data/net/rigs/shop.toml",
    "tests/data/net/rigs/shop_faults.toml",
    "tests/foreign/pid.toml",
    "tests/oracle/four_drives.toml",
];

/// Scenarios that need their hardware.
const NOT_PLAYED: [&str; 1] = ["tests/foreign/two_drives.toml"];

/// Returns the members of a verdict, one per line; each element of a list has its own line. The judge is left out.
fn verdict_lines(name: &str, verdict: &str) -> Vec<String> {
    let verdict: Value = serde_json::from_str(verdict).unwrap();
    let mut lines = Vec::new();
    for (member, value) in verdict.as_object().unwrap() {
        match value {
            _ if ["version", "identity"].contains(&member.as_str()) => {}
            Value::Array(elements) => {
                lines.extend(
                    elements
                        .iter()
                        .map(|element| match element["name"].as_str() {
                            Some(of) => format!("{name}: {member} {of}: {element}"),
                            None => format!("{name}: {member} {element}"),
                        }),
                );
            }
            _ => lines.push(format!("{name}: {member} {value}")),
        }
    }
    lines
}

/// Returns the output of `canrig signals` for a run or a scenario, one signal per line.
fn signal_lines(name: &str, source: &Path) -> Vec<String> {
    let (code, stdout, stderr) = program(&root(), &["signals", "--json", utf8(source)]);
    assert_eq!(code, Some(0), "{stderr}");
    let signals: Vec<Value> = serde_json::from_str(&stdout).unwrap();
    let line = |signal: &Value| {
        let text = |member: &str| signal[member].as_str().unwrap_or("-");
        let limit = |member: &str| signal[member].as_f64().unwrap_or(f64::NAN);
        let values = signal["values"].as_array();
        let values = values.map_or_else(String::new, |values| {
            let all = Vec::from_iter(values.iter().map(Value::to_string)).concat();
            format!(", {} names {}", values.len(), &hash(all)[..4])
        });
        format!(
            "{name}: signal {} {} [{}] of {}, {:?} to {:?}{values}",
            text("loop"),
            text("path"),
            text("unit"),
            text("sender"),
            limit("minimum"),
            limit("maximum"),
        )
    };
    signals.iter().map(line).collect()
}

/// Returns the verdict of a run. A replay must give the same bytes.
#[track_caller]
pub(crate) fn judged_again(run: &Path) -> String {
    let verdict = fs::read_to_string(run.join("verdict.json")).unwrap();
    let (_, again, stderr) = program(run, &["replay", "--json", "."]);
    assert!(
        again == verdict,
        "{}: the run says {verdict}, replay says {again}{stderr}",
        run.display()
    );
    verdict
}

/// Returns the stored lines of a run.
fn run_lines(name: &str, run: &Path) -> Vec<String> {
    let verdict = judged_again(run);
    let mut files = ["bus.log", "signals.csv", "frames.dbc"]
        .map(PathBuf::from)
        .to_vec();
    let sheets = fs::read_dir(run.join("eds")).unwrap();
    files.extend(sheets.map(|sheet| Path::new("eds").join(sheet.unwrap().file_name())));
    files[3..].sort();
    let hashed = |file: &PathBuf| {
        let bytes = fs::read(run.join(file)).unwrap();
        format!("{name}: {} {}", file.display(), hash(bytes))
    };
    let mut lines = Vec::from_iter(files.iter().map(hashed));
    lines.extend(verdict_lines(name, &verdict));
    lines.extend(signal_lines(name, run));
    lines
}

/// Arguments behind a scenario that put a program in the controller's place, which prints its part
/// of the plan and ends.
pub(crate) const PRINTS_PART: [&str; 4] = ["--", "sh", "-c", "cat \"$CANRIG_PART\""];

/// Returns what the programs of a run printed, by their nodes.
pub(crate) fn printed_parts(run: &Path) -> Vec<(String, Vec<u8>)> {
    let mut parts = Vec::new();
    for entry in fs::read_dir(run).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if let Some(node) = name.strip_suffix(".log").filter(|node| *node != "bus") {
            parts.push((node.to_owned(), fs::read(&path).unwrap()));
        }
    }
    parts.sort();
    parts
}

/// Returns the hash of what a program is told of the plan, by its node.
fn part_line(name: &str, (node, part): &(String, Vec<u8>)) -> String {
    format!("{name}: part of {node} {}", hash(part))
}

/// Simulates a scenario; returns its lines.
fn simulated(folder: &Path, scenario: &Path) -> Vec<String> {
    let name = utf8(Path::new(scenario.file_stem().unwrap()));
    let runs = folder.join("runs").join(name);
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(scenario));
    assert!(matches!(code, Some(0 | 1)), "{name}: {stdout}{stderr}");
    let mut lines = run_lines(name, &only_run(&runs));
    let told = folder.join("told").join(name);
    let mut simulate = canrig(&told, "simulate");
    let (_, stdout, stderr) = output(simulate.arg("--quiet").arg(scenario).args(PRINTS_PART));
    assert!(told.is_dir(), "{name}: {stdout}{stderr}");
    let parts = printed_parts(&only_run(&told));
    assert_eq!(parts.len(), 1, "{name}: {stdout}{stderr}");
    lines.push(part_line(name, &parts[0]));
    lines
}

/// Simulates a rig whose drive and io node are programs, of which one prints its part of the plan
/// and ends; returns the lines of both parts.
fn told_to_drive_and_fan(folder: &Path) -> Vec<String> {
    let mut lines = Vec::new();
    for node in ["drive", "fan"] {
        let folder = folder.join("told").join(node);
        fs::create_dir_all(&folder).unwrap();
        let scenario = drive_and_fan(&folder);
        let rig = folder.join("rig.toml");
        let text = fs::read_to_string(&rig).unwrap();
        let program = format!("[\"python3\", \"{node}.py\"]");
        assert!(text.contains(&program), "{text}");
        let prints = format!("{:?}", &PRINTS_PART[1..]);
        fs::write(&rig, text.replace(&program, &prints)).unwrap();
        let runs = folder.join("runs");
        let (_, stdout, stderr) = output(canrig(&runs, "simulate").arg(scenario));
        assert!(runs.is_dir(), "{stdout}{stderr}");
        let mut parts = printed_parts(&only_run(&runs));
        parts.retain(|(other, _)| other == node);
        assert_eq!(parts.len(), 1, "{stdout}{stderr}");
        lines.push(part_line("drive_and_fan", &parts[0]));
    }
    lines
}

#[derive(Debug, Parser)]
struct Outside {
    #[command(flatten)]
    simulate: SimulateArgs,
}

/// Variable with the folder for the runs and the scenario of a custom bench.
const OUTSIDE: &str = "CANRIG_NET_OUTSIDE";

/// Plays a bench with a custom law and plant. They are registered once in a process, before any file is read.
#[test]
#[ignore = "a process of `rigs_are_played_as_before`"]
fn simulate_outside() {
    let Ok(arguments) = std::env::var(OUTSIDE) else {
        return;
    };
    register_laws(vec![LawRow::of::<my_law::MyLaw>()]).unwrap();
    register_plants(vec![PlantRow::of::<my_plant::MyPlant>()]).unwrap();
    let arguments = ["simulate", "--output"]
        .into_iter()
        .chain(arguments.lines());
    let _ = simulate(&Outside::parse_from(arguments).simulate);
}

/// Simulates a scenario that `canrig new` writes with a law or a plant; returns its lines.
fn simulated_outside(folder: &Path, name: &str, kind: &[&str]) -> Vec<String> {
    let path = folder.join(name);
    let arguments = [&["new"], kind, &[name, "--path", utf8(&path)]].concat();
    let (code, _, stderr) = program(folder, &arguments);
    assert_eq!(code, Some(0), "{stderr}");
    let scenario = path.join("scenarios").join(name).with_extension("toml");
    let runs = folder.join("runs").join(name);
    let mut bench = Command::new(std::env::current_exe().unwrap());
    bench
        .args([
            "--exact",
            "net::simulate_outside",
            "--ignored",
            "--nocapture",
        ])
        .env(OUTSIDE, format!("{}\n{}", utf8(&runs), utf8(&scenario)));
    let (_, stdout, stderr) = output(&mut bench);
    assert!(runs.is_dir(), "{name}: {stdout}{stderr}");
    run_lines(name, &only_run(&runs))
}

/// A dozen rigs leave the stored frames with what they mean, EDS files, verdicts (of the run and of
/// its replay), signals, and parts of programs.
#[test]
fn rigs_are_played_as_before() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut lines = Vec::new();
    for scenario in PLAYED {
        lines.extend(simulated(folder, &root().join(scenario)));
    }
    // An FMU behind a drive.
    let step = cart(folder, "");
    lines.extend(simulated(folder, &step));
    let (code, _, stderr) = program(folder, &["new", "rig", "gantry", "--path", "gantry"]);
    assert_eq!(code, Some(0), "{stderr}");
    lines.extend(simulated(folder, &folder.join("gantry/gantry_steps.toml")));
    lines.extend(simulated_outside(
        folder,
        "my_law",
        &["law", "--loops", "2"],
    ));
    lines.extend(simulated_outside(folder, "my_plant", &["plant"]));
    lines.extend(told_to_drive_and_fan(folder));
    for scenario in NOT_PLAYED {
        let path = root().join(scenario);
        lines.extend(signal_lines(
            utf8(Path::new(path.file_stem().unwrap())),
            &path,
        ));
    }
    hold("rigs.txt", &lines);
}

/// The rows of three sweeps: over a rig with several loops, a fault and a plant, and gains with some refused values.
#[test]
fn rows_of_sweeps_are_those_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let mut lines = Vec::new();
    for name in ["fault", "gains", "loops"] {
        let scenario = root().join(NET).join("sweeps").join(name);
        let runs = folder.path().join(name);
        let (code, stdout, stderr) =
            output(canrig(&runs, "sweep").arg(scenario.with_extension("toml")));
        assert!(matches!(code, Some(0 | 1 | 3)), "{name}: {stdout}{stderr}");
        let mut table = csv::Reader::from_path(only_run(&runs).join("runs.csv")).unwrap();
        let columns = table.headers().unwrap().clone();
        for row in table.records() {
            let row = row.unwrap();
            // The name of a case contains that of its file.
            let cells = columns
                .iter()
                .zip(&row)
                .filter(|(column, _)| *column != "id");
            let case = row[0].to_owned();
            lines.extend(
                cells.map(|(column, cell)| format!("{name}: case {case}: {column} {cell}")),
            );
        }
    }
    hold("sweeps.txt", &lines);
}

/// The numbers of recordings of earlier versions, of real drives and of other controllers. They are run folders if
/// there is a rig file for them, else logs with their scenarios.
#[test]
fn stored_logs_have_the_numbers_of_before() {
    let logs = root().join(NET).join("logs");
    let mut folders = Vec::from_iter(
        fs::read_dir(&logs)
            .unwrap()
            .map(|entry| entry.unwrap().path()),
    );
    folders.sort();
    assert!(folders.len() >= 12, "{folders:?}");
    let mut lines = Vec::new();
    for folder in folders {
        let name = utf8(Path::new(folder.file_name().unwrap()));
        let replay_log = [
            "replay",
            "--json",
            "bus.log.zst",
            "--scenario",
            "scenario.toml",
        ];
        let arguments = if folder.join("rig.toml").exists() {
            &["replay", "--json", "."][..]
        } else {
            &replay_log
        };
        let (code, stdout, stderr) = program(&folder, arguments);
        assert!(
            matches!(code, Some(0 | 1 | 4 | 5)),
            "{name}: {code:?} {stdout}{stderr}"
        );
        lines.extend(verdict_lines(name, &stdout));
        lines.extend(stderr.lines().map(|line| format!("{name}: remark {line}")));
    }
    hold("logs.txt", &lines);
}

/// One loop has the name of another one and of a service.
#[test]
fn loops_whose_names_begin_alike_are_judged_again() {
    let folder = tempfile::tempdir().unwrap();
    let (code, _, stderr) = program(folder.path(), &["new", "rig", "gantry", "--path", "gantry"]);
    assert_eq!(code, Some(0), "{stderr}");
    let third = "[plant.axis_c.dc_motor]\n[node.b_drive]\nkind = \"drive\"\nnode_id = 0x14\n\
        amplifier.port = \"axis_c.current_amperes\"\nsensor.port = \"axis_c.position_metres\"\n\
        [loop.b_drive]\nfeedback = \"b_drive.position\"\noutputs = [\"b_drive.current\"]\n";
    let demand = "[[reference.step]]\nloop = \"b_drive\"\nat_seconds = 1.0\nposition_millimetres = 5.0\n\
        [[expect.b.signal]]\nname = \"motor_speed_revolutions_per_minute\"\nstays = { max = 9000.0 }\n";
    for (file, more) in [("gantry.toml", third), ("gantry_steps.toml", demand)] {
        let path = folder.path().join("gantry").join(file);
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, format!("{text}\n{more}")).unwrap();
    }
    simulated(
        folder.path(),
        &folder.path().join("gantry/gantry_steps.toml"),
    );
}
