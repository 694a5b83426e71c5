//! Virtual time: every scenario is judged, and has the same bytes in every world.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use plan::Plan;
use platform::lockstep::{Local, Participant};
use sha2::{Digest, Sha256};

use crate::net::{PRINTS_PART, judged_again, printed_parts};
use crate::real_time::{busy, in_real_time};
use crate::support::{canrig, only_run, output, root, runs, scenario};

/// Files that must be equal to the byte.
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

/// Members of `verdict.json` that identify the judge and are not results: no line depends on them.
const LEFT_OUT: [&str; 2] = ["version", "identity"];

/// The columns of the file of hashes, before the scenario's name: files and folders of a run, and what a program in the
/// controller's place is told, `-` where the scenario cannot be played with a program.
const HASHED: [&str; 6] = [
    "bus.log",
    "signals.csv",
    "verdict.json",
    "frames.dbc",
    "eds",
    "part",
];

/// Every scenario passes, and leaves the bytes in the file of hashes: of the frames on the bus, of the decoded signals,
/// of the verdict, of what the frames mean, of the EDS files, and of a program's part of the plan. A change that keeps the runs leaves that file as it is. Each scenario has a line there, and each
/// line a scenario. After a deliberate change to a run, or with a new scenario, write the file anew and review its
/// difference: `UPDATE_SNAPSHOTS=1 cargo test --release -p canrig --test tests every_shipped_scenario_passes`.
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
    let runs = runs(folder.path());
    let parts = parts();
    let mut lines: Vec<_> = runs.iter().map(|run| hash_line(run, &parts)).collect();
    lines.sort();
    let hashes = lines.concat();
    let path = root().join("tests/data/recordings.sha256");
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        fs::write(&path, &hashes).unwrap();
    }
    let committed = fs::read_to_string(&path).unwrap();
    let changes = changes(&committed, &hashes);
    assert!(
        changes.is_empty(),
        "other bytes than in {}: {changes:#?}, now:\n{hashes}",
        path.display()
    );
    for run in &runs {
        judged_again(run);
    }
}

/// Plays every shipped scenario with a program that prints its part and ends. Returns the parts by the scenarios' names.
fn parts() -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let mut simulate = canrig(folder.path(), "simulate");
    simulate.arg("--quiet").arg(root().join("scenarios"));
    output(simulate.args(PRINTS_PART));
    let runs = runs(folder.path());
    assert!(runs.len() >= 70, "{} runs with a program", runs.len());
    let part = |run: &PathBuf| {
        let mut parts = printed_parts(run);
        assert_eq!(parts.len(), 1, "{}", run.display());
        (name_of(run), parts.swap_remove(0).1)
    };
    runs.iter().map(part).collect()
}

/// Returns the name of a run's scenario.
fn name_of(run: &Path) -> String {
    let scenario = fs::read_to_string(run.join("scenario.toml")).unwrap();
    let scenario: toml::Table = scenario.parse().unwrap();
    scenario["name"].as_str().unwrap().to_owned()
}

/// Returns the scenario of a run with the hashes of its files, and of a program's part of its plan.
fn hash_line(run: &Path, parts: &BTreeMap<String, Vec<u8>>) -> String {
    let name = name_of(run);
    let hash = |column: &str| {
        let bytes = match column {
            "verdict.json" => {
                let verdict = fs::read_to_string(run.join(column)).unwrap();
                without_members(&verdict, &LEFT_OUT).into()
            }
            "eds" => files_of(&run.join(column)),
            "part" => match parts.get(&name) {
                Some(part) => part.clone(),
                None => return "-".to_owned(),
            },
            _ => fs::read(run.join(column)).unwrap(),
        };
        let digest = Sha256::digest(bytes);
        let digits = digest.iter().take(16).map(|byte| format!("{byte:02x}"));
        digits.collect()
    };
    format!("{}  {name}\n", HASHED.map(hash).join(" "))
}

/// Returns the names and the contents of the files in a folder, in the order of the names.
fn files_of(folder: &Path) -> Vec<u8> {
    let entries = fs::read_dir(folder).unwrap();
    let files = BTreeSet::from_iter(entries.map(|entry| entry.unwrap().path()));
    let contents = files.iter().flat_map(|path| {
        let name = path.file_name().unwrap().as_encoded_bytes();
        [name, b"\n", &fs::read(path).unwrap()].concat()
    });
    contents.collect()
}

/// Returns a JSON object in canrig's format without some of its members. Commas at line ends are removed, since the
/// last member has none, whichever it is.
fn without_members(json: &str, left_out: &[&str]) -> String {
    let mut is_kept = true;
    let mut kept = String::new();
    for line in json.lines() {
        // A member begins with its key two spaces deep; its content is deeper or a bracket.
        if let Some(member) = line.strip_prefix("  \"") {
            let key = member.split_once("\": ").map(|(key, _)| key);
            is_kept = key.is_none_or(|key| !left_out.contains(&key));
        }
        if is_kept || line == "}" {
            kept += line.trim_end_matches(',');
            kept.push('\n');
        }
    }
    kept
}

/// Returns the differences of two files of hashes, by the names of the scenarios.
fn changes(committed: &str, now: &str) -> Vec<String> {
    let [committed, now] = [committed, now].map(by_name);
    let names: BTreeSet<_> = committed.keys().chain(now.keys()).collect();
    let change = |name: &&str| match (committed.get(name), now.get(name)) {
        (Some(before), Some(after)) => {
            let differs = |column: &usize| before[*column] != after[*column];
            let columns = (0..HASHED.len()).filter(differs);
            let files: Vec<_> = columns.map(|column| HASHED[column]).collect();
            (!files.is_empty()).then(|| format!("{name}: {} changed", files.join(", ")))
        }
        (None, _) => Some(format!("{name}: the scenario has no line")),
        (_, None) => Some(format!("{name}: the line has no scenario")),
    };
    names.into_iter().filter_map(change).collect()
}

/// Returns the hashes of each scenario.
fn by_name(lines: &str) -> BTreeMap<&str, [&str; HASHED.len()]> {
    let mut by_name = BTreeMap::new();
    for line in lines.lines() {
        let (hashes, name) = line.split_once("  ").expect(line);
        let hashes: Vec<_> = hashes.split(' ').collect();
        let hashes = hashes.try_into().expect(line);
        assert!(
            by_name.insert(name, hashes).is_none(),
            "{name} is there twice"
        );
    }
    by_name
}

#[test]
fn a_scenario_without_a_line_and_a_line_without_a_scenario_are_named() {
    let committed = "1 2 3 4 5 6  step\n4 5 6 7 8 -  fan\n";
    assert_eq!(changes(committed, committed), [] as [&str; 0]);
    assert_eq!(
        changes(committed, "1 2 7 4 5 6  step\n8 9 6 7 8 9  hold\n"),
        [
            "fan: the line has no scenario",
            "hold: the scenario has no line",
            "step: verdict.json changed"
        ]
    );
}

#[test]
fn a_member_is_left_out_of_a_verdict_wherever_it_stands() {
    let members = [
        "  \"version\": \"0.1.0\"",
        "  \"metrics\": [\n    {\n      \"version\": 1\n    }\n  ]",
        "  \"losses\": [\n    \"version\"\n  ]",
    ];
    for place in 0..members.len() {
        let mut order = members;
        order.swap(0, place);
        let rest: Vec<_> = order
            .iter()
            .filter(|one| **one != members[0])
            .copied()
            .collect();
        let [whole, rest] =
            [order.join(",\n"), rest.join("\n")].map(|members| format!("{{\n{members}\n}}\n"));
        serde_json::from_str::<serde_json::Value>(&whole).unwrap();
        assert_eq!(without_members(&whole, &["version"]), rest);
    }
    let whole = format!("{{\n{}\n}}\n", members.join(",\n"));
    let alone = format!("{{\n{}\n}}\n", members[0]);
    assert_eq!(without_members(&whole, &["metrics", "losses"]), alone);
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

/// Returns the plan of a scenario.
fn plan(path: &Path) -> Plan {
    Plan::load(path, worlds::catalogue::catalogue()).unwrap()
}

#[test]
fn the_recording_alone_gives_the_same_verdict() {
    use judge::{Circumstances, judge};
    use recording::log::{Unread, read_cut_log};
    use recording::timeline::decode;
    let folder = tempfile::tempdir().unwrap();
    let (code, ..) = output(canrig(folder.path(), "simulate").arg(scenario("fan.toml")));
    assert_eq!(code, Some(0));
    let run = only_run(folder.path());
    let log = fs::File::open(run.join("bus.log")).unwrap();
    let (frames, unread) = read_cut_log(std::io::BufReader::new(log)).unwrap();
    assert_eq!(unread, Unread::default());
    let plan = plan(&run.join("scenario.toml"));
    let timelines = decode(&frames.into(), &plan).unwrap();
    let verdict = judge(&plan, &timelines, &Circumstances::default());
    let stored = fs::read_to_string(run.join("verdict.json")).unwrap();
    assert_eq!(
        without_members(&verdict.to_json(), &LEFT_OUT),
        without_members(&stored, &LEFT_OUT)
    );
}

/// A node without promises: it is asked at every event, and never runs ahead.
struct Asked<'a>(platform::lockstep::Local<'a>, platform::lockstep::Hello);

impl<'a> Asked<'a> {
    fn new(node: platform::lockstep::Local<'a>) -> Self {
        use platform::lockstep::Participant;
        let hello = platform::lockstep::Hello {
            silent_filters: Vec::new(),
            ..node.hello().clone()
        };
        Self(node, hello)
    }
}

impl platform::lockstep::Participant for Asked<'_> {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn hello(&self) -> &platform::lockstep::Hello {
        &self.1
    }

    fn meet(&mut self, _audience: &platform::lockstep::Audience) {}

    fn advance(
        &mut self,
        to: Duration,
        _until: Duration,
        frames: &[(Duration, can::CanFrame)],
        answer: &mut platform::lockstep::Answer,
    ) -> Result<(), platform::lockstep::Failure> {
        self.0.advance(to, to, frames, answer)
    }

    fn stop(
        &mut self,
        at: Duration,
        answer: &mut platform::lockstep::Answer,
    ) -> Result<(), platform::lockstep::Failure> {
        self.0.stop(at, answer)
    }
}

fn in_folder(parent: &Path) -> runner::run::RunPlace<'_> {
    runner::run::RunPlace {
        parent,
        is_long: false,
        overrides: &[],
        is_strict: false,
        tries: None,
    }
}

#[test]
fn looking_ahead_leaves_the_bytes_of_asking_at_every_event() {
    use recording::capture::Watch;
    use runner::run::run;
    use worlds::Played;
    use worlds::bench_node::BenchNode;
    use worlds::law_process::LawPlace;
    use worlds::lockstep::{play, simulate};
    use worlds::nodes::{controller_views, make_controller, plant_emulator};
    use worlds::programs::Hosting;
    for name in ["fan.toml", "step.toml"] {
        let source = plan(&scenario(name));
        let folder = tempfile::tempdir().unwrap();
        let [ahead, asked] = ["ahead", "asked"].map(|name| folder.path().join(name));
        run(
            &source,
            in_folder(&ahead),
            &Watch::default(),
            Vec::new(),
            |_, capture| {
                simulate(&source, &Hosting::default(), capture).map(Played::in_virtual_time)
            },
        )
        .unwrap();
        run(
            &source,
            in_folder(&asked),
            &Watch::default(),
            Vec::new(),
            |_, capture| {
                let mut plant_emulator = plant_emulator(&source, "plant-emulator").unwrap();
                let mut bench = BenchNode::new(&source).unwrap();
                let mut controller =
                    make_controller(&controller_views(&source), &LawPlace::of(&source)).unwrap();
                let mut participants = [
                    Asked::new(Local::new("plant-emulator", &mut *plant_emulator)),
                    Asked::new(Local::new("bench", &mut bench)),
                    Asked::new(Local::new("controller", &mut controller)),
                ];
                let participants = participants
                    .each_mut()
                    .map(|one| one as &mut dyn Participant);
                play(&source, participants.into(), capture, None).map(Played::in_virtual_time)
            },
        )
        .unwrap();
        assert!(
            contents(&only_run(&ahead)) == contents(&only_run(&asked)),
            "{name}"
        );
    }
}

/// Returns the determined files of a simulated scenario, with the C library's CPU features masked or not.
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

/// glibc chooses its mathematical functions by the CPU; with FMA they have other bits.
#[test]
fn another_cpu_leaves_the_same_bytes() {
    let masked = "glibc.cpu.hwcaps=-FMA,-AVX2,-AVX512F,-FMA_Usable,-AVX2_Usable,-AVX512F_Usable";
    for name in ["fan.toml", "sine_5s.toml"] {
        let here = simulated(&scenario(name), None);
        assert!(here == simulated(&scenario(name), Some(masked)), "{name}");
    }
}

/// Two axes in one process and in four.
#[test]
fn two_axes_leave_the_same_bytes_as_processes() {
    is_alike_in_processes(&root().join("crates/worlds/tests/data/two_axes.toml"));
}

/// Two drives on one plant, in one process and in three.
#[test]
fn two_drives_on_one_plant_leave_the_same_bytes_as_processes() {
    is_alike_in_processes(&scenario("sma_pair_step.toml"));
}

/// The fault finds its process by its name, and messages have that name.
#[test]
fn a_controller_with_another_name_is_a_process_of_that_name() {
    let folder = tempfile::tempdir().unwrap();
    let rig = fs::read_to_string(root().join("scenarios/rigs/dc_motor.toml")).unwrap();
    assert!(rig.contains("[node.controller]"), "{rig}");
    let rig = rig.replace("[node.controller]", "[node.hand]");
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let scenario = folder.path().join("crash.toml");
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"crash\"\nduration_seconds = 1.0\n[controller.pid]\n\
                proportional_amperes_per_metre = 22.8\n\
                integral_amperes_per_metre_second = 37.9\n\
                derivative_ampere_seconds_per_metre = 3.59\n\
                [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
                [[fault.node.crash]]\nfrom_seconds = 0.5\nnode = \"hand\"\n";
    fs::write(&scenario, text).unwrap();
    for world in [&["--clock", "lockstep"][..], &["--bus", "embedded"]] {
        in_real_time(|| {
            let runs = tempfile::tempdir().unwrap();
            let mut run = canrig(runs.path(), "run");
            let (_, stdout, stderr) = output(run.args(world).arg(&scenario));
            let lost = "loss: no SYNC from hand from here on";
            assert!(stdout.contains(lost), "{stdout}{stderr}");
            assert!(!stdout.contains("from controller"), "{stdout}");
        });
    }
}

#[track_caller]
fn is_alike_in_processes(scenario: &Path) {
    let here = simulated(scenario, None);
    let folder = tempfile::tempdir().unwrap();
    let mut run = canrig(folder.path(), "run");
    let run = run.args(["--clock", "lockstep", "--bus", "embedded"]);
    let (code, stdout, stderr) = output(run.arg(scenario));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    assert!(contents(&only_run(folder.path())) == here);
}

#[test]
fn a_loaded_machine_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = crate::support::short_scenario(folder.path(), 2.0);
    let idle = simulated(&path, None);
    let cores = std::thread::available_parallelism().unwrap().get();
    let _load = Vec::from_iter((0..cores).map(|_| busy()));
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(
        canrig(&runs, "run")
            .args(["--clock", "lockstep"])
            .arg(&path),
    );
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    assert!(contents(&only_run(&runs)) == idle);
}

/// Time does not advance before each listener has its frame, however long one sleeps.
#[test]
fn a_recorder_that_sleeps_loses_and_changes_nothing() {
    use recording::capture::Watch;
    use runner::run::run;
    use worlds::Played;
    use worlds::law_process::LawPlace;
    use worlds::nodes::{controller_views, make_controller, plant_emulator};
    let folder = tempfile::tempdir().unwrap();
    let source = plan(&crate::support::short_scenario(folder.path(), 1.0));
    let mut runs = Vec::new();
    for sleeps in [false, true] {
        let parent = folder.path().join(format!("sleeps-{sleeps}"));
        run(
            &source,
            in_folder(&parent),
            &Watch::default(),
            Vec::new(),
            |_, capture| {
                let mut plant_emulator = plant_emulator(&source, "plant-emulator").unwrap();
                let mut controller =
                    make_controller(&controller_views(&source), &LawPlace::of(&source)).unwrap();
                let mut bench = worlds::bench_node::BenchNode::new(&source).unwrap();
                let mut sleeper = Sleeper { sleeps, calls: 0 };
                let mut participants = [
                    Local::new("plant-emulator", &mut *plant_emulator),
                    Local::new("bench", &mut bench),
                    Local::new("controller", &mut controller),
                ];
                let participants = participants
                    .each_mut()
                    .map(|one| one as &mut dyn Participant);
                worlds::lockstep::play(&source, participants.into(), capture, Some(&mut sleeper))
                    .map(Played::in_virtual_time)
            },
        )
        .unwrap();
        runs.push(contents(&only_run(&parent)));
    }
    assert!(runs[0] == runs[1]);
}

/// A listener to the frames of a run that sleeps now and then.
struct Sleeper {
    sleeps: bool,
    calls: u32,
}

impl platform::bus::Bus for Sleeper {
    fn send(&mut self, _frame: &can::CanFrame) -> Result<(), platform::bus::BusError> {
        self.calls += 1;
        if self.sleeps && self.calls.is_multiple_of(1000) {
            std::thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    }

    fn receive(
        &mut self,
        _timeout: Duration,
    ) -> Result<Option<can::CanFrame>, platform::bus::BusError> {
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
fn a_bus_that_cannot_carry_its_frames_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = crate::support::short_scenario(folder.path(), 2.0);
    let slow = "[bus]\nbitrate_kilobits_per_second = 125\n";
    let limits = "\n[expect]\nbus_load_percent = { max = 90.0 }\n";
    let text = fs::read_to_string(&path).unwrap().replace("[bus]\n", slow) + limits;
    fs::write(&path, &text).unwrap();
    let runs = folder.path().join("runs");
    let (code, _, stderr) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(3), "{stderr}");
    // 1 kHz needs some 410 bits a cycle; 125 are available.
    for said in [
        "do not fit between two SYNCs",
        "sync_period_milliseconds = ",
    ] {
        assert!(stderr.contains(said), "{stderr}");
    }
    // Eight times the bit rate is sufficient.
    fs::write(&path, text.replace("125", "1000")).unwrap();
    let (code, stdout, _) = output(canrig(&folder.path().join("fast"), "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}");
}
