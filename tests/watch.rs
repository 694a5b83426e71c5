//! A watched scenario is played again at each change.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};

use crate::real_time::Started;
use crate::support::{runs, scenario};

/// `timeout` ends what waits for ever.
fn watching(path: &Path, folder: &Path) -> Child {
    let mut timeout = Command::new("timeout");
    timeout.arg("100").arg(env!("CARGO_BIN_EXE_canrig"));
    timeout
        .args(["simulate", "--watch", "--output"])
        .arg(folder)
        .arg(path);
    timeout
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

#[test]
fn a_watched_scenario_has_a_line_for_each_play_and_one_run_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("watched.toml");
    let text = fs::read_to_string(scenario("motor_step.toml")).unwrap();
    fs::write(&path, &text).unwrap();
    let output = folder.path().join("runs");
    let mut child = watching(&path, &output);
    let pid = Pid::from_child(&child);
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let child = Started::new(child);
    let mut play = |number: u32| {
        let start = format!("play {number}: ");
        let mut lines = lines.by_ref().map(Result::unwrap);
        let line = lines.find(|line| line.starts_with("play ")).unwrap();
        line.strip_prefix(&start)
            .unwrap_or_else(|| panic!("{line}"))
            .to_owned()
    };
    let first = play(1);
    assert!(
        first.starts_with("pass · settling_time_seconds 0.2380 · "),
        "{first}"
    );
    let stricter = text.replace("{ max = 0.2 }", "{ max = 0.001 }");
    assert_ne!(stricter, text);
    fs::write(&path, &stricter).unwrap();
    assert_eq!(play(2), "FAIL · overshoot_percent 0.0160 (limit ≤ 0.001)");
    // An invalid file is no play, and the next change of it is one.
    fs::write(&path, "schema = 7\n").unwrap();
    fs::write(&path, text + "\n").unwrap();
    assert!(play(3).starts_with("pass · "));
    kill_process(pid, Signal::INT).unwrap();
    let ended = child.ended();
    assert_eq!(ended.status.code(), Some(0));
    let page = fs::read_to_string(output.join("watch.html")).unwrap();
    assert_eq!(page.matches("http-equiv=\"refresh\"").count(), 1);
    assert!(page.contains("DC motor: 25 mm step"));
    // Beside the page there is the run folder of the last play, or that of the play before if the
    // end came between.
    let folders = runs(&output).into_iter().filter(|path| path.is_dir());
    assert!((1..=2).contains(&folders.count()));
}
