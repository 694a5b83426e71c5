//! Runs that are too long for memory, and for plain text on the disk.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use recording::frames::Log;

use crate::support::{self, canrig, only_run, output, scenario};

/// Largest memory of a process.
const KILOBYTES_MAX: u64 = 200_000;

fn tool(arguments: &[&str], paths: &[&Path]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    output(canrig.args(arguments).args(paths).env("NO_COLOR", "1"))
}

/// Simulates a scenario; its files are compressed if it lasts longer than `compress_above` seconds.
fn simulated(runs: &Path, scenario: &Path, compress_above: &str) -> PathBuf {
    let mut canrig = canrig(runs, "simulate");
    canrig.arg("--compress-above").arg(compress_above);
    let (code, text, error) = output(canrig.arg(scenario));
    assert_eq!(code, Some(0), "{text}{error}");
    only_run(runs)
}

/// Writes a sine of one second without limits.
fn sine(folder: &Path, duration_seconds: u32) -> PathBuf {
    let path = folder.join("sine.toml");
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"sine\"\nduration_seconds = {duration_seconds}.0\n\n[controller.sliding_mode]\n\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 25.0\n\n\
         [[reference.sine]]\nfrom_seconds = 5.0\ncentre_millimetres = 25.0\namplitude_millimetres = 10.0\nperiod_seconds = 5.0\n\n\
         [[expect.signal]]\nname = \"position_millimetres\"\nstays = {{ min = -1.0, max = 40.0 }}\n"
    );
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_long_run_is_compressed_and_says_what_a_short_one_says() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, long] = [("plain", "600"), ("long", "10")].map(|(name, seconds)| {
        let source = scenario("sine_5s.toml");
        simulated(&folder.path().join(name), &source, seconds)
    });
    let text = |run: &Path, name: &str| fs::read_to_string(run.join(name)).unwrap();
    for name in ["bus.log", "signals.csv"] {
        assert!(plain.join(name).exists() && !long.join(name).exists());
    }
    assert_eq!(text(&plain, "verdict.json"), text(&long, "verdict.json"));
    let log = Log::read(&long.join("bus.log.zst")).unwrap();
    let mut lines = String::new();
    log.frames
        .iter()
        .for_each(|frame| frame.push_to(&mut lines));
    assert!(lines == text(&plain, "bus.log"));
    let signals = fs::read(long.join("signals.parquet")).unwrap();
    assert!(signals.starts_with(b"PAR1") && signals.ends_with(b"PAR1"));
    let size = |run: &Path, name: &str| fs::metadata(run.join(name)).unwrap().len();
    assert!(size(&plain, "bus.log") > 4 * size(&long, "bus.log.zst"));
    assert!(size(&plain, "signals.csv") > 2 * size(&long, "signals.parquet"));
    #[cfg(feature = "rerun")]
    assert!(size(&plain, "run.rrd") > 4 * size(&long, "run.rrd"));
    let page = text(&long, "report.html");
    assert!(page.contains("href=\"bus.log.zst\"") && page.contains("href=\"signals.parquet\""));

    let (code, replayed, error) = tool(&["replay"], &[&long]);
    assert_eq!(code, Some(0), "{replayed}{error}");
    assert!(
        replayed.contains("the same verdict as that of the run"),
        "{replayed}"
    );
    let (code, table, error) = tool(&["export", "--format=csv"], &[&long]);
    assert_eq!(code, Some(0), "{error}");
    assert!(table == text(&plain, "signals.csv"));
    let (code, compared, error) = tool(&["compare"], &[&plain, &long]);
    assert_eq!(code, Some(0), "{compared}{error}");
    let before = text(&long, "report.html");
    assert_eq!(tool(&["report"], &[&long]).0, Some(0));
    assert!(before == text(&long, "report.html"));
}

#[test]
fn a_long_run_that_was_killed_is_read_to_its_last_second() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let mut canrig = canrig(&runs, "simulate");
    let source = sine(folder.path(), 36_000);
    let canrig = canrig
        .arg(source)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let mut canrig = canrig.spawn().unwrap();
    let log = || {
        Some(
            fs::read_dir(&runs)
                .ok()?
                .next()?
                .ok()?
                .path()
                .join("bus.log.zst"),
        )
    };
    let bytes = || fs::metadata(log()?).ok().map(|log| log.len());
    while bytes().is_none_or(|bytes| bytes < 500_000) {
        std::thread::sleep(Duration::from_millis(10));
        assert_eq!(canrig.try_wait().unwrap(), None);
    }
    canrig.kill().unwrap();
    canrig.wait().unwrap();
    let read = Log::read(&log().unwrap()).unwrap();
    assert!(read.frames.len() > 20_000, "{}", read.frames.len());
    let (code, text, error) = tool(&["replay"], &[&only_run(&runs)]);
    assert_eq!(code, Some(4), "{text}{error}");
    assert!(text.contains("broke off"), "{text}");
    assert_eq!(tool(&["report"], &[&only_run(&runs)]).0, Some(0));
}

/// Starts a command, and calls `act` once a file exists; returns the exit code and the output.
fn meanwhile(command: &mut Command, file: &Path, act: impl FnOnce()) -> (Option<i32>, String) {
    let command = command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut process = command.spawn().unwrap();
    while !file.exists() {
        assert_eq!(process.try_wait().unwrap(), None, "{}", file.display());
        std::thread::sleep(Duration::from_millis(1));
    }
    act();
    let output = process.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), stderr)
}

/// Starts a command, and calls `act` while the command is blocked because its output is not read; returns the exit code
/// and the output.
fn held_up(command: &mut Command, act: impl FnOnce()) -> (Option<i32>, Vec<u8>, String) {
    let command = command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut process = command.spawn().unwrap();
    let mut stdout = process.stdout.take().unwrap();
    let mut text = vec![0];
    stdout.read_exact(&mut text).unwrap();
    act();
    stdout.read_to_end(&mut text).unwrap();
    let output = process.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), text, stderr)
}

/// Plays a run of two minutes; returns it with its compressed log.
fn with_long_log(folder: &Path) -> (PathBuf, PathBuf) {
    let source = sine(folder, 120);
    let run = simulated(&folder.join("runs"), &source, "10");
    let log = run.join("bus.log.zst");
    (run, log)
}

fn cut(log: &Path, bytes: usize) {
    let log = fs::File::options().write(true).open(log).unwrap();
    log.set_len(bytes as u64).unwrap();
}

#[test]
fn a_log_is_read_to_its_end_by_whoever_opened_it() {
    let folder = tempfile::tempdir().unwrap();
    let (run, log) = with_long_log(folder.path());
    let kept = fs::read(&log).unwrap();
    let export = |act: &dyn Fn()| {
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        held_up(canrig.args(["export", "--format", "asc"]).arg(&run), act)
    };
    let (code, removed, error) = export(&|| fs::remove_file(&log).unwrap());
    assert_eq!(code, Some(0), "{error}");
    fs::write(&log, &kept).unwrap();
    let (_, untouched, _) = export(&|| ());
    assert!(removed == untouched);
    // The cuts are before and after the place that is being read, and in between.
    for bytes in [0, 1000, kept.len() / 2, kept.len() - 1000] {
        fs::write(&log, &kept).unwrap();
        let (code, _, error) = export(&|| cut(&log, bytes));
        assert_eq!(code, Some(4), "{bytes}: {error}");
        let reason = "was changed while it was read";
        assert!(error.contains(reason), "{bytes}: {error}");
    }
}

/// It is random whether the log was cut before it was read again.
#[test]
fn a_log_that_is_cut_meanwhile_leaves_no_half_file() {
    let folder = tempfile::tempdir().unwrap();
    let (run, log) = with_long_log(folder.path());
    let output = folder.path().join("frames.blf");
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let canrig = canrig.args(["export", "--format", "blf", "--output"]);
    let partial = output.with_added_extension("partial");
    let canrig = canrig.arg(&output).arg(&run);
    let (code, error) = meanwhile(canrig, &partial, || cut(&log, 1000));
    assert!(matches!(code, Some(0 | 4)), "{error}");
    assert_eq!(output.exists(), code == Some(0), "{error}");
    assert!(!partial.exists());
}

#[test]
fn a_run_whose_folder_is_removed_has_no_verdict() {
    for (duration_seconds, log) in [(600, "bus.log"), (1200, "bus.log.zst")] {
        let folder = tempfile::tempdir().unwrap();
        let runs = folder.path().join("runs");
        let source = sine(folder.path(), duration_seconds);
        let mut simulate = canrig(&runs, "simulate");
        let simulate = simulate.args(["--compress-above", "1000"]).arg(source);
        let (code, stderr) = meanwhile(simulate, &runs, || {
            let is_logged = |runs: Vec<PathBuf>| runs.iter().any(|run| run.join(log).exists());
            while !is_logged(support::runs(&runs)) {}
            while fs::remove_dir_all(&runs).is_err() {}
        });
        assert_eq!(code, Some(4), "{stderr}");
        assert!(stderr.contains("removed or replaced"), "{stderr}");
        assert!(!runs.exists());
    }
}

/// With any damaged bit, missing data are not attributed to a node, and no value changes.
#[test]
fn a_damaged_long_run_is_not_judged() {
    let folder = tempfile::tempdir().unwrap();
    let source = scenario("sine_5s.toml");
    let run = simulated(&folder.path().join("runs"), &source, "10");
    let table = |run: &Path| {
        let (code, table, error) = tool(&["export", "--format=csv"], &[run]);
        assert_eq!(code, Some(0), "{error}");
        table
    };
    let whole_table = table(&run);
    let rows: std::collections::BTreeMap<&str, &str> = whole_table
        .lines()
        .filter_map(|line| line.split_once(','))
        .collect();
    let log = run.join("bus.log.zst");
    let whole = fs::read(&log).unwrap();
    for part in 1..8 {
        let mut bytes = whole.clone();
        bytes[whole.len() * part / 8] ^= 1 << (part % 8);
        fs::write(&log, bytes).unwrap();
        let (code, text, error) = tool(&["replay"], &[&run]);
        assert!(matches!(code, Some(4 | 5)), "{part}: {text}{error}");
        assert!(error.contains("are damaged: "), "{part}: {error}");
        let changed = table(&run);
        // A row without a position has the values that were sent before.
        let changed = changed.lines().filter_map(|line| line.split_once(','));
        let heard = changed.filter(|(_, row)| !row.contains(",,"));
        let others = heard.filter(|(cycle, row)| rows.get(cycle) != Some(row));
        assert!(others.count() < 20, "{part}");
    }
}

/// Returns the largest memory of a command, in kilobytes.
fn most_held(command: &mut Command) -> u64 {
    let mut process = command.stdout(Stdio::null()).spawn().unwrap();
    let status = format!("/proc/{}/status", process.id());
    let mut most = 0;
    while process.try_wait().unwrap().is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let held = line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse().ok());
        most = most.max(held.unwrap_or(0));
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(process.wait().unwrap().success());
    most
}

/// Five minutes would take 300 MB if everything were in memory.
#[test]
fn a_long_run_stays_out_of_memory() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let source = sine(folder.path(), 300);
    let mut simulate = canrig(&runs, "simulate");
    let simulated = most_held(simulate.args(["--compress-above", "10"]).arg(source));
    let run = only_run(&runs);
    let page = folder.path().join("page.html");
    let tool = |arguments: &[&str], paths: &[&Path]| {
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        most_held(canrig.args(arguments).args(paths))
    };
    let table = folder.path().join("signals");
    let export = |format: &str| tool(&["export", "--format", format, "--output"], &[&table, &run]);
    let held = [
        ("simulate", simulated),
        ("replay", tool(&["replay"], &[&run])),
        ("report", tool(&["report"], &[&run])),
        (
            "compare",
            tool(&["compare", "--output"], &[&page, &run, &run]),
        ),
        ("blf", export("blf")),
        ("mf4", export("mf4")),
        ("mcap", export("mcap")),
    ];
    for (command, kilobytes) in held {
        assert!(kilobytes < KILOBYTES_MAX, "{command}: {kilobytes} kB");
    }
    let bytes: u64 = fs::read_dir(&run)
        .unwrap()
        .map(|entry| entry.unwrap().metadata().unwrap().len())
        .sum();
    assert!(bytes < 1_000_000_000 / 12, "{bytes} bytes");
}
