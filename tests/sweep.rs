//! Sweeps: interrupted and continued, in parts, with failing cases, and with invalid files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use crate::support::{canrig, only_run, output, runs};

/// A short hold that the plant reaches; above 15 mm it misses its limit.
const BASE: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"swept\"\nduration_seconds = 1.0\n\n[controller.sliding_mode]\n\n\
    [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\n\
    [expect]\nposition_millimetres_max = { max = 15.0 }\n\n\
    [[expect.signal]]\nname = \"position_millimetres\"\nfollows = { file = \"course.csv\", tolerance = 60.0 }\n\n";

/// Row of the verdict for the expectation above.
const FOLLOWS: &str = "position_millimetres follows course.csv";

const SWEEP: &str = "[sweep]\ndraws = 20\n\n\
    [[sweep.list]]\nkey = \"reference.hold[0].position_millimetres\"\nvalues = [5.0, 10.0, 30.0]\n\n\
    [[sweep.uniform]]\nkey = \"plant.wire.mechanics.load_kilograms\"\nfrom = 0.03\nto = 0.05\n\n\
    [[sweep.uniform]]\nkey = \"seed\"\nfrom = 0\nto = 1000\n";

fn file(folder: &Path, sweep: &str) -> PathBuf {
    let course = "time_seconds,position_millimetres\n0.0,10.0\n0.4,10.0\n";
    fs::write(folder.join("course.csv"), course).unwrap();
    let path = folder.join("swept.toml");
    fs::write(&path, format!("{BASE}{sweep}")).unwrap();
    path
}

/// Returns the files that must be equal however the sweep ended.
fn results(folder: &Path) -> Vec<Vec<u8>> {
    let names = ["runs.csv", "runs.parquet", "report.html"];
    names
        .map(|name| fs::read(folder.join(name)).unwrap())
        .into()
}

/// Runs the whole sweep without interruption.
fn whole(folder: &Path, path: &Path) -> PathBuf {
    let runs = folder.join("whole");
    let (code, stdout, stderr) = output(canrig(&runs, "sweep").arg(path));
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    assert!(stdout.contains("60 runs: "), "{stdout}");
    let is_of_check = |line: &&str| line.contains(FOLLOWS);
    let check = stdout.lines().find(is_of_check).unwrap();
    let cells: Vec<&str> = check.split('┆').map(str::trim).collect();
    assert_eq!(cells[6..], ["≤ 60", "0 │"], "{check}");
    let swept = only_run(&runs);
    let failing = swept.join("failing");
    let cases = self::runs(&failing)
        .into_iter()
        .filter(|path| path.extension().is_some_and(|end| end == "toml"));
    let (failing, count) = (failing.display(), cases.count());
    let line = format!("failing  {failing} (all {count}, for canrig simulate)");
    assert!(stdout.contains(&line), "{stdout}");
    swept
}

#[test]
fn a_sweep_that_is_killed_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let undisturbed = results(&whole(folder.path(), &path));
    let runs = folder.path().join("killed");
    let lines = || {
        let text = fs::read(only_run(&runs).join("rows.jsonl")).unwrap_or_default();
        text.iter().filter(|byte| **byte == b'\n').count()
    };
    let mut sweep = canrig(&runs, "sweep");
    let sweep = sweep
        .arg(&path)
        .args(["--threads", "1"])
        .stdout(Stdio::null());
    let mut child = sweep.spawn().unwrap();
    let is_begun = || runs.exists() && !self::runs(&runs).is_empty() && lines() > 5;
    wait_until(&mut child, is_begun);
    child.kill().unwrap();
    child.wait().unwrap();
    let done = lines();
    assert!(
        (6..=60).contains(&done),
        "{done} lines: it was not killed on its way"
    );

    // The process was killed in the middle of a row.
    let rows = only_run(&runs).join("rows.jsonl");
    let mut torn = fs::read(&rows).unwrap();
    torn.truncate(torn.len() - 10);
    fs::write(&rows, torn).unwrap();
    let (code, stdout, stderr) = output(canrig(&runs, "sweep").arg(&path));
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    // The first line is no row.
    assert!(
        stdout.contains(&format!("; {} are done", done - 2)),
        "{stdout}"
    );
    let cut = format!("line {done} of {} is damaged or cut short", rows.display());
    assert!(stderr.contains(&cut), "{stderr}");
    assert_eq!(results(&only_run(&runs)), undisturbed);

    // Another sweep of the same name has its own folder.
    file(folder.path(), &SWEEP.replace("0.05", "0.06"));
    output(canrig(&runs, "sweep").arg(&path));
    assert_eq!(self::runs(&runs).len(), 2);
}

#[test]
fn damaged_lines_are_named_and_played_again_and_rows_of_others_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let swept = whole(folder.path(), &path);
    let undisturbed = results(&swept);
    let rows = swept.join("rows.jsonl");
    let sound = fs::read_to_string(&rows).unwrap();
    let again = || {
        let mut again = canrig(&folder.path().join("whole"), "sweep");
        output(again.arg(&path).arg("--quiet"))
    };
    // The damaged bytes are one of the header, and one of a row in the middle.
    let mut bytes = sound.clone().into_bytes();
    let middle = bytes.len() / 2;
    let line = sound[..middle].lines().count();
    bytes[20] ^= 1;
    bytes[middle] ^= 1;
    fs::write(&rows, &bytes).unwrap();
    let (code, _, stderr) = again();
    assert_eq!(code, Some(1), "{stderr}");
    let message = [1, line].map(|line| {
        let path = rows.display();
        format!("canrig: line {line} of {path} is damaged or cut short, and does not count\n")
    });
    assert_eq!(stderr, message.concat());
    assert_eq!(results(&swept), undisturbed);
    assert_eq!(fs::read(&rows).unwrap(), bytes);
    let one_case = fs::read_to_string(swept.join("rows-2.jsonl")).unwrap();
    assert_eq!(one_case.lines().count(), 2, "{one_case}");
    let (code, _, stderr) = again();
    assert_eq!((code, stderr.as_str()), (Some(1), ""));

    // The message has the first ten of many lines.
    fs::write(&rows, "notes of somebody else\n".repeat(12)).unwrap();
    let (code, _, stderr) = again();
    assert_eq!(code, Some(1), "{stderr}");
    assert!(
        stderr.contains("line 10 of ") && stderr.ends_with("and 2 more lines\n"),
        "{stderr}"
    );
    assert_eq!(results(&swept), undisturbed);

    // These rows belong to another scenario.
    let other = file(folder.path(), &SWEEP.replace("0.05", "0.06"));
    let others = folder.path().join("other");
    output(canrig(&others, "sweep").arg(other));
    file(folder.path(), SWEEP);
    fs::copy(only_run(&others).join("rows.jsonl"), &rows).unwrap();
    let (code, _, stderr) = again();
    assert_eq!(code, Some(3), "{stderr}");
    let (path, folder) = (rows.display(), swept.display());
    let message = format!(
        "canrig: {path} has rows of another scenario.toml, and nothing of it counts here. \
        `rm {folder}/rows*.jsonl` makes a new start: then play it again\n"
    );
    assert_eq!(stderr, message);
    let mut shell = Command::new("sh");
    let (_, command) = stderr.split_once('`').unwrap();
    let (command, _) = command.split_once('`').unwrap();
    assert!(shell.args(["-c", command]).status().unwrap().success());
    let (code, _, stderr) = again();
    assert_eq!((code, stderr.as_str()), (Some(1), ""));
    assert_eq!(results(&swept), undisturbed);
    assert_eq!(fs::read_to_string(&rows).unwrap().lines().count(), 61);
}

#[test]
fn a_whole_sweep_has_one_writer_and_a_part_as_many_as_play_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let swept = whole(folder.path(), &path);
    let undisturbed = results(&swept);
    let play = |folder: &Path, options: &[&str]| {
        output(
            canrig(folder, "sweep")
                .arg(&path)
                .args(options)
                .arg("--quiet"),
        )
    };
    let parts = folder.path().join("parts");
    assert_eq!(play(&parts, &["--shard", "1/2"]).0, Some(1));
    for (parent, options, expected) in [
        (&folder.path().join("whole"), &[][..], 4),
        (&parts, &["--shard", "1/2"], 1),
    ] {
        let rows = only_run(parent).join("rows.jsonl");
        let text = fs::read_to_string(&rows).unwrap();
        let kept: Vec<&str> = text.split_inclusive('\n').take(4).collect();
        fs::write(&rows, kept.concat()).unwrap();
        let file = fs::File::open(&rows).unwrap();
        file.lock().unwrap();
        let (code, _, stderr) = play(parent, options);
        assert_eq!(code, Some(expected), "{stderr}");
        let is_refused = stderr.contains("rows.jsonl is being written by process ");
        assert_eq!(is_refused, expected == 4, "{stderr}");
        drop(file);
        assert_eq!(play(parent, options).0, Some(1));
    }
    assert_eq!(results(&swept), undisturbed);
}

#[test]
fn what_is_missing_in_a_folder_is_written_again_and_what_is_stale_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let swept = whole(folder.path(), &path);
    let undisturbed = results(&swept);
    let (scenario, course) = (swept.join("scenario.toml"), swept.join("course.csv"));
    let stale = swept.join("failing/case-1-0123456789abcdef.toml");
    for damage in [&|| fs::write(&scenario, "").unwrap(), &|| {
        fs::remove_file(&scenario).unwrap()
    }] as [&dyn Fn(); 2]
    {
        damage();
        fs::remove_file(&course).unwrap();
        fs::write(&stale, "of another canrig").unwrap();
        let mut again = canrig(&folder.path().join("whole"), "sweep");
        let (code, _, stderr) = output(again.arg(&path).arg("--quiet"));
        assert_eq!((code, stderr.as_str()), (Some(1), ""));
        let read = |path: &Path| fs::read(path).unwrap();
        assert_eq!(read(&scenario), read(&path));
        assert_eq!(read(&course), read(&folder.path().join("course.csv")));
        assert!(!stale.exists());
        assert_eq!(results(&swept), undisturbed);
    }
}

fn wait_until(child: &mut Child, condition: impl Fn() -> bool) {
    for _ in 0..6000 {
        if condition() || child.try_wait().unwrap().is_some() {
            return;
        }
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn parts_together_are_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let undisturbed = results(&whole(folder.path(), &path));
    let parts = folder.path().join("parts");
    for part in ["1/3", "2/3", "3/3"] {
        let (code, _, stderr) = output(canrig(&parts, "sweep").arg(&path).args(["--shard", part]));
        assert_eq!(code, Some(1), "{stderr}");
    }
    let mut folders = runs(&parts);
    folders.sort();
    let merged = folder.path().join("merged");
    let merge = |folders: &[PathBuf]| output(canrig(&merged, "merge").args(folders));

    let (code, _, stderr) = merge(&[folder.path().to_owned()]);
    assert_eq!(code, Some(3), "{stderr}");
    assert!(stderr.contains("is not the folder of a sweep"), "{stderr}");
    let (code, _, stderr) = merge(&folders[..2]);
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("20 of 60 cases are missing: 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, …"),
        "{stderr}"
    );
    let (code, stdout, stderr) = merge(&folders);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stdout.contains("60 runs: "), "{stdout}");
    assert_eq!(results(&only_run(&merged)), undisturbed);

    file(folder.path(), &SWEEP.replace("0.05", "0.06"));
    let other = folder.path().join("other");
    output(canrig(&other, "sweep").arg(&path).args(["--shard", "3/3"]));
    let (code, _, stderr) = merge(&[folders[0].clone(), folders[1].clone(), only_run(&other)]);
    assert_eq!(code, Some(3), "{stderr}");
    let message = format!(
        "{} has rows of another scenario.toml",
        only_run(&other).join("rows.jsonl").display()
    );
    assert!(stderr.contains(&message), "{stderr}");
}

#[test]
fn a_damaged_row_of_a_part_is_named_and_its_case_missing_until_it_is_played_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let parts = folder.path().join("parts");
    let play = |part: &str| {
        output(
            canrig(&parts, "sweep")
                .arg(&path)
                .args(["--shard", part, "--quiet"]),
        )
    };
    for part in ["1/2", "2/2"] {
        assert_eq!(play(part).0, Some(1));
    }
    let mut folders = runs(&parts);
    folders.sort();
    let rows = folders[0].join("rows.jsonl");
    let mut bytes = fs::read(&rows).unwrap();
    let last = bytes.len() - 10;
    bytes[last] ^= 1;
    fs::write(&rows, bytes).unwrap();
    let merged = folder.path().join("merged");
    let merge = || output(canrig(&merged, "merge").args(&folders).arg("--quiet"));
    let (code, _, stderr) = merge();
    assert_eq!(code, Some(3), "{stderr}");
    let line = format!("line 31 of {} is damaged", rows.display());
    assert!(
        stderr.contains(&line) && stderr.contains("1 of 60 cases are missing: 59."),
        "{stderr}"
    );
    assert!(!only_run(&merged).join("runs.csv").exists());
    assert_eq!(play("1/2").0, Some(1));
    assert_eq!(merge().0, Some(1));
    assert_eq!(
        results(&only_run(&merged)),
        results(&whole(folder.path(), &path))
    );
}

/// A value of the rig may change what frames mean, and whether they fit.
#[test]
fn a_case_means_what_the_scenario_does_with_its_values() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = |name: &str, key: &str, values: &str| {
        let list = format!("[sweep]\n\n[[sweep.list]]\nkey = \"{key}\"\nvalues = {values}\n");
        let path = file(folder.path(), &list);
        let runs = folder.path().join(name);
        let (_, stdout, stderr) = output(canrig(&runs, "sweep").arg(&path));
        assert!(stdout.contains("2 runs: "), "{stdout}{stderr}");
        let table = fs::read_to_string(only_run(&runs).join("runs.csv")).unwrap();
        let mut rows = table.lines().map(|row| row.split(',').map(str::to_owned));
        let column = |wanted: &str| {
            let mut names = table.lines().next().unwrap().split(',');
            names.position(|name| name == wanted).unwrap()
        };
        let columns = ["verdict", "current_amperes_rms", "reason"].map(column);
        rows.next();
        Vec::from_iter(rows.map(|row| {
            let cells = Vec::from_iter(row);
            columns.map(|column| cells[column].clone())
        }))
    };
    let rated = sweep("rated", "node.drive.amplifier.rated", "[1.0, 2.0]");
    let amperes = [0, 1].map(|case: usize| rated[case][1].parse::<f64>().unwrap());
    assert!((amperes[1] / amperes[0] - 1.0).abs() < 0.02, "{amperes:?}");
    let short = sweep("period", "bus.sync_period_milliseconds", "[1.0, 0.2]");
    let [fits, does_not] = &short[..] else {
        panic!("{short:?}")
    };
    assert_eq!((&*fits[0], &*does_not[0]), ("pass", "invalid"));
    assert!(
        does_not[2].contains("do not fit between two SYNCs"),
        "{short:?}"
    );
}

#[test]
fn a_case_that_fails_does_so_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let swept = whole(folder.path(), &file(folder.path(), SWEEP));
    let failing = swept.join("failing");
    let mut cases = runs(&failing);
    // The table that the scenarios name is in the same folder.
    cases.retain(|path| path.extension().is_some_and(|end| end == "toml"));
    cases.sort();
    let table = fs::read_to_string(swept.join("runs.csv")).unwrap();
    let mut table = csv::Reader::from_reader(table.as_bytes());
    let header = table.headers().unwrap().clone();
    let column = |name: &str| header.iter().position(|one| one == name).unwrap();
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 60);
    let failed = rows.iter().filter(|row| &row[column("verdict")] == "fail");
    assert_eq!(failed.count(), cases.len());
    assert!((1..60).contains(&cases.len()), "{cases:?}");

    let runs = folder.path().join("alone");
    let (code, stdout, _) = output(canrig(&runs, "simulate").arg(&cases[0]));
    assert_eq!(code, Some(1), "{stdout}");
    let verdict = fs::read_to_string(only_run(&runs).join("verdict.json")).unwrap();
    let verdict: serde_json::Value = serde_json::from_str(&verdict).unwrap();
    let name = cases[0].file_name().unwrap().to_str().unwrap();
    let number = name.split('-').nth(1).unwrap();
    let row = rows.iter().find(|row| &row[0] == number).unwrap();
    assert_eq!(name, format!("case-{number}-{}.toml", &row[column("id")]));
    assert_eq!(
        row[column("verdict")],
        *verdict["outcome"].as_str().unwrap()
    );
    assert_eq!(row[column("seed")], verdict["seed"].to_string());
    let metrics = verdict["metrics"].as_array().unwrap();
    assert!(metrics.iter().any(|metric| metric["name"] == FOLLOWS));
    for metric in metrics {
        let cell: f64 = row[column(metric["name"].as_str().unwrap())]
            .parse()
            .unwrap();
        assert_eq!(Some(cell), metric["value"].as_f64(), "{metric}");
    }
}

#[test]
fn what_cannot_be_swept_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output_folder = folder.path().join("runs");
    let sweep = |text: &str| {
        let path = file(folder.path(), text);
        output(canrig(&output_folder, "sweep").arg(path))
    };
    let (code, _, stderr) = sweep(&SWEEP.replace("load_kilograms", "lod_kilograms"));
    assert_eq!(code, Some(3));
    for text in [
        "did you mean `plant.wire.mechanics.load_kilograms`?",
        "swept.toml:27:29",
    ] {
        assert!(stderr.contains(text), "{text}: {stderr}");
    }
    let (code, _, stderr) = sweep("");
    assert_eq!(code, Some(3));
    assert!(stderr.contains("has no [sweep] table"), "{stderr}");
    assert!(!output_folder.exists());

    // Half of the draws are below the smallest load.
    let normal = "[sweep]\ndraws = 10\n[[sweep.normal]]\nkey = \"plant.wire.mechanics.load_kilograms\"\n\
        mean = 0.001\nstandard_deviation = 0.001\n";
    let (code, stdout, stderr) = sweep(normal);
    assert_eq!(code, Some(3), "{stdout}{stderr}");
    let table = fs::read_to_string(only_run(&output_folder).join("runs.csv")).unwrap();
    let invalid = table
        .lines()
        .find(|line| line.contains(",invalid,"))
        .unwrap();
    assert!(invalid.contains("is out of range"), "{invalid}");
    assert!(stdout.contains(" invalid"), "{stdout}");
}

#[test]
fn other_commands_play_the_scenario_as_it_stands() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let (code, stdout, stderr) = output(canrig(&folder.path().join("runs"), "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert!(stdout.contains("plays its 60 runs"), "{stdout}");
    let mut check = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, stdout, _) = output(check.arg("check").arg(&path));
    assert_eq!(code, Some(0));
    assert!(stdout.contains("swept, 60 runs in a sweep"), "{stdout}");
}

/// Plays a part as an engine does.
fn task(parts: &Path, path: &Path, variable: (&str, &str)) -> (Option<i32>, String, String) {
    let mut task = canrig(parts, "sweep");
    let options = [
        "--shard",
        "auto",
        "--shards",
        "3",
        "--for-engine",
        "--quiet",
    ];
    output(task.arg(path).args(options).env(variable.0, variable.1))
}

#[test]
fn tasks_of_any_engine_are_parts_and_results_are_success_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let undisturbed = results(&whole(folder.path(), &path));
    let parts = folder.path().join("parts");
    for variable in [
        ("SLURM_ARRAY_TASK_ID", "1"),
        ("HQ_TASK_ID", "2"),
        ("JOB_COMPLETION_INDEX", "2"),
        // When it is repeated, nothing is played.
        ("SLURM_ARRAY_TASK_ID", "1"),
    ] {
        let (code, stdout, stderr) = task(&parts, &path, variable);
        assert_eq!((code, stdout.as_str(), stderr.as_str()), (Some(0), "", ""));
    }
    let merged = folder.path().join("merged");
    let (code, _, stderr) = output(canrig(&merged, "merge").args(runs(&parts)));
    assert_eq!(code, Some(1), "{stderr}");
    assert_eq!(results(&only_run(&merged)), undisturbed);

    let (code, _, stderr) = task(&parts, &path, ("HQ_TASK_ID", "4"));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(stderr.contains("number the tasks from 1 to 3"), "{stderr}");
}

#[test]
fn a_plan_plays_some_runs_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), SWEEP);
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "sweep").arg(&path).arg("--plan"));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        stdout.contains("60 runs; 24 of them were played"),
        "{stdout}"
    );
    let last = stdout.lines().next_back().unwrap();
    assert!(
        last.starts_with("canrig submit ") && last.contains(" --parts 1 "),
        "{last}"
    );
    assert!(!runs.exists());
    // The named command can be submitted.
    let arguments = last.split(' ').skip(2);
    let (code, stdout, stderr) = output(canrig(&runs, "submit").args(arguments).arg("--dry-run"));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stdout.contains("#SBATCH --array=1\n"), "{stdout}");
    assert!(!runs.exists());
}

#[test]
fn torture_in_parts_is_shrunk_when_it_is_merged() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), "");
    let parts = folder.path().join("parts");
    for part in ["1/2", "2/2"] {
        let mut torture = canrig(&parts, "torture");
        let options = ["--runs", "6", "--shard", part, "--for-engine"];
        let (code, stdout, stderr) = output(torture.arg(&path).args(options));
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        assert!(stdout.contains("3 runs with seed 1: "), "{stdout}");
    }
    let merged = folder.path().join("merged");
    let (code, stdout, stderr) = output(canrig(&merged, "merge").args(runs(&parts)));
    assert!(matches!(code, Some(0 | 1)), "{stdout}{stderr}");
    assert!(stdout.contains("6 runs: "), "{stdout}");
    let folders = runs(&merged);
    let torture = folders
        .iter()
        .find(|path| path.join("torture.json").exists());
    let table = fs::read_to_string(torture.unwrap().join("runs.csv")).unwrap();
    assert!(table.starts_with("case,id,bus.lose,"), "{table}");
    assert_eq!(table.lines().count(), 7);
}
