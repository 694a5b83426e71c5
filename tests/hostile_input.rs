//! Foreign input and output: things that are not files, damaged files, full outputs, signals, and text that controls
//! a terminal.

use std::fs::{self, File};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

use crate::real_time::soon;
use crate::support::{canrig, only_run, output, short_scenario};

fn bare(arguments: &[&str]) -> Command {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.args(arguments).env("NO_COLOR", "1");
    canrig
}

fn make_pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// Simulates a short run in a folder.
fn simulated(folder: &Path) -> PathBuf {
    let runs = folder.join("runs");
    let scenario = short_scenario(folder, 0.3);
    let (code, _, stderr) = output(canrig(&runs, "simulate").arg(scenario));
    assert_eq!(code, Some(0), "{stderr}");
    only_run(&runs)
}

#[test]
fn what_is_no_file_is_refused_wherever_a_file_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    for name in ["scenario.toml", "bus.log", "frames.dbc", "verdict.json"] {
        let path = run.join(name);
        let kept = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        make_pipe(&path);
        let (code, _, stderr) = soon(bare(&["replay"]).arg(&run));
        assert_eq!(code, Some(3), "{name}: {stderr}");
        assert!(
            stderr.contains("it is a pipe, not a file"),
            "{name}: {stderr}"
        );
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        let (code, _, stderr) = soon(bare(&["report"]).arg(&run));
        assert_eq!(code, Some(3), "{name}: {stderr}");
        assert!(
            stderr.contains("it is a folder, not a file"),
            "{name}: {stderr}"
        );
        fs::remove_dir(&path).unwrap();
        fs::write(&path, kept).unwrap();
    }
    let pipe = folder.path().join("pipe");
    make_pipe(&pipe);
    let path = pipe.to_str().unwrap();
    let run = run.to_str().unwrap();
    let commands: [(&[&str], i32); 9] = [
        (&["check", path], 3),
        (&["simulate", path], 3),
        (&["check", "/dev/zero"], 3),
        (&["fmu", path], 3),
        (&["replay", path, "--scenario", path], 3),
        (&["coverage", run, "--requirements", path], 3),
        (&["identify", run, "--dbc", path], 2),
        (
            &[
                "sdo", "read", "16", "0x1000", "--bus", "embedded", "--eds", path,
            ],
            2,
        ),
        (&["run", &format!("{run}/scenario.toml"), "--rig", path], 3),
    ];
    for (command, expected) in commands {
        let (code, _, stderr) = soon(&mut bare(command));
        assert_eq!(code, Some(expected), "{command:?}: {stderr}");
        let words = stderr.split_whitespace().filter(|word| *word != "│");
        let one_line = words.collect::<Vec<_>>().join(" ");
        assert!(one_line.contains("not a file"), "{command:?}: {stderr}");
    }
}

/// Replaces a file by a link to a foreign file; returns the target.
fn link_out(path: &Path, elsewhere: &Path) -> PathBuf {
    let theirs = elsewhere.join(path.file_name().unwrap());
    if path.exists() {
        fs::rename(path, &theirs).unwrap();
    } else {
        fs::write(&theirs, "theirs").unwrap();
    }
    symlink(&theirs, path).unwrap();
    theirs
}

#[test]
fn what_a_folder_from_elsewhere_links_to_is_neither_quoted_nor_judged() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    let elsewhere = folder.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    let page = folder.path().join("page.html");
    let page = page.to_str().unwrap();
    let path = run.to_str().unwrap();
    let commands: [&[&str]; 7] = [
        &["report", path, "--output", page],
        &["replay", path],
        &["export", path, "--format", "csv"],
        &["compare", path, path],
        &["coverage", path, "--output", page],
        &["signals", path],
        &["identify", path],
    ];
    // A command need not refuse a file that it does not read.
    let needed = ["scenario.toml", "frames.dbc"];
    let optional = ["verdict.json", "bus.log", "stalls.csv", "played.json"];
    for name in needed.into_iter().chain(optional) {
        let was_there = run.join(name).exists();
        let theirs = link_out(&run.join(name), &elsewhere);
        let theirs_name = theirs.display();
        let reason = format!("it is a link that leads out of its folder, to {theirs_name}");
        let mut refused = 0;
        for arguments in commands {
            let (code, stdout, stderr) = output(&mut bare(arguments));
            let is_refused = stderr.contains(&reason);
            let is_named = ["` cannot be ", " cannot be "]
                .iter()
                .any(|end| stderr.contains(&format!("{name}{end}")));
            assert!(
                !is_refused || is_named && code == Some(3) && stdout.is_empty(),
                "{name} {arguments:?}: {code:?} {stdout}{stderr}"
            );
            refused += usize::from(is_refused);
            assert!(
                is_refused || !needed.contains(&name),
                "{name} {arguments:?}: {stderr}"
            );
        }
        assert!(refused > 0, "{name}");
        assert!(
            !Path::new(page).exists() || !needed.contains(&name),
            "{name}"
        );
        fs::remove_file(run.join(name)).unwrap();
        if was_there {
            fs::rename(theirs, run.join(name)).unwrap();
        }
    }
    // The run itself may be named by a link, and a log as well.
    let link = folder.path().join("link");
    symlink(&run, &link).unwrap();
    assert_eq!(output(bare(&["replay"]).arg(&link)).0, Some(0));
    let log = folder.path().join("log");
    symlink(run.join("bus.log"), &log).unwrap();
    let scenario = run.join("scenario.toml");
    let mut replay = bare(&["replay"]);
    let replay = replay.arg(&log).arg("--scenario").arg(scenario);
    assert_eq!(output(replay).0, Some(0));
}

#[test]
fn a_page_in_a_folder_from_elsewhere_takes_the_place_of_a_link_and_not_of_its_target() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    let elsewhere = folder.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    let page = run.join("report.html");
    let was = fs::read(&page).unwrap();
    fs::remove_file(&page).unwrap();
    let theirs = link_out(&page, &elsewhere);
    let (code, _, stderr) = output(bare(&["report"]).arg(&run));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(!page.is_symlink() && fs::read(&page).unwrap() == was);
    assert_eq!(fs::read(theirs).unwrap(), b"theirs");
}

#[test]
fn a_sweep_writes_through_no_link() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    let scenario = short_scenario(folder.path(), 0.3);
    let text = fs::read_to_string(&scenario).unwrap();
    let text = text
        + "[expect]\nposition_millimetres_max = { max = 1.0 }\n\
           [sweep]\n[[sweep.list]]\nkey = \"seed\"\nvalues = [1, 2]\n";
    fs::write(&scenario, text).unwrap();
    let sweep = || output(canrig(&runs, "sweep").arg(&scenario));
    let (code, _, stderr) = sweep();
    assert_eq!(code, Some(1), "{stderr}");
    let swept = only_run(&runs);
    let elsewhere = folder.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    let written = ["report.html", "runs.csv", "runs.parquet", "scenario.toml"];
    for name in written {
        let path = swept.join(name);
        let was = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        let theirs = link_out(&path, &elsewhere);
        let (code, _, stderr) = sweep();
        assert_eq!(code, Some(1), "{name}: {stderr}");
        assert!(
            !path.is_symlink() && fs::read(&path).unwrap() == was,
            "{name}"
        );
        assert_eq!(fs::read(theirs).unwrap(), b"theirs", "{name}");
    }
    // A file to continue, and a folder, are refused, not replaced.
    for name in ["rows.jsonl", "failing"] {
        let path = swept.join(name);
        let theirs = link_out(&path, &elsewhere);
        let theirs_before = fs::metadata(&theirs).unwrap().modified().unwrap();
        let (code, _, stderr) = sweep();
        assert_eq!(code, Some(4), "{name}: {stderr}");
        let reason = format!(
            "it is a link that leads out of its folder, to {}",
            theirs.display()
        );
        assert!(
            stderr.contains(name) && stderr.contains(&reason),
            "{stderr}"
        );
        let theirs_after = fs::metadata(&theirs).unwrap().modified().unwrap();
        assert_eq!(theirs_before, theirs_after, "{name}");
        let (code, _, stderr) = output(bare(&["coverage"]).arg(&swept));
        let expected = if name == "rows.jsonl" { 3 } else { 0 };
        assert_eq!(code, Some(expected), "{name}: {stderr}");
        fs::remove_file(&path).unwrap();
        fs::rename(theirs, path).unwrap();
    }
    assert_eq!(sweep().0, Some(1));
}

#[test]
fn a_damaged_verdict_is_named_by_every_command_that_reads_it() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    let path = run.join("verdict.json");
    let whole = fs::read(&path).unwrap();
    let mut flipped = whole.clone();
    flipped[2] ^= 0x80;
    for damaged in [&whole[..whole.len() / 2], b"{}", b"", &flipped] {
        fs::write(&path, damaged).unwrap();
        for command in ["replay", "report", "coverage", "export", "compare"] {
            let mut arguments = bare(&[command]);
            arguments.arg(&run);
            match command {
                "compare" => arguments.arg(&run),
                "export" => arguments.args(["--format", "csv"]),
                _ => &mut arguments,
            };
            let (code, _, stderr) = output(&mut arguments);
            assert_eq!(code, Some(3), "{command}: {stderr}");
            assert!(
                stderr.contains("verdict.json` is damaged"),
                "{command}: {stderr}"
            );
        }
    }
    fs::remove_file(&path).unwrap();
    let (code, stdout, _) = output(bare(&["replay"]).arg(&run));
    assert_eq!(code, Some(4), "{stdout}");
}

#[test]
fn output_that_cannot_be_written_is_no_success() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    let run = run.to_str().unwrap();
    let commands: [&[&str]; 6] = [
        &["--help"],
        &["schema"],
        &["signals"],
        &["replay", run],
        &["export", run, "--format", "csv"],
        &["completions", "bash"],
    ];
    for arguments in commands {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = bare(arguments).stdout(full).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(4), "{arguments:?}: {stderr}");
        assert!(
            stderr.contains("No space left on device"),
            "{arguments:?}: {stderr}"
        );
    }
    let export = |place: &str| {
        output(&mut bare(&[
            "export", run, "--format", "csv", "--output", place,
        ]))
    };
    let (code, _, stderr) = export("/dev/full");
    assert_eq!(code, Some(4), "{stderr}");
    assert!(stderr.contains("/dev/full` cannot be written"), "{stderr}");
    assert_eq!(export("/dev/null").0, Some(0));
    assert!(!fs::metadata("/dev/null").unwrap().is_file());
    // A link stays a link.
    let (link, target) = (folder.path().join("link"), folder.path().join("target"));
    fs::write(&target, "old").unwrap();
    symlink(&target, &link).unwrap();
    assert_eq!(export(link.to_str().unwrap()).0, Some(0));
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert!(fs::read_to_string(&target).unwrap().starts_with("cycle,"));
    let mut reader = bare(&["signals"]).stdout(Stdio::piped()).spawn().unwrap();
    drop(reader.stdout.take());
    assert_eq!(reader.wait().unwrap().code(), Some(0));
}

/// Returns the program with a limit on the size of files, in kilobytes.
fn limited(kilobytes: u32, arguments: &[&str]) -> Command {
    let mut bash = Command::new("bash");
    bash.args(["-c", &format!("ulimit -f {kilobytes}; exec \"$@\""), "-"]);
    bash.arg(env!("CARGO_BIN_EXE_canrig")).args(arguments);
    bash
}

#[test]
fn a_limit_on_files_is_an_error_and_what_is_not_whole_is_partial() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = short_scenario(folder.path(), 1.0);
    let runs = folder.path().join("runs");
    // The limit is less than bus.log, and more than the files before the run.
    let mut simulate = limited(120, &["simulate"]);
    let simulate = simulate.arg("--output").arg(&runs).arg(scenario);
    let (code, _, stderr) = output(simulate);
    assert_eq!(code, Some(4), "{stderr}");
    assert!(stderr.contains("File too large"), "{stderr}");
    let run = only_run(&runs);
    let verdict = fs::read_to_string(run.join("verdict.json")).unwrap();
    assert!(verdict.contains("\"incomplete\""), "{verdict}");
    for name in ["signals.csv", "report.html", "run.rrd"] {
        assert!(!run.join(name).exists(), "{name}");
    }
}

/// The recording is the largest file, and is completed last.
#[test]
fn a_run_whose_recording_cannot_be_written_says_nowhere_that_it_passed() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = short_scenario(folder.path(), 1.0);
    let runs = folder.path().join("runs");
    let mut simulate = limited(500, &["simulate"]);
    let simulate = simulate.arg("--output").arg(&runs).arg(scenario);
    let (code, _, stderr) = output(simulate);
    assert_eq!(code, Some(4), "{stderr}");
    let run = only_run(&runs);
    let message = format!("{} cannot be made: ", run.join("run.rrd").display());
    assert!(stderr.contains(&message), "{stderr}");
    assert!(run.join("signals.csv").exists());
    for name in ["junit.xml", "report.html", "run.rrd"] {
        assert!(!run.join(name).exists(), "{name}");
    }
}

/// These commands begin quickly, and take some time to write.
#[test]
fn a_signal_leaves_nothing_half_written() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("sma.fmu");
    let partial = place.with_added_extension("partial");
    for signal in [Signal::INT, Signal::TERM] {
        let mut export = bare(&["fmu", "--export", "sma", "--output"]);
        let mut export = export.arg(&place).spawn().unwrap();
        // On a busy machine the command may have ended before the check.
        let mut ended = None;
        while ended.is_none() && !partial.exists() {
            ended = export.try_wait().unwrap();
        }
        if ended.is_none() {
            kill_process(Pid::from_child(&export), signal).unwrap();
        }
        let code = export.wait().unwrap().code();
        assert!(matches!(code, Some(0 | 130)), "{code:?}");
        assert_eq!(place.exists(), code == Some(0));
        assert!(!partial.exists());
        let _ = fs::remove_file(&place);
    }
}

#[test]
fn an_fmu_that_the_disk_does_not_take_is_named_and_nothing_else_is_printed() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("sma.fmu");
    let mut export = limited(10, &["fmu", "--export", "sma", "--output"]);
    let (code, stdout, stderr) = output(export.arg(&place));
    assert_eq!(code, Some(4), "{stderr}");
    assert_eq!(
        (stdout.as_str(), stderr.lines().count()),
        ("", 1),
        "{stderr}"
    );
    assert!(stderr.contains("sma.fmu` cannot be written"), "{stderr}");
    assert!(!place.exists());
}

/// These pipes have no writer: a reader would wait for ever.
#[test]
fn a_pipe_in_the_place_of_a_file_of_a_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    let page = run.join("report.html");
    fs::remove_file(&page).unwrap();
    make_pipe(&page);
    let (code, _, stderr) = soon(bare(&["report"]).arg(&run));
    assert_eq!(code, Some(4), "{stderr}");
    assert!(stderr.contains("it is a pipe, not a file"), "{stderr}");
    fs::remove_file(&page).unwrap();
    let scenario = folder.path().join("sweep.toml");
    let text = fs::read_to_string(run.join("scenario.toml")).unwrap();
    let sweep =
        "\n[sweep]\nseed = 1\ndraws = 2\n\n[[sweep.uniform]]\nkey = \"seed\"\nfrom = 0\nto = 9\n";
    fs::write(&scenario, text + sweep).unwrap();
    let parent = folder.path().join("sweeps");
    let sweep = || {
        soon(
            bare(&["sweep", "--quiet", "--output"])
                .arg(&parent)
                .arg(&scenario),
        )
    };
    assert_eq!(sweep().0, Some(0));
    let sweep_folder = only_run(&parent);
    for name in ["runs.csv", "runs.parquet", "rows-2.jsonl"] {
        let path = sweep_folder.join(name);
        let _ = fs::remove_file(&path);
        make_pipe(&path);
        let (code, _, stderr) = sweep();
        assert_eq!(code, Some(4), "{name}: {stderr}");
        assert!(stderr.contains("it is a pipe, not a file"), "{stderr}");
        fs::remove_file(path).unwrap();
    }
    assert_eq!(sweep().0, Some(0));
}

#[test]
fn a_name_with_a_line_end_is_refused_on_the_command_line_and_where_a_folder_is_searched() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = short_scenario(folder.path(), 0.3);
    let named = folder.path().join("a\n::error::b.toml");
    fs::copy(&scenario, &named).unwrap();
    let commands = ["check", "simulate", "replay", "--no-such-option"];
    let named = commands.map(|command| output(bare(&[command]).arg(&named)));
    let searched = ["check", "simulate"].map(|word| output(bare(&[word]).arg(folder.path())));
    let named = named.into_iter().map(|output| (2, output));
    let searched = searched.into_iter().map(|output| (3, output));
    for (expected, (code, stdout, stderr)) in named.chain(searched) {
        assert_eq!(code, Some(expected), "{stderr}");
        let mut lines = stdout.lines().chain(stderr.lines());
        assert!(!lines.any(|line| line.starts_with("::")), "{stderr}");
        assert!(stderr.contains("rename"), "{stderr}");
    }
}

/// Commands that do not play end at once.
#[test]
fn a_signal_ends_every_command_with_the_code_of_signals() {
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    let pipe = folder.path().join("pipe");
    make_pipe(&pipe);
    for signal in [Signal::INT, Signal::TERM, Signal::HUP, Signal::QUIT] {
        // The command waits for a reader of the pipe.
        let mut env = Command::new("env");
        env.arg("--default-signal=INT,HUP,QUIT")
            .arg(env!("CARGO_BIN_EXE_canrig"))
            .args(["export", "--format", "csv", "--output"])
            .args([&pipe, &run]);
        let mut export = env.spawn().unwrap();
        let waits = || {
            let stack = fs::read_to_string(format!("/proc/{}/wchan", export.id()));
            stack.is_ok_and(|place| place.contains("wait_for_partner"))
        };
        for _ in 0..500 {
            if waits() {
                break;
            }
            thread::sleep(Duration::from_millis(10));
        }
        kill_process(Pid::from_child(&export), signal).unwrap();
        assert_eq!(export.wait().unwrap().code(), Some(130), "{signal:?}");
    }
}

/// Starts a simulation, sends it a signal once it records, and waits for its end. Returns its exit code, and whether
/// its verdict is that of a whole run.
fn signalled(shell: &str, signal: Signal, duration_seconds: f64) -> (Option<i32>, bool) {
    let folder = tempfile::tempdir().unwrap();
    let scenario = short_scenario(folder.path(), duration_seconds);
    let runs = folder.path().join("runs");
    // The caller of the tests may have signals ignored.
    let mut sh = Command::new("env");
    sh.args(["--default-signal=INT,HUP,QUIT", "sh"]);
    sh.args(["-c", &format!("{shell} exec \"$@\""), "-"]);
    sh.arg(env!("CARGO_BIN_EXE_canrig")).arg("simulate");
    sh.arg("--output")
        .arg(&runs)
        .arg(scenario)
        .stdout(Stdio::null());
    let mut run = sh.stderr(Stdio::null()).spawn().unwrap();
    let is_recording = || {
        let run = fs::read_dir(&runs).ok()?.next()?.ok()?.path();
        let log = fs::metadata(run.join("bus.log")).ok()?;
        (log.len() > 0).then_some(())
    };
    while is_recording().is_none() && run.try_wait().unwrap().is_none() {
        thread::sleep(Duration::from_millis(2));
    }
    kill_process(Pid::from_child(&run), signal).unwrap();
    let code = run.wait().unwrap().code();
    let folder = only_run(&runs);
    let verdict = fs::read_to_string(folder.join("verdict.json")).unwrap();
    for name in ["signals.csv", "junit.xml", "report.html"] {
        assert!(folder.join(name).exists(), "{name} is missing");
    }
    (code, verdict.contains("\"pass\""))
}

#[test]
fn every_signal_that_ends_a_program_ends_a_run_in_order() {
    for signal in [Signal::INT, Signal::TERM, Signal::HUP, Signal::QUIT] {
        assert_eq!(
            signalled("", signal, 300.0),
            (Some(130), false),
            "{signal:?}"
        );
    }
}

/// Starts two scenarios of these durations, and sends a signal once the runs below a folder meet a condition; returns
/// the exit code.
fn signalled_in_two(
    folder: &Path,
    durations_seconds: [f64; 2],
    is_reached: impl Fn(&[PathBuf]) -> bool,
) -> Option<i32> {
    let runs = folder.join("runs");
    let short = short_scenario(folder, 0.3);
    let text = fs::read_to_string(&short).unwrap();
    let scenarios = ["first", "second"].map(|name| folder.join(name).with_extension("toml"));
    for (path, seconds) in scenarios.iter().zip(durations_seconds) {
        let duration = format!("duration_seconds = {seconds:?}");
        fs::write(path, text.replace("duration_seconds = 0.3", &duration)).unwrap();
    }
    let mut env = Command::new("env");
    env.arg("--default-signal=INT,HUP,QUIT")
        .arg(env!("CARGO_BIN_EXE_canrig"))
        .args(["simulate", "--quiet", "--output"])
        .arg(&runs)
        .args(scenarios);
    let mut both = env.spawn().unwrap();
    let folders = || {
        let folders = fs::read_dir(&runs).into_iter().flatten().flatten();
        Vec::from_iter(folders.map(|run| run.path()))
    };
    while !is_reached(&folders()) && both.try_wait().unwrap().is_none() {
        thread::sleep(Duration::from_millis(2));
    }
    kill_process(Pid::from_child(&both), Signal::TERM).unwrap();
    both.wait().unwrap().code()
}

#[test]
fn a_signal_in_the_second_of_two_scenarios_ends_it_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let is_recorded = |run: &&PathBuf| {
        let log = fs::metadata(run.join("bus.log"));
        log.is_ok_and(|log| log.len() > 0)
    };
    let are_both_recorded = |runs: &[PathBuf]| runs.iter().filter(is_recorded).count() == 2;
    let code = signalled_in_two(folder.path(), [0.3, 300.0], are_both_recorded);
    assert_eq!(code, Some(130));
    for run in fs::read_dir(folder.path().join("runs")).unwrap() {
        assert!(run.unwrap().path().join("report.html").exists());
    }
}

/// The played part is judged completely, and the next scenario is not played.
#[test]
fn a_signal_while_the_first_of_two_scenarios_is_judged_ends_both() {
    let folder = tempfile::tempdir().unwrap();
    let is_judged = |runs: &[PathBuf]| {
        let mut tables = runs.iter().map(|run| run.join("signals.csv"));
        tables.any(|table| table.exists() || table.with_added_extension("partial").exists())
    };
    let code = signalled_in_two(folder.path(), [100.0, 0.3], is_judged);
    assert_eq!(code, Some(130));
    let run = only_run(&folder.path().join("runs"));
    let verdict = fs::read_to_string(run.join("verdict.json")).unwrap();
    assert!(verdict.contains("\"pass\""), "{verdict}");
}

#[test]
fn an_ignored_hang_up_stays_ignored() {
    let ended = signalled("trap '' HUP;", Signal::HUP, 20.0);
    assert_eq!(ended, (Some(0), true));
}

/// Returns whether a text would control a terminal.
fn steers(text: &str) -> bool {
    let is_bidi = |character: char| matches!(character, '\u{200e}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let is_steering = |character: char| {
        is_bidi(character)
            || matches!(character, '\u{200b}' | '\u{e0041}')
            || character.is_control() && !matches!(character, '\n' | '\t')
    };
    text.contains(is_steering)
}

#[test]
fn no_text_of_somebody_else_steers_the_terminal() {
    const EVIL: &str = "\u{1b}]0;title\u{7}\u{1b}[31m\u{202e}\u{9b}2J\u{200b}\u{e0041}";
    let folder = tempfile::tempdir().unwrap();
    let run = simulated(folder.path());
    let evil = folder.path().join(format!("{EVIL}.toml"));
    let good = fs::read_to_string(run.join("scenario.toml")).unwrap();
    let check = |text: &str| {
        fs::write(&evil, text).unwrap();
        output(bare(&["check"]).arg(&evil))
    };
    let mut outputs = vec![
        check(&good),
        check(&format!("{EVIL}\n{good}")),
        check(&format!("{good}# {EVIL}\n[nothing]\n")),
        check(&good.replace("\"short\"", "\"a\u{202e}b\"")),
        output(bare(&["check", "none"]).arg(EVIL)),
        output(&mut bare(&[EVIL])),
        output(
            bare(&["simulate", "--output"])
                .arg(folder.path().join(EVIL))
                .arg(&evil),
        ),
        output(&mut bare(&["run", "--bus", EVIL, "x.toml"])),
        output(&mut bare(&["run", "--clock", EVIL, "x.toml"])),
    ];
    // Colours are not requested by an option, but enabled.
    let mut coloured = bare(&["check"]);
    coloured
        .env_remove("NO_COLOR")
        .env("FORCE_COLOR", "1")
        .env("CLICOLOR_FORCE", "1");
    fs::write(&evil, format!("{EVIL}\n")).unwrap();
    outputs.push(output(coloured.arg(&evil)));
    let log = run.join("bus.log");
    let frames = fs::read_to_string(&log).unwrap();
    let middle = frames.len() / 2 + frames[frames.len() / 2..].find('\n').unwrap() + 1;
    let (before, after) = frames.split_at(middle);
    fs::write(&log, format!("{before}{EVIL}\n{after}")).unwrap();
    outputs.push(output(bare(&["replay"]).arg(&run)));
    outputs.push(output(bare(&["replay", "--json"]).arg(&run)));
    for (code, stdout, stderr) in &outputs {
        assert!(
            !steers(stdout) && !steers(stderr),
            "{code:?} {stdout:?} {stderr:?}"
        );
    }
    let shown = outputs
        .iter()
        .filter(|(_, stdout, stderr)| format!("{stdout}{stderr}").contains("\\u001b"));
    assert!(shown.count() >= 8, "{outputs:?}");
    let json: serde_json::Value = serde_json::from_str(&outputs.last().unwrap().1).unwrap();
    assert_eq!(json["scenario"], "short");
}
