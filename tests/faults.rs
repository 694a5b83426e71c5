//! Deliberate faults: the catalogue, the result of each fault under each law, and the same bytes in every world.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use campaigns::campaign::{Campaign, CampaignRun, one_loop_plan};
use judge::verdict::Outcome;
use plan::Plan;
use scenario::Trial;

use crate::real_time::in_real_time;
use crate::support::{
    canrig, only_run, output, root, scenario, short_scenario, unhurried_scenario,
};

/// Returns the files of the catalogue, in order.
fn catalogue() -> Vec<PathBuf> {
    let entries = fs::read_dir(scenario("faults")).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn name(path: &std::path::Path) -> String {
    path.file_stem().unwrap().to_string_lossy().into_owned()
}

fn campaign() -> Campaign {
    Campaign::on_all_cores(false)
}

/// `every_shipped_scenario_passes` judges these too; this test requires that their expectations concern faults.
#[test]
fn every_case_of_the_catalogue_demands_a_reaction() {
    let catalogue = catalogue();
    assert!(catalogue.len() >= 25, "{} cases", catalogue.len());
    for path in &catalogue {
        let plan = Plan::load(path, worlds::catalogue::catalogue()).unwrap();
        let expect = &plan.only_loop().unwrap().trial.expect;
        assert!(plan.has_faults(), "{} has no fault", path.display());
        assert!(
            expect.of("safe_state").is_some() && expect.of("temperature_celsius").is_some(),
            "{} demands nothing",
            path.display()
        );
    }
}

/// Without its faults no case of the catalogue passes that expects an event: the expectations can fail.
#[test]
fn a_reaction_that_does_not_come_fails() {
    let is_safe_wanted = |plan: &Plan| {
        let expect = &plan.only_loop().unwrap().trial.expect;
        let limit = expect.limit("safe_state");
        limit.is_some_and(|limit| limit.admits(1.0))
    };
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 3.0\n\
        [controller.pid]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 1.0\n\
        [[fault.sensor.offset]]\nfrom_seconds = 2.0\noffset_millimetres = 0.0\n";
    let without = testing::plan(text).shared.run.faults.clone();
    let plans = catalogue().into_iter().map(|path| {
        let mut scenario = Trial::load(&path).unwrap();
        scenario.run_mut().faults = without.clone();
        one_loop_plan(scenario)
    });
    let plans = Vec::from_iter(plans.filter(is_safe_wanted));
    assert!(plans.len() >= 10);
    let outcomes = campaign().play(plans.into_iter(), |played| {
        (played.plan.shared.run.name.clone(), played.verdict.outcome)
    });
    for (name, outcome) in outcomes.unwrap().into_iter().map(Result::unwrap) {
        assert_eq!(outcome, Outcome::Fail, "{name}");
    }
}

/// Returns the result of a run as cells: time to current 0, time to recovery, highest temperature.
fn cells(played: &CampaignRun<'_>) -> String {
    let metric = |name: &str| {
        let metrics = played.verdict.metrics.iter();
        metrics.into_iter().find(|metric| metric.name == name)
    };
    let value = |name: &str| metric(name).and_then(|metric| metric.value);
    let cell = |value: Option<f64>, decimals: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
    };
    let is_safe = value("safe_state") == Some(1.0);
    format!(
        "{:>6} {:>5} {:>5.0} {}",
        cell(value("current_zero_within_milliseconds"), 0),
        cell(value("recovers_within_seconds"), 2),
        value("temperature_celsius").unwrap(),
        if is_safe { "safe" } else { "on  " },
    )
}

const LAWS: [&str; 3] = ["sliding_mode", "sliding_mode_paper", "pid"];

/// The table law × fault can be reviewed in a minute. `UPDATE_SNAPSHOTS=1` writes it anew.
#[test]
fn each_law_meets_each_fault_as_in_the_table() {
    let mut plans = Vec::new();
    for path in catalogue() {
        let text = fs::read_to_string(&path).unwrap();
        for law in LAWS {
            let text = text.replace("[controller.sliding_mode]", &format!("[controller.{law}]"));
            let plan = testing::plan_beside(&text, &[], worlds::catalogue::catalogue());
            plans.push((name(&path), law, plan));
        }
    }
    let names: Vec<_> = plans
        .iter()
        .map(|(name, law, _)| (name.clone(), *law))
        .collect();
    let played = campaign().play(plans.into_iter().map(|(.., plan)| plan), cells);
    let mut rows: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for ((name, _), cells) in names.into_iter().zip(played.unwrap()) {
        rows.entry(name).or_default().push(cells.unwrap());
    }
    let mut table = String::from(
        "Law by fault: milliseconds from the fault to current 0 (- flows on), seconds from its end to recovery\n\
         (- none), highest wire temperature in celsius, state at the end. Made by tests/faults.rs.\n\n",
    );
    let mut line = |name: &str, cells: &[String]| {
        let line = format!("{name:26} | {}", cells.join(" | "));
        writeln!(table, "{}", line.trim_end()).unwrap();
    };
    line("", &LAWS.map(|law| format!("{law:23}")));
    for (name, cells) in rows {
        line(&name, &cells);
    }
    let path = root().join("tests/data/faults.txt");
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        fs::write(&path, &table).unwrap();
    }
    let committed = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == table,
        "now it is (UPDATE_SNAPSHOTS=1 writes it):\n{table}"
    );
}

#[test]
fn faults_leave_the_same_bytes_in_one_process_and_in_three() {
    for case in ["drive_hangs", "controller_reboots", "sensor_spikes"] {
        let path = scenario(&format!("faults/{case}.toml"));
        let runs = [
            &["simulate"][..],
            &["run", "--clock", "lockstep", "--bus", "embedded"],
        ];
        let logs = runs.map(|arguments| {
            let folder = tempfile::tempdir().unwrap();
            let mut canrig = canrig(folder.path(), arguments[0]);
            let (code, stdout, stderr) = output(canrig.args(&arguments[1..]).arg(&path));
            assert_eq!(code, Some(0), "{case}\n{stdout}\n{stderr}");
            let run = only_run(folder.path());
            ["bus.log", "signals.csv", "verdict.json"].map(|name| fs::read(run.join(name)).unwrap())
        });
        assert!(logs[0] == logs[1], "{case}");
    }
}

/// In real time the controller's process is killed; the run continues and shows that the drive removes the current.
#[test]
fn a_crash_in_real_time_is_a_kill() {
    in_real_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = unhurried_scenario(folder.path(), 3.0);
        let fault = "[[fault.node.crash]]\nfrom_seconds = 1.5\nnode = \"controller\"\n\
                 [expect]\nsafe_state = true\nemcy = [\"drive 0x8100\"]\n";
        fs::write(&path, fs::read_to_string(&path).unwrap() + fault).unwrap();
        let runs = folder.path().join("runs");
        let (_, stdout, stderr) =
            output(canrig(&runs, "run").args(["--bus", "embedded"]).arg(&path));
        let verdict = fs::read_to_string(only_run(&runs).join("verdict.json")).unwrap();
        let verdict: serde_json::Value = serde_json::from_str(&verdict).unwrap();
        let passed = |name: &str| {
            let metrics = verdict["metrics"].as_array().unwrap().iter();
            let mut found = metrics.filter(|metric| metric["name"] == name);
            found.next().unwrap()["passed"].clone()
        };
        assert_eq!(passed("safe_state"), true, "{stdout}\n{stderr}");
        assert_eq!(passed("emcy"), true, "{stdout}\n{stderr}");
    });
}

/// The bench sends set-points and disturbances, and its gateway fails as any other.
#[test]
fn frames_of_the_bench_are_corrupted() {
    let folder = tempfile::tempdir().unwrap();
    let sent = |fault: &str| {
        let path = folder.path().join("bench.toml");
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"bench\"\nduration_seconds = 1.0\n[controller.pid]\n\
             [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
             [[disturbance.fan]]\nfrom_seconds = 0.5\nuntil_seconds = 0.8\nconvection_factor = 2.0\n{fault}"
        );
        fs::write(&path, text).unwrap();
        let runs = folder.path().join(format!("runs_{}", fault.len()));
        let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
        assert!(matches!(code, Some(0 | 1)), "{stdout}{stderr}");
        let log = fs::read_to_string(only_run(&runs).join("bus.log")).unwrap();
        let commands = log.lines().filter_map(|line| line.split_once(" 211#"));
        Vec::from_iter(commands.map(|(_, data)| data.to_owned()))
    };
    let corrupt = "[[fault.bus.corrupt]]\nfrom_seconds = 0.4\nsender = \"bench\"\nprobability = 1.0\ninverted_bits = 1\n";
    let (sound, corrupted) = (sent(""), sent(corrupt));
    assert!(sound.len() == 2 && corrupted.len() == 2);
    assert!(
        sound
            .iter()
            .zip(&corrupted)
            .all(|(one, other)| one != other)
    );
}

#[test]
fn a_fault_that_a_world_cannot_play_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = short_scenario(folder.path(), 1.0);
    let fault = "[[fault.bus.lose]]\nfrom_seconds = 0.5\nreceiver = \"drive\"\n";
    fs::write(&path, fs::read_to_string(&path).unwrap() + fault).unwrap();
    let (code, _, stderr) = output(
        canrig(&folder.path().join("runs"), "run")
            .args(["--bus", "embedded"])
            .arg(&path),
    );
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("[[fault.bus.lose]] is possible on the modelled bus only"),
        "{stderr}"
    );
}

/// The controller removes the current from all loops, so a failure of another loop is not attributed to a node.
#[test]
fn a_fault_of_one_loop_explains_what_another_misses() {
    let folder = tempfile::tempdir().unwrap();
    let data = root().join("crates/worlds/tests/data");
    fs::copy(
        data.join("two_axes_rig.toml"),
        folder.path().join("two_axes_rig.toml"),
    )
    .unwrap();
    let crash = "[[fault.node.crash]]\nfrom_seconds = 6.0\nnode = \"y\"\n";
    let text = fs::read_to_string(data.join("two_axes.toml")).unwrap() + crash;
    let path = folder.path().join("two_axes.toml");
    fs::write(&path, text).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(path));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
}

/// Plays a scenario of the joint with two wires with a change to it; returns its log.
#[track_caller]
fn log_of_the_joint(name: &str, change: impl Fn(&str) -> String) -> String {
    let folder = tempfile::tempdir().unwrap();
    let text = fs::read_to_string(scenario(name)).unwrap();
    let path = folder.path().join("changed.toml");
    fs::write(&path, change(&text)).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(path));
    assert_eq!(code, Some(0), "{stdout}\n{stderr}");
    fs::read_to_string(only_run(&runs).join("bus.log")).unwrap()
}

fn frames(log: &str, identifier: &str) -> usize {
    let is_it = format!(" {identifier}#");
    log.lines().filter(|line| line.contains(&is_it)).count()
}

#[test]
fn a_fault_of_a_plant_is_found_by_each_of_its_drives() {
    let break_one = log_of_the_joint("sma_pair_broken_wire.toml", str::to_owned);
    let break_both = log_of_the_joint("sma_pair_broken_wire.toml", |text| {
        text.replace("node = \"extensor\"", "plant = \"joint\"")
    });
    let emergencies = |log: &str| ["090", "092"].map(|id| frames(log, id) > 0);
    assert_eq!(emergencies(&break_one), [false, true]);
    assert_eq!(emergencies(&break_both), [true, true]);
}

#[test]
fn a_fault_of_the_bus_may_name_any_drive_of_a_plant() {
    for (drive, [doubled, other]) in [("flexor", ["190", "192"]), ("extensor", ["192", "190"])] {
        let log = log_of_the_joint("sma_pair_sine.toml", |text| {
            format!(
                "{text}\n[[fault.bus.duplicate]]\nsender = \"{drive}\"\nfrom_seconds = 3.0\nuntil_seconds = 3.2\n"
            )
        });
        let [doubled, other] = [doubled, other].map(|id| frames(&log, id));
        assert!(
            (doubled - other).abs_diff(100) < 3,
            "{drive}: {doubled}, {other}"
        );
    }
}
