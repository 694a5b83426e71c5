//! Virtual time: every scenario judged, and the same bytes in every world.

use std::fs;
use std::path::Path;
use std::time::Duration;

use platform::lockstep::Local;
use sha2::{Digest, Sha256};

use crate::support::{canrig, only_run, output, root, runs, scenario};

/// The files that must be the same to the byte.
const DETERMINED: [&str; 5] = [
    "bus.log",
    "signals.csv",
    "verdict.json",
    "junit.xml",
    "report.html",
];

fn contents(run: &Path) -> Vec<Vec<u8>> {
    DETERMINED
        .iter()
        .map(|name| fs::read(run.join(name)).unwrap())
        .collect()
}

/// Every scenario, and of each in the file of hashes the very bytes that the bus carried and that were decoded of it: who means
/// to leave the runs as they are leaves that file as it is. `UPDATE_SNAPSHOTS=1` writes it anew.
#[test]
fn every_shipped_scenario_passes_and_leaves_the_bytes_it_left_before() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) = output(
        canrig(folder.path(), "simulate")
            .arg(root().join("scenarios"))
            .arg("--json"),
    );
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    let verdicts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let verdicts = verdicts.as_array().unwrap();
    assert!(verdicts.len() >= 8, "{} verdicts", verdicts.len());
    for verdict in verdicts {
        assert_eq!(verdict["outcome"], "pass", "{verdict}");
    }
    let mut lines: Vec<_> = runs(folder.path()).iter().map(|run| line_of(run)).collect();
    lines.sort();
    let hashes = lines.concat();
    let path = root().join("tests/data/recordings.sha256");
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        fs::write(&path, &hashes).unwrap();
    }
    let committed = fs::read_to_string(&path).unwrap();
    let is_gone = |known: &&str| !hashes.lines().any(|line| line == *known);
    let changed: Vec<_> = committed.lines().filter(is_gone).collect();
    assert!(
        changed.is_empty(),
        "other bytes than in {changed:#?}, now:\n{hashes}"
    );
}

/// A run's scenario and the hashes of its recording.
fn line_of(run: &Path) -> String {
    let scenario = scenario::Scenario::load(&run.join("scenario.toml")).unwrap();
    let hash = |name: &str| {
        let digest = Sha256::digest(fs::read(run.join(name)).unwrap());
        digest
            .iter()
            .take(16)
            .map(|byte| format!("{byte:02x}"))
            .collect::<String>()
    };
    format!(
        "{} {}  {}\n",
        hash("bus.log"),
        hash("signals.csv"),
        scenario.name
    )
}

#[test]
fn one_process_twice_and_three_processes_leave_the_same_bytes() {
    let runs: Vec<_> = [
        ("simulate", None),
        ("simulate", None),
        ("run", Some("lockstep")),
    ]
    .into_iter()
    .map(|(command, clock)| {
        let folder = tempfile::tempdir().unwrap();
        let mut canrig = canrig(folder.path(), command);
        canrig.arg(scenario("step.toml"));
        if let Some(clock) = clock {
            canrig.args(["--clock", clock]);
        }
        let (code, stdout, stderr) = output(&mut canrig);
        assert_eq!(code, Some(0), "{stdout}\n{stderr}");
        contents(&only_run(folder.path()))
    })
    .collect();
    for run in &runs[1..] {
        for ((name, first), other) in DETERMINED.iter().zip(&runs[0]).zip(run) {
            assert!(first == other, "{name} differs");
        }
    }
}

#[test]
fn the_recording_alone_gives_the_same_verdict() {
    use canrig::{judge::judge, recording::read_log, timeline::decode};
    let folder = tempfile::tempdir().unwrap();
    let (code, ..) = output(canrig(folder.path(), "simulate").arg(scenario("fan.toml")));
    assert_eq!(code, Some(0));
    let run = only_run(folder.path());
    let log = fs::File::open(run.join("bus.log")).unwrap();
    let frames = read_log(std::io::BufReader::new(log)).unwrap();
    let scenario = scenario::Scenario::load(&run.join("scenario.toml")).unwrap();
    let timeline = decode(&frames, &scenario, dbc::Database::shipped()).unwrap();
    let verdict = judge(&timeline, &scenario, 0);
    assert_eq!(
        verdict.to_json(),
        fs::read_to_string(run.join("verdict.json")).unwrap()
    );
}

/// Controller and plant as the nodes promise nothing: asked at every event, never let ahead.
struct Asked<'a>(platform::lockstep::Local<'a>);

impl platform::lockstep::Participant for Asked<'_> {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn filters(&self) -> &[canopen::Filter] {
        self.0.filters()
    }

    fn silent_filters(&self) -> &[canopen::Filter] {
        &[]
    }

    fn meet(&mut self, _audience: &platform::lockstep::Audience) {}

    fn next_deadline(&self) -> Option<Duration> {
        self.0.next_deadline()
    }

    fn advance(
        &mut self,
        to: Duration,
        _until: Duration,
        frames: &[(Duration, canopen::CanFrame)],
        answer: &mut platform::lockstep::Answer,
    ) -> Result<(), platform::lockstep::LockstepError> {
        self.0.advance(to, to, frames, answer)
    }

    fn stop(
        &mut self,
        at: Duration,
        answer: &mut platform::lockstep::Answer,
    ) -> Result<(), platform::lockstep::LockstepError> {
        self.0.stop(at, answer)
    }
}

/// The proof of ARCHITECTURE.md, held to a run: late delivery and looking ahead change nothing.
#[test]
fn looking_ahead_leaves_the_bytes_of_asking_at_every_event() {
    use canrig::capture::Watch;
    use canrig::disturbance_node::DisturbanceProducer;
    use canrig::run::{Source, World, run};
    use canrig::world::lockstep::{Roles, play, simulate};
    let database = dbc::Database::shipped();
    for name in ["fan.toml", "step.toml"] {
        let source = Source::load(&scenario(name)).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let [ahead, asked] = ["ahead", "asked"].map(|name| folder.path().join(name));
        run(
            &source,
            &ahead,
            &Watch::default(),
            Vec::new(),
            |_, capture| simulate(&source.scenario, database, capture).map(World::in_virtual_time),
        )
        .unwrap();
        run(
            &source,
            &asked,
            &Watch::default(),
            Vec::new(),
            |_, capture| {
                let scenario = &source.scenario;
                let mut plant_emulator = canrig::nodes::plant_emulator(scenario).unwrap();
                let mut bench = DisturbanceProducer::new(scenario, database).unwrap();
                let mut controller =
                    canrig::nodes::controller(&scenario.controller_view(), None).unwrap();
                let roles = Roles {
                    plant_emulator: &mut Asked(Local::new("plant-emulator", &mut *plant_emulator)),
                    bench: &mut Asked(Local::new("bench", &mut bench)),
                    controller: &mut Asked(Local::new("controller", &mut controller)),
                };
                play(scenario, roles, capture, None).map(World::in_virtual_time)
            },
        )
        .unwrap();
        assert!(
            contents(&only_run(&ahead)) == contents(&only_run(&asked)),
            "{name}"
        );
    }
}

/// The determined files of a simulated scenario, with the C library's CPU features masked or not.
fn simulated(scenario: &Path, tunables: Option<&str>) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let mut canrig = canrig(folder.path(), "simulate");
    if let Some(tunables) = tunables {
        canrig.env("GLIBC_TUNABLES", tunables);
    }
    let (code, stdout, stderr) = output(canrig.arg(scenario));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    contents(&only_run(folder.path()))
}

/// glibc chooses its mathematical functions by the CPU; with FMA they give other bits.
#[test]
fn another_cpu_leaves_the_same_bytes() {
    let masked = "glibc.cpu.hwcaps=-FMA,-AVX2,-AVX512F,-FMA_Usable,-AVX2_Usable,-AVX512F_Usable";
    for name in ["fan.toml", "sine_5s.toml"] {
        let here = simulated(&scenario(name), None);
        assert!(here == simulated(&scenario(name), Some(masked)), "{name}");
    }
}

/// Processes that use up each core while a test runs.
struct Load(Vec<std::process::Child>);

impl Load {
    fn on_each_core() -> Self {
        let cores = std::thread::available_parallelism().unwrap().get();
        let busy = || {
            std::process::Command::new("sh")
                .args(["-c", "while :; do :; done"])
                .spawn()
                .unwrap()
        };
        Self((0..cores).map(|_| busy()).collect())
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for child in &mut self.0 {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

#[test]
fn a_loaded_machine_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = crate::support::short_scenario(folder.path(), 2.0);
    let idle = simulated(&path, None);
    let _load = Load::on_each_core();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(
        canrig(&runs, "run")
            .args(["--clock", "lockstep"])
            .arg(&path),
    );
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    assert!(contents(&only_run(&runs)) == idle);
}

/// Time does not go on before each listener has its frame, however long one sleeps.
#[test]
fn a_recorder_that_sleeps_loses_and_changes_nothing() {
    use canrig::capture::Watch;
    use canrig::run::{Source, World, run};
    let folder = tempfile::tempdir().unwrap();
    let source = Source::load(&crate::support::short_scenario(folder.path(), 1.0)).unwrap();
    let database = dbc::Database::shipped();
    let mut runs = Vec::new();
    for sleeps in [false, true] {
        let parent = folder.path().join(format!("sleeps-{sleeps}"));
        run(
            &source,
            &parent,
            &Watch::default(),
            Vec::new(),
            |_, capture| {
                let mut plant_emulator = canrig::nodes::plant_emulator(&source.scenario).unwrap();
                let mut controller =
                    canrig::nodes::controller(&source.scenario.controller_view(), None).unwrap();
                let mut bench =
                    canrig::disturbance_node::DisturbanceProducer::new(&source.scenario, database)
                        .unwrap();
                let mut sleeper = Sleeper { sleeps, calls: 0 };
                let roles = canrig::world::lockstep::Roles {
                    plant_emulator: &mut Local::new("plant-emulator", &mut *plant_emulator),
                    bench: &mut Local::new("bench", &mut bench),
                    controller: &mut Local::new("controller", &mut controller),
                };
                canrig::world::lockstep::play(&source.scenario, roles, capture, Some(&mut sleeper))
                    .map(World::in_virtual_time)
            },
        )
        .unwrap();
        runs.push(contents(&only_run(&parent)));
    }
    assert!(runs[0] == runs[1]);
}

/// What listens to the frames of a run, and sleeps now and then.
struct Sleeper {
    sleeps: bool,
    calls: u32,
}

impl platform::bus::Bus for Sleeper {
    fn send(&mut self, _frame: &canopen::CanFrame) -> Result<(), platform::bus::BusError> {
        self.calls += 1;
        if self.sleeps && self.calls.is_multiple_of(1000) {
            std::thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    }

    fn receive(
        &mut self,
        _timeout: Duration,
    ) -> Result<Option<canopen::CanFrame>, platform::bus::BusError> {
        Ok(None)
    }

    fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
        rustix::stdio::stdin()
    }

    fn dropped(&self) -> u64 {
        0
    }

    fn delayed(&self) -> u64 {
        0
    }
}

#[test]
fn an_overloaded_bus_fails_on_its_load_and_shows_late_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = crate::support::short_scenario(folder.path(), 2.0);
    let slow = "[bus]\nbitrate_kilobits_per_second = 125\n";
    let limits = "\n[expect]\nbus_load_percent = { max = 90.0 }\n";
    let text = fs::read_to_string(&path).unwrap().replace("[bus]\n", slow) + limits;
    fs::write(&path, &text).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, _) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(1), "{stdout}");
    assert!(stdout.contains("the bus is overloaded"), "{stdout}");
    let verdict = fs::read_to_string(only_run(&runs).join("verdict.json")).unwrap();
    let verdict: serde_json::Value = serde_json::from_str(&verdict).unwrap();
    let value = |name: &str| {
        let metrics = verdict["metrics"].as_array().unwrap();
        let metric = metrics
            .iter()
            .find(|metric| metric["name"] == name)
            .unwrap();
        metric["value"].as_f64().unwrap()
    };
    // 1 kHz needs some 410 bits a cycle; 125 are there.
    assert!(
        (99.0..=101.0).contains(&value("bus_load_percent")),
        "{verdict}"
    );
    assert!(value("sync_interval_milliseconds_max") > 5.0, "{verdict}");
    // Eight times the bit rate carries it.
    fs::write(&path, text.replace("125", "1000")).unwrap();
    let (code, stdout, _) = output(canrig(&folder.path().join("fast"), "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}");
}
