//! Output for the Rerun viewer: the same file for the same run, and no delay of a run.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::time::Duration;

use re_sdk::external::re_log_encoding::Decoder;
use re_sdk::log::{Chunk, LogMsg};

use crate::real_time::{in_real_time, soon};
use crate::support::{canrig, only_run, output, scenario, short_scenario};

/// Returns the chunks of a recording by entity, sorted, without the random numbers of chunks and rows.
fn decoded(run: &Path) -> BTreeMap<String, Vec<String>> {
    let file = BufReader::new(File::open(run.join("run.rrd")).unwrap());
    let mut entities: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for message in Decoder::<LogMsg>::decode_eager(file).unwrap() {
        let LogMsg::ArrowMsg(_, message) = message.unwrap() else {
            continue;
        };
        let chunk = Chunk::from_arrow_msg(&message).unwrap();
        let times = chunk.timelines().values();
        let times: Vec<_> = times
            .map(|times| {
                (
                    times.timeline().name().to_string(),
                    times.times_raw().to_vec(),
                )
            })
            .collect();
        let columns: Vec<String> = chunk
            .components()
            .values()
            .map(|column| format!("{column:?}"))
            .collect();
        entities
            .entry(chunk.entity_path().to_string())
            .or_default()
            .push(format!("{times:?} {columns:?}"));
    }
    entities.values_mut().for_each(|chunks| chunks.sort());
    entities
}

fn played(folder: &Path, arguments: &[&str], scenario: &Path) -> PathBuf {
    let mut command = canrig(folder, arguments[0]);
    let (code, stdout, stderr) = soon(command.args(&arguments[1..]).arg(scenario));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    only_run(folder)
}

#[test]
fn two_runs_are_equal_recordings_once_decoded_in_one_process_or_three() {
    let folder = tempfile::tempdir().unwrap();
    let short = short_scenario(folder.path(), 1.0);
    let lockstep = ["run", "--bus", "embedded", "--clock", "lockstep"];
    let run =
        |name: &str, arguments| decoded(&played(&folder.path().join(name), arguments, &short));
    let first = run("first", &["simulate"]);
    assert!(first.len() > 30, "{:?}", first.keys());
    assert_eq!(run("second", &["simulate"]), first);
    assert_eq!(run("processes", &lockstep), first);
    let other = played(
        &folder.path().join("other"),
        &["simulate"],
        &scenario("fan.toml"),
    );
    assert_ne!(decoded(&other), first, "the comparison sees differences");
}

/// States of a viewer's address without a working viewer.
enum Viewer {
    /// There is no listener.
    Absent,
    /// The system accepts connections for it, and it reads nothing, as if it were stopped.
    Paused(TcpListener),
    /// It reads for a moment, and ends.
    Killed(std::thread::JoinHandle<()>),
}

impl Viewer {
    fn named(name: &str) -> (Self, String) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port().to_string();
        let viewer = match name {
            "paused" => Self::Paused(listener),
            "killed" => Self::Killed(std::thread::spawn(move || {
                // The first connection tests whether there is a listener.
                for _ in 0..2 {
                    let (mut connection, _) = listener.accept().unwrap();
                    connection
                        .set_read_timeout(Some(Duration::from_millis(50)))
                        .unwrap();
                    let _ = connection.read(&mut [0; 4096]);
                }
            })),
            _ => Self::Absent,
        };
        (viewer, port)
    }

    fn end(self) {
        match self {
            Self::Killed(thread) => thread.join().unwrap(),
            Self::Paused(listener) => drop(listener),
            Self::Absent => {}
        }
    }
}

/// Returns the files that a viewer must not change.
fn result(run: &Path) -> [Vec<u8>; 3] {
    ["bus.log", "signals.csv", "verdict.json"].map(|name| fs::read(run.join(name)).unwrap())
}

#[test]
fn an_absent_paused_or_killed_viewer_changes_no_byte_and_holds_up_no_end() {
    let folder = tempfile::tempdir().unwrap();
    let step = scenario("step.toml");
    let run = |name: &str, arguments: &[&str]| {
        let run = played(&folder.path().join(name), arguments, &step);
        assert!(run.join("run.rrd").exists());
        result(&run)
    };
    let alone = run("alone", &["simulate"]);
    for name in ["absent", "paused", "killed"] {
        let (viewer, port) = Viewer::named(name);
        assert!(
            run(name, &["simulate", "--rerun-connect", &port]) == alone,
            "a viewer that is {name} changes the run"
        );
        viewer.end();
    }
}

#[test]
fn in_real_time_a_paused_viewer_costs_no_frame_and_is_reported() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let short = short_scenario(folder.path(), 2.0);
        let (viewer, port) = Viewer::named("paused");
        let runs = folder.path().join("runs");
        let mut command = canrig(&runs, "run");
        let command = command.args(["--bus", "embedded", "--rerun-connect", &port]);
        let (code, stdout, stderr) = output(command.arg(short));
        // On a busy machine the timing may leave the result undecided; the program then reports it.
        assert!(matches!(code, Some(0 | 5)), "{code:?}\n{stdout}\n{stderr}");
        assert!(!stdout.contains("lost"), "{stdout}");
        assert!(stderr.contains("missed the end of the run"), "{stderr}");
        assert!(only_run(&runs).join("run.rrd").exists());
        viewer.end();
    });
}

#[test]
fn a_viewer_that_is_not_installed_comes_with_how_to_get_it() {
    let folder = tempfile::tempdir().unwrap();
    let short = short_scenario(folder.path(), 1.0);
    let mut command = canrig(&folder.path().join("runs"), "simulate");
    let (code, _, stderr) = output(
        command
            .arg("--viewer")
            .arg(short)
            .env("PATH", folder.path()),
    );
    assert_eq!(code, Some(0), "{stderr}");
    // An open viewer is used.
    let is_open = std::net::TcpStream::connect("127.0.0.1:9876").is_ok();
    assert!(
        is_open || stderr.contains("pip install rerun-sdk"),
        "{stderr}"
    );
}
