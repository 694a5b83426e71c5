//! Rig files, and scenarios on them.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::support::{canrig, only_run, output, root, scenario};

fn program(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_canrig"));
    command.args(args);
    command
}

/// Writes a rig of two drives with its scenario by `canrig new rig`.
fn new_rig(folder: &Path) -> PathBuf {
    let rig = folder.join("gantry");
    let (code, stdout, stderr) = output(program(&["new", "rig", "gantry", "--path"]).arg(&rig));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    rig
}

/// Changes the text of a file.
fn edit(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{text}");
    fs::write(path, text.replace(from, to)).unwrap();
}

/// Returns the text of a rig in `tests/rigs/`.
pub(crate) fn rig(name: &str) -> String {
    let path = root().join("tests/rigs").join(name).with_extension("toml");
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the text of a rig in `tests/rigs/` with changes, each of a text that it has once.
pub(crate) fn changed_rig(name: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(rig(name), |rig, (from, to)| {
        assert_eq!(rig.matches(from).count(), 1, "{from}: {rig}");
        rig.replacen(from, to, 1)
    })
}

fn verdict(run: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(run.join("verdict.json")).unwrap()).unwrap()
}

fn metric(verdict: &Value, name: &str) -> f64 {
    let metrics = verdict["metrics"].as_array().unwrap();
    let metric = metrics.iter().find(|metric| metric["name"] == name);
    metric.unwrap_or_else(|| panic!("{name}: {verdict}"))["value"]
        .as_f64()
        .unwrap()
}

#[test]
fn a_new_rig_is_checked_with_its_arithmetic_and_its_scenario_passes() {
    let folder = tempfile::tempdir().unwrap();
    let rig = new_rig(folder.path());
    let (code, stdout, stderr) = output(program(&["check"]).arg(&rig));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    for said in [
        "gantry.toml: valid (rig: gantry)",
        "gantry_steps.toml: valid (gantry, two steps)",
        "command to b (RPDO1)",
        "2 ms at 1000 kbit/s are 2000 bits",
        "The shortest sync_period_milliseconds that fits is ",
    ] {
        assert!(stdout.contains(said), "{said}: {stdout}");
    }
    let runs = folder.path().join("runs");
    let steps = rig.join("gantry_steps.toml");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&steps));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let value = "reference.step[1].position_millimetres=30";
    let runs = folder.path().join("set");
    let set = output(canrig(&runs, "simulate").arg(&steps).args(["--set", value]));
    assert_eq!(set.0, Some(0), "{}{}", set.1, set.2);
    let verdict = verdict(&only_run(&runs));
    let highest = metric(&verdict, "b.position_millimetres_max");
    assert!((29.0..31.0).contains(&highest), "{highest}");
}

/// Plays a scenario in processes in lock-step and in one process; returns the folders of the runs, which must pass.
fn in_both_worlds(folder: &Path, scenario: &Path) -> [PathBuf; 2] {
    let lockstep = ["--clock", "lockstep", "--bus", "embedded"];
    let worlds = [("run", &lockstep[..]), ("simulate", &[])];
    worlds.map(|(command, options)| {
        let runs = folder.join(command);
        let (code, stdout, stderr) = output(canrig(&runs, command).arg(scenario).args(options));
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        only_run(&runs)
    })
}

/// One plant, whose process needs no name, and two drives on one plant in one process.
#[test]
fn a_plant_in_a_separate_process_leaves_the_bytes_of_simulate() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["press_turn.toml", "sma_pair_step.toml"] {
        let [alone, together] = in_both_worlds(&folder.path().join(name), &scenario(name));
        for file in ["bus.log", "signals.csv", "verdict.json"] {
            let read = |run: &Path| fs::read(run.join(file)).unwrap();
            assert!(read(&alone) == read(&together), "{name}: {file}");
        }
    }
}

/// The same holds if a check names a signal that each drive has.
#[test]
fn a_recording_of_several_drives_gives_its_verdict_again() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path();
    let name = scenario("four_drives_courses.toml");
    let (code, stdout, stderr) = output(canrig(runs, "simulate").arg(name));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let run = only_run(runs);
    let (code, stdout, stderr) = output(program(&["replay"]).arg(&run));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let page = |run: &Path| fs::read_to_string(run.join("report.html")).unwrap();
    let before = page(&run);
    let title = "z_tpdo2.motor_speed_revolutions_per_minute";
    assert!(before.contains(title) && before.contains("z: step to 20 mm"));
    let (code, stdout, stderr) = output(program(&["report"]).arg(&run));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert!(page(&run) == before, "another page");
}

#[test]
fn a_rig_that_does_not_fit_is_refused_with_the_period_that_would() {
    let folder = tempfile::tempdir().unwrap();
    let rig = new_rig(folder.path());
    let file = rig.join("gantry.toml");
    edit(
        &file,
        "sync_period_milliseconds = 2.0",
        "sync_period_milliseconds = 0.5",
    );
    for path in [&file, &rig.join("gantry_steps.toml")] {
        let (code, _, stderr) = output(program(&["check"]).arg(path));
        assert_eq!(code, Some(3), "{stderr}");
        for said in [
            "gantry.toml",
            "do not fit between two SYNCs",
            "of 500 bits between two SYNCs",
            "write sync_period_milliseconds = ",
            "bits in the fullest cycle: ",
        ] {
            assert!(stderr.contains(said), "{said}: {stderr}");
        }
    }
}

#[test]
fn a_sweep_has_the_names_of_the_loops() {
    let folder = tempfile::tempdir().unwrap();
    let rig = new_rig(folder.path());
    let steps = rig.join("gantry_steps.toml");
    let sweep = "[sweep]\ndraws = 2\n\
        [[sweep.list]]\nkey = \"controller.all.pid.set_point_weight\"\nvalues = [0.377, 0.38]\n\
        [[sweep.uniform]]\nkey = \"plant.axis_b.load_kilograms\"\nfrom = 0.5\nto = 0.6\n\n[expect]\n";
    edit(&steps, "[expect]\n", sweep);
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "sweep").arg(&steps));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let table = fs::read_to_string(only_run(&runs).join("runs.csv")).unwrap();
    let mut lines = table.lines();
    let header = lines.next().unwrap();
    for column in [
        "controller.all.pid.set_point_weight",
        "plant.axis_b.load_kilograms",
        "a.overshoot_percent",
        "b.overshoot_percent",
        "bus_load_percent",
    ] {
        assert!(
            header.split(',').any(|cell| cell == column),
            "{column}: {header}"
        );
    }
    let place = header
        .split(',')
        .position(|cell| cell == "b.current_amperes_rms")
        .unwrap();
    let currents = lines.map(|line| line.split(',').nth(place).unwrap().to_owned());
    let currents = Vec::from_iter(currents);
    assert_eq!(currents.len(), 4);
    assert_ne!(
        currents[0], currents[1],
        "another load takes another current"
    );
}

#[test]
fn torture_draws_faults_of_each_node() {
    let folder = tempfile::tempdir().unwrap();
    let rig = new_rig(folder.path());
    let steps = rig.join("gantry_steps.toml");
    let runs = folder.path().join("runs");
    let mut command = canrig(&runs, "torture");
    let (code, stdout, stderr) = output(command.arg(&steps).args(["--runs", "30", "--quiet"]));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert!(
        stdout.contains("30 runs with seed 1: all invariants held"),
        "{stdout}"
    );
    let page = fs::read_to_string(only_run(&runs).join("report.html")).unwrap();
    assert!(page.contains("Torture of 30 runs: 30 pass"), "{page}");
}

#[test]
fn the_rig_that_ships_is_a_rig_file_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = scenario("rigs/sma_actuator.toml");
    fs::copy(shipped, folder.path().join("actuator.toml")).unwrap();
    let copied = folder.path().join("step.toml");
    fs::copy(scenario("step.toml"), &copied).unwrap();
    edit(&copied, "rig = \"sma_actuator\"", "rig = \"actuator.toml\"");
    let play = |path: &Path, name: &str| {
        let runs = folder.path().join(name);
        let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(path));
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        only_run(&runs)
    };
    let one = play(&scenario("step.toml"), "one");
    let other = play(&copied, "other");
    for file in ["bus.log", "signals.csv", "frames.dbc"] {
        let read = |run: &Path| fs::read(run.join(file)).unwrap();
        assert!(read(&one) == read(&other), "{file}");
    }
    let verdict = |run: &Path| {
        let mut verdict = verdict(run);
        // The identity contains the hash of the scenario's file.
        verdict.as_object_mut().unwrap().remove("identity");
        verdict
    };
    assert_eq!(verdict(&one), verdict(&other));
    let (code, stdout, stderr) = output(program(&["replay"]).arg(&other));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
}

#[test]
fn identification_says_that_it_knows_one_drive() {
    let folder = tempfile::tempdir().unwrap();
    let rig = new_rig(folder.path());
    let runs = folder.path().join("runs");
    output(canrig(&runs, "simulate").arg(rig.join("gantry_steps.toml")));
    let (code, _, stderr) = output(program(&["identify"]).arg(only_run(&runs)));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("it is of 2 loops; identification explains one wire"),
        "{stderr}"
    );
}

#[test]
fn runs_in_degrees_are_compared_by_the_range_of_their_sensor() {
    let folder = tempfile::tempdir().unwrap();
    let played = |name: &str, degrees: &str| {
        let runs = folder.path().join(name);
        let mut command = canrig(&runs, "simulate");
        let value = format!("reference.ramp[0].position_degrees={degrees}");
        command
            .arg(scenario("press_turn.toml"))
            .args(["--set", &value]);
        output(&mut command);
        only_run(&runs)
    };
    let (a, near, far) = (
        played("a", "720"),
        played("near", "725"),
        played("far", "730"),
    );
    let compared = |other: &Path, more: &[&str]| {
        output(
            program(&["compare", "--json"])
                .arg(&a)
                .arg(other)
                .args(more),
        )
    };
    let position = |text: &str| {
        let compared: Value = serde_json::from_str(text).unwrap();
        let signals = compared["signals"].as_array().unwrap().clone();
        let mut signals = signals.into_iter();
        signals
            .find(|one| one["name"] == "position_degrees")
            .unwrap()
    };
    // The sensor measures 1810 degrees.
    let (code, stdout, stderr) = output(program(&["compare"]).arg(&a).arg(&a));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let (code, stdout, stderr) = compared(&far, &[]);
    assert_eq!(code, Some(1), "{stderr}");
    let one = position(&stdout);
    assert!((one["tolerance"].as_f64().unwrap() - 1810.0 / 240.0).abs() < 1e-9);
    assert!(one["diverges_at_seconds"].is_number(), "{one}");
    let one = position(&compared(&near, &[]).1);
    assert!(one["diverges_at_seconds"].is_null(), "{one}");
    for given in ["degrees=2", "deg=2", "position_degrees=2"] {
        let one = position(&compared(&near, &["--tolerance", given]).1);
        assert!(one["diverges_at_seconds"].is_number(), "{given}: {one}");
    }
    let (code, _, stderr) = compared(&near, &["--tolerance", "milimetres=2"]);
    assert_eq!(code, Some(2), "{stderr}");
}

#[test]
fn a_mistake_in_a_rig_file_is_said_once_and_of_a_rig() {
    let folder = tempfile::tempdir().unwrap();
    let rig = new_rig(folder.path());
    let file = rig.join("gantry.toml");
    edit(&file, "outputs = [\"b.current\"]", "outputs = []");
    let (code, _, stderr) = output(program(&["check"]).arg(&file));
    assert_eq!(code, Some(3), "{stderr}");
    assert_eq!(stderr.matches("  × ").count(), 1, "{stderr}");
    assert!(stderr.contains("at least 1 is needed"), "{stderr}");
    let empty = folder.path().join("empty.toml");
    fs::write(&empty, "# nothing yet\n").unwrap();
    let sheets = folder.path().join("sheets");
    let (code, _, stderr) = output(program(&["eds"]).arg(&empty).arg("--to").arg(&sheets));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("the rig file lacks the key `node`"),
        "{stderr}"
    );
    assert!(!stderr.contains("the scenario lacks"), "{stderr}");
}

/// The frames with the positions of `two_axes`.
const POSITION_X: &str = " 190#";
const POSITION_Y: &str = " 192#";

/// Removes frames from a log, in a range of the recording's clock.
fn silence(run: &Path, frame: &str, stretch: Range<f64>) {
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let is_kept = |line: &&str| {
        let time: f64 = line[1..line.find(')').unwrap()].parse().unwrap();
        !(line.contains(frame) && stretch.contains(&time))
    };
    let kept = Vec::from_iter(log.lines().filter(is_kept));
    assert!(kept.len() < log.lines().count());
    fs::write(run.join("bus.log"), kept.join("\n") + "\n").unwrap();
}

/// Records host stalls in these ranges of the recording's clock.
fn stall(run: &Path, stretches: &[&str]) {
    let rows = stretches
        .iter()
        .map(|stretch| format!("{stretch},machine,stood still\n"));
    let text = "from_seconds,until_seconds,who,what\n".to_owned() + &rows.collect::<String>();
    fs::write(run.join("stalls.csv"), text).unwrap();
}

/// Judges a run again; returns the exit code and the row of its longest distance from the path.
fn contour_again(run: &Path) -> (Option<i32>, Value) {
    let (code, stdout, stderr) = output(program(&["replay", "--json"]).arg(run));
    let verdict: Value = serde_json::from_str(&stdout).expect(&stderr);
    let rows = verdict["metrics"].as_array().unwrap();
    let row = rows
        .iter()
        .find(|row| row["name"] == "x_y.contour_error_millimetres_max");
    (code, row.unwrap().clone())
}

/// An unseen contour does not pass, and a possible effect of a stall is not judged, unless it was judged before.
#[test]
fn a_contour_is_judged_by_the_rules_of_all_metrics() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) =
        output(canrig(folder.path(), "simulate").arg(scenario("two_axes_circle.toml")));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let run = only_run(folder.path());
    silence(&run, POSITION_Y, 12.0..12.1);
    let (code, row) = contour_again(&run);
    let remark = row["remark"].as_str().unwrap();
    assert!(remark.starts_with("y: silent from 1"), "{remark}");
    assert_eq!((code, &row["passed"]), (Some(1), &Value::Bool(false)));
    // Whether it is the first axis that a stall takes, or the other one.
    stall(&run, &["11.990000,12.110000"]);
    for frame in [None, Some(POSITION_X)] {
        frame
            .into_iter()
            .for_each(|frame| silence(&run, frame, 12.0..12.1));
        let (code, row) = contour_again(&run);
        assert_eq!((code, row.get("passed")), (Some(5), None), "{row}");
    }
    // An axis that reversed was 0.2 mm off the circle before.
    edit(
        &run.join("scenario.toml"),
        "max = { max = 0.3 }",
        "max = { max = 0.1 }",
    );
    let (code, row) = contour_again(&run);
    assert_eq!(
        (code, &row["passed"]),
        (Some(1), &Value::Bool(false)),
        "{row}"
    );
    // A stall before that explains everything until the loop is calm again, and no more.
    silence(&run, POSITION_X, 3.0..3.01);
    stall(&run, &["2.990000,3.020000", "11.990000,12.110000"]);
    let (code, row) = contour_again(&run);
    assert_eq!(
        (code, &row["passed"]),
        (Some(1), &Value::Bool(false)),
        "{row}"
    );
    // The judgement ends before the window begins.
    edit(
        &run.join("scenario.toml"),
        "[expect.all]\n",
        "[expect.all]\njudged_until_seconds = 5.0\n",
    );
    let (_, row) = contour_again(&run);
    assert_eq!(row["remark"], "the window begins behind what is judged");
}

const TURNS: &str = r#"
schema = 1
name = "turns"
rig = "spindle.toml"
duration_seconds = 2.3
[controller.pid]
proportional_amperes_per_revolution_per_minute = 0.001
integral_amperes_per_revolution_per_minute_second = 0.05
derivative_ampere_seconds_per_revolution_per_minute = 0.0
[[reference.hold]]
at_seconds = 0.0
speed_revolutions_per_minute = 0.0
[[reference.sine]]
from_seconds = 0.3
centre_revolutions_per_minute = 0.0
amplitude_revolutions_per_minute = 200.0
period_seconds = 0.5
[expect]
tracking_error_revolutions_per_minute_rms = { max = 50.0 }
speed_revolutions_per_minute_max = { min = 150.0, max = 260.0 }
[[expect.signal]]
name = "true_speed_revolutions_per_minute"
stays = { min = -300.0, max = 300.0 }
"#;

/// A quantity other than a position has its own name, from the set-point to the page, and is equal in every world.
#[test]
fn a_loop_of_a_speed_is_played_and_judged_under_names_of_a_speed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("turns.toml");
    fs::write(folder.path().join("spindle.toml"), rig("spindle")).unwrap();
    fs::write(&path, TURNS).unwrap();
    let [alone, together] = in_both_worlds(folder.path(), &path);
    let read = |run: &Path, file: &str| fs::read_to_string(run.join(file)).unwrap();
    for file in ["bus.log", "signals.csv", "frames.dbc", "report.html"] {
        assert!(read(&alone, file) == read(&together, file), "{file}");
    }
    let columns = read(&together, "signals.csv");
    let columns = columns.lines().next().unwrap();
    for name in ["set_point", "speed", "true_speed", "reference_speed"] {
        let column = format!(",{name}_revolutions_per_minute,");
        assert!(columns.contains(&column), "{column}: {columns}");
    }
    assert!(!columns.contains("position_revolutions"), "{columns}");
    assert!(read(&together, "report.html").contains(">Speed<"));
    let judged = read(&together, "verdict.json");
    let (code, stdout, stderr) = output(program(&["replay", "--json"]).arg(&together));
    assert_eq!(code, Some(0), "{stderr}");
    let again: Value = serde_json::from_str(&stdout).unwrap();
    let before: Value = serde_json::from_str(&judged).unwrap();
    assert_eq!(again["metrics"], before["metrics"]);
}

/// A value that a field cannot hold is unknown, not the largest number of the field.
#[test]
fn an_output_beyond_its_field_has_no_value_and_is_not_judged() {
    let folder = tempfile::tempdir().unwrap();
    let far = "[plant.motor.dc_motor]\ngear_ratio = 1.0\npinion_radius_metres = 0.001\n\
               gear_friction_newton_metres = 0.0001\nload_kilograms = 0.0\nspring_newtons_per_metre = 0.0\n\
               travel_metres = 10.0";
    let rig = changed_rig("spindle", &[("[plant.motor.dc_motor]", far)]);
    fs::write(folder.path().join("spindle.toml"), rig).unwrap();
    let path = folder.path().join("far.toml");
    let text = "schema = 1\nname = \"far\"\nrig = \"spindle.toml\"\nduration_seconds = 4.0\n\
                [controller.pid]\nproportional_amperes_per_revolution_per_minute = 0.0003\n\
                integral_amperes_per_revolution_per_minute_second = 0.003\n\
                derivative_ampere_seconds_per_revolution_per_minute = 0.0\n\
                [[reference.step]]\nat_seconds = 0.5\nspeed_revolutions_per_minute = 600.0\n\
                [[expect.signal]]\nname = \"position_metres\"\nstays = { max = 0.15 }\n";
    fs::write(&path, text).unwrap();
    let mut simulate = canrig(&folder.path().join("runs"), "simulate");
    let (code, stdout, stderr) = output(simulate.arg(&path));
    assert_eq!(code, Some(5), "{stdout}{stderr}");
    assert!(
        stdout.contains("beyond what its field holds at 2.6"),
        "{stdout}"
    );
    let run = only_run(&folder.path().join("runs"));
    let table = fs::read_to_string(run.join("signals.csv")).unwrap();
    let mut rows = table.lines().map(|row| row.split(',').collect::<Vec<_>>());
    let header = rows.next().unwrap();
    let place = header.iter().position(|name| *name == "position_metres");
    let cells = Vec::from_iter(rows.map(|row| row[place.unwrap()].to_owned()));
    // The rack has moved by 0.131 m, 65535 steps of 2 micrometres, and moves on.
    assert_eq!(cells.last().unwrap(), "");
    let seen = cells.iter().filter_map(|cell| cell.parse::<f64>().ok());
    let farthest = seen.fold(0.0, f64::max);
    assert!((0.1305..0.131_07).contains(&farthest), "{farthest}");
}

/// Returns the rig `axis` with this amplifier, sensor and motor, and with these node-IDs of
/// controller, drive and io node.
fn axis(amplifier: &str, sensor: &str, motor: &str, [controller, drive, io]: [u8; 3]) -> String {
    let node = |kind: &str, id: u8| format!("kind = {kind:?}\nnode_id = {id}\n");
    let motor = format!("[plant.motor.dc_motor]\n{motor}\n");
    changed_rig(
        "axis",
        &[
            ("min = -1.0, max = 1.0", amplifier),
            (SENSOR, sensor),
            ("[plant.motor.dc_motor]\n", &motor),
            (&node("controller", 1), &node("controller", controller)),
            (&node("drive", 16), &node("drive", drive)),
            (&node("io", 17), &node("io", io)),
        ],
    )
}

/// Returns a step of this axis to 20 mm, under a PID with `gain` times the gains of 1 A.
fn axis_step(unit: &str, per_metre: f64, gain: f64, step: f64) -> String {
    let scaled = |full: f64| full * gain;
    let (p, i, d) = (scaled(60.0), scaled(200.0), scaled(1.5));
    let by = if unit == "metres" || unit == "millimetres" {
        "metre"
    } else {
        unit
    };
    let near = 0.5e-3 * per_metre;
    format!(
        "schema = 1\nrig = \"axis.toml\"\nname = \"axis step\"\nduration_seconds = 1.5\n[controller.pid]\n\
         proportional_amperes_per_{by} = {p:?}\nintegral_amperes_per_{by}_second = {i:?}\n\
         derivative_ampere_seconds_per_{by} = {d:?}\n\
         [[reference.step]]\nat_seconds = 0.1\nposition_{unit} = {step:?}\n\
         [expect]\nsteady_state_error_{unit} = {{ max = {near:?} }}\n\
         [[expect.signal]]\nname = \"true_position_{unit}\"\nfrom_seconds = 1.4\n\
         stays = {{ min = {:?}, max = {:?} }}\n",
        step - near,
        step + near
    )
}

fn played_axis(folder: &Path, rig: &str, scenario: &str) -> PathBuf {
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join("axis.toml"), rig).unwrap();
    let path = folder.join("step.toml");
    fs::write(&path, scenario).unwrap();
    let [alone, together] = in_both_worlds(folder, &path);
    for file in ["bus.log", "signals.csv", "frames.dbc"] {
        let read = |run: &Path| fs::read(run.join(file)).unwrap();
        assert!(read(&alone) == read(&together), "{file}");
    }
    together
}

const SENSOR: &str = "unit = \"millimetres\", min = 0.0, max = 60.0, resolution_bits = 16";
const IDS: [u8; 3] = [1, 0x10, 0x11];

/// The same motor has twenty times the current, and a resistance with the same heat.
#[test]
fn a_drive_of_twenty_amperes_does_with_its_motor_what_one_of_one_ampere_does() {
    let folder = tempfile::tempdir().unwrap();
    let motor = format!(
        "torque_constant_newton_metres_per_ampere = {:?}\nwinding_resistance_ohms = {:?}",
        23.5e-3 / 20.0,
        2.18 / 400.0
    );
    let one = axis("min = -1.0, max = 1.0", SENSOR, "", IDS);
    let twenty = axis("rated = 20.0, min = -20.0, max = 20.0", SENSOR, &motor, IDS);
    let played = |name: &str, rig: &str, gain: f64| {
        let scenario = axis_step("millimetres", 1000.0, gain, 20.0);
        let run = played_axis(&folder.path().join(name), rig, &scenario);
        fs::read_to_string(run.join("signals.csv")).unwrap()
    };
    let [small, large] = [played("one", &one, 1.0), played("twenty", &twenty, 20.0)];
    let column = |text: &str, name: &str| {
        let mut lines = text.lines();
        let place = lines.next().unwrap().split(',').position(|one| one == name);
        let values = lines.map(|line| line.split(',').nth(place.unwrap()).unwrap().parse());
        Vec::from_iter(values.map(|value: Result<f64, _>| value.unwrap_or(f64::NAN)))
    };
    let largest = |values: Vec<f64>| values.into_iter().fold(0.0, f64::max);
    let apart = |name: &str| {
        let values = column(&small, name).into_iter().zip(column(&large, name));
        largest(values.map(|(small, large)| (small - large).abs()).collect())
    };
    assert!(apart("position_millimetres") < 0.02);
    assert!(apart("winding_temperature_celsius") < 0.02);
    let [one, twenty] = [&small, &large].map(|text| largest(column(text, "current_amperes")));
    assert!((0.5..=1.0).contains(&one), "{one}");
    assert!((twenty - 20.0 * one).abs() < 0.05, "{one} {twenty}");
}

#[test]
fn a_command_that_its_frame_cannot_hold_is_refused_with_the_rated_current_to_write() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("axis.toml");
    let check = |amplifier: &str| {
        fs::write(&path, axis(amplifier, SENSOR, "", IDS)).unwrap();
        let (code, stdout, stderr) = output(program(&["check"]).arg(&path));
        (code, format!("{stdout}{stderr}"))
    };
    let (code, said) = check("min = -40.0, max = 40.0");
    assert_eq!(code, Some(3));
    assert!(said.contains("write rated = 1.221 or more"), "{said}");
    let (code, said) = check("rated = 20.0, min = -40.0, max = 40.0");
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("`drive` has no i2t"), "{said}");
    let (_, said) = check("rated = 20.0, max = 1.0");
    assert!(
        said.contains("is 20.0 permille of its amplifier's range"),
        "{said}"
    );
}

/// In millimetres the true position is a float, since no integer of its steps holds ten metres; in metres a count must
/// be finer than the usual one.
#[test]
fn an_axis_of_ten_metres_each_way_is_measured_with_24_bits() {
    let folder = tempfile::tempdir().unwrap();
    let sensor = |unit: &str, end: f64, more: &str| {
        format!("unit = \"{unit}\", min = -{end:?}, max = {end:?}, resolution_bits = 24{more}")
    };
    let rig = |sensor: &str| axis("min = -1.0, max = 1.0", sensor, "", IDS);
    for (unit, end, more, per_metre) in [
        ("millimetres", 10_000.0, "", 1000.0),
        ("metres", 10.0, ", position_increment = 1e-6", 1.0),
    ] {
        let scenario = axis_step(unit, per_metre, 1.0, 0.02 * per_metre);
        let runs = folder.path().join(unit);
        played_axis(&runs, &rig(&sensor(unit, end, more)), &scenario);
    }
    let path = folder.path().join("coarse.toml");
    fs::write(&path, rig(&sensor("metres", 10.0, ""))).unwrap();
    let (code, _, stderr) = output(program(&["check"]).arg(&path));
    assert_eq!(code, Some(3));
    assert!(
        stderr.contains("write position_increment = 0.000001"),
        "{stderr}"
    );
}

/// With these node-IDs the usual identifiers of the second SDO channel, of the truth and of the law's terms are
/// occupied.
#[test]
fn nodes_have_any_node_id_and_no_identifier_twice() {
    let folder = tempfile::tempdir().unwrap();
    let mut found = Vec::new();
    for (place, ids) in [[0x20, 0x30, 0x7F], [0x7F, 0x40, 0x01], [0x05, 0x7E, 0x20]]
        .into_iter()
        .enumerate()
    {
        let rig = axis("min = -1.0, max = 1.0", SENSOR, "", ids);
        let scenario = axis_step("millimetres", 1000.0, 1.0, 20.0);
        let faults = "[[fault.sensor.noise]]\nfrom_seconds = 0.5\nuntil_seconds = 0.6\nnoise_millimetres_rms = 0.01\n";
        let runs = folder.path().join(place.to_string());
        let run = played_axis(&runs, &rig, &(scenario + faults));
        let database = fs::read_to_string(run.join("frames.dbc")).unwrap();
        let messages = database
            .lines()
            .filter_map(|line| line.strip_prefix("BO_ "));
        let mut identifiers = Vec::from_iter(messages.map(|line| line.split(' ').next().unwrap()));
        let count = identifiers.len();
        identifiers.sort_unstable();
        identifiers.dedup();
        assert_eq!(identifiers.len(), count, "{database}");
        let log = fs::read_to_string(run.join("bus.log")).unwrap();
        let sent = |id: u32| log.contains(&format!(" {id:03X}#"));
        assert!(
            sent(0x700 + u32::from(ids[0])) && sent(0x180 + u32::from(ids[1])),
            "{ids:?}"
        );
        found.push(count);
    }
    assert!(found.iter().all(|count| *count > 15), "{found:?}");
}

/// A joint whose loop follows a drive that it does not command, or commands second, by the angle that this drive
/// measures.
#[test]
fn a_loop_follows_what_another_drive_measures() {
    let folder = tempfile::tempdir().unwrap();
    let rig = fs::read_to_string(scenario("rigs/sma_pair.toml")).unwrap();
    let steps = fs::read_to_string(scenario("sma_pair_step.toml")).unwrap();
    let steps = steps.replace("rig = \"sma_pair\"", "rig = \"rig.toml\"");
    let path = folder.path().join("steps.toml");
    fs::write(&path, &steps).unwrap();
    let feedback = "feedback = \"flexor.position\"";
    // The sensor of the flexor is useless, and not used.
    let elsewhere = rig
        .replace(feedback, "feedback = \"extensor.position\"")
        .replace(
            "amplifier.port = \"joint.flexor_current_amperes\"",
            "amplifier.port = \"joint.flexor_current_amperes\"\nsensor = { min = -60.0, max = 60.0, resolution_bits = 2 }",
        );
    assert!(elsewhere.contains("resolution_bits = 2 "));
    fs::write(folder.path().join("rig.toml"), &elsewhere).unwrap();
    let runs = in_both_worlds(folder.path(), &path);
    let [alone, together] = runs
        .each_ref()
        .map(|run| fs::read(run.join("bus.log")).unwrap());
    assert!(alone == together, "simulate and lock-step differ");
    let signals = fs::read_to_string(runs[0].join("signals.csv")).unwrap();
    let header = signals.lines().next().unwrap();
    for column in [
        "angle.position_degrees",
        "angle.flexor.position_degrees",
        "angle.true_position_degrees",
        "extensor.position_degrees",
    ] {
        assert!(header.split(',').any(|one| one == column), "{header}");
    }
    let (code, stdout, stderr) = output(program(&["replay"]).arg(&runs[0]));
    assert_eq!(code, Some(0), "{stdout}{stderr}");

    // If the followed sensor is faulty, the truth is judged as well, as for the sensor of the drive itself.
    let truth = "true_position_degrees_max";
    for (node, is_followed) in [("extensor", true), ("flexor", false)] {
        let fault = format!(
            "[[fault.sensor.offset]]\nnode = \"{node}\"\nfrom_seconds = 6.0\nuntil_seconds = 6.5\noffset_degrees = 0.1\n"
        );
        let limit = "[expect.angle]\nrecovers_within_seconds = 2.0";
        let limited = steps.replace("[expect.angle]", limit);
        fs::write(&path, format!("{limited}\n{fault}")).unwrap();
        let runs = folder.path().join(node);
        let (code, _, stderr) = output(canrig(&runs, "simulate").arg(&path));
        assert!(matches!(code, Some(0 | 1)), "{stderr}");
        let verdict = verdict(&only_run(&runs));
        let rows = verdict["metrics"].as_array().unwrap();
        let is_there = |row: &Value| row["name"] == format!("angle.{truth}").as_str();
        assert_eq!(rows.iter().any(is_there), is_followed, "{node}: {verdict}");
        let recovery = metric(&verdict, "angle.recovers_within_seconds");
        assert!((0.0..2.0).contains(&recovery), "{node}: {recovery}");
    }
}

/// One drive pulls against a weight. Its motion is measured by another drive, which gets no current and is in no loop.
#[test]
fn a_drive_that_is_only_followed_gets_no_current() {
    let folder = tempfile::tempdir().unwrap();
    let rig = fs::read_to_string(scenario("rigs/sma_pair.toml")).unwrap();
    let rig = rig
        .replace(
            "feedback = \"flexor.position\"",
            "feedback = \"extensor.position\"",
        )
        .replace(", \"extensor.current\"]", "]");
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let path = folder.path().join("hold.toml");
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"hold\"\nduration_seconds = 12.0\n\
        [controller.angle.pid]\nproportional_amperes_per_degree = 0.04\nintegral_amperes_per_degree_second = 0.05\n\
        derivative_ampere_seconds_per_degree = 0.006\n\
        [[disturbance.load]]\nat_seconds = 0.0\nadded_grams = 30.0\n\
        [[reference.hold]]\nloop = \"angle\"\nat_seconds = 0.0\nposition_degrees = 5.0\n\
        [[reference.step]]\nloop = \"angle\"\nat_seconds = 5.0\nposition_degrees = 15.0\n\
        [expect.angle]\nsteady_state_error_degrees = { max = 0.5 }\nsettling_time_seconds = { max = 4.0 }\n\
        [expect.extensor]\ncurrent_amperes_rms = { max = 0.001 }\n";
    fs::write(&path, text).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
}

/// Returns the rig `three_motors`, whose drives measure these plants and whose loops follow these
/// drives.
fn crossed_motors([a, b]: [&str; 2], feedback: [&str; 2]) -> String {
    let sensor = |moves: &str, measures: &str| {
        let amplifier = format!("\"{moves}.current_amperes\", min = -1.0 }}\n");
        format!("{amplifier}sensor.port = \"{measures}.position_metres\"")
    };
    let follows = |name: &str, of: &str| format!("[loop.{name}]\nfeedback = \"{of}.position\"");
    changed_rig(
        "three_motors",
        &[
            (&sensor("left", "left"), &sensor("left", a)),
            (&sensor("right", "right"), &sensor("right", b)),
            (&follows("a", "a"), &follows("a", feedback[0])),
            (&follows("b", "b"), &follows("b", feedback[1])),
        ],
    )
}

const MOTORS: &str = "schema = 1\nrig = \"rig.toml\"\nname = \"motors\"\nduration_seconds = 2.5\n\
    [controller.all.pid]\nproportional_amperes_per_metre = 311.0\nintegral_amperes_per_metre_second = 5086.0\n\
    derivative_ampere_seconds_per_metre = 7.01\nset_point_weight = 1.0\nderivative_filter_radians_per_second = 500.0\n\
    [[reference.ramp]]\nloop = \"a\"\nfrom_seconds = 0.1\nuntil_seconds = 0.6\nposition_millimetres = 10.0\n\
    [[reference.ramp]]\nloop = \"b\"\nfrom_seconds = 0.1\nuntil_seconds = 0.6\nposition_millimetres = 20.0\n\
    [[disturbance.load]]\nat_seconds = 1.0\nadded_grams = 300.0\n\
    [[disturbance.fan]]\nfrom_seconds = 1.5\nuntil_seconds = 2.0\nconvection_factor = 3.0\n\
    [[disturbance.output]]\nname = \"current_milliamperes\"\nat_seconds = 1.0\nvalue = 400.0\n\
    [expect.all]\nsteady_state_error_millimetres = { max = 0.02 }\n";

/// Returns time and value of each filled cell of a column of `signals.csv`.
fn column(run: &Path, name: &str) -> Vec<(String, String)> {
    let signals = fs::read_to_string(run.join("signals.csv")).unwrap();
    let mut lines = signals.lines();
    let header = lines.next().unwrap();
    let place = header.split(',').position(|cell| cell == name);
    let place = place.unwrap_or_else(|| panic!("{name}: {header}"));
    let cells = lines.map(|line| {
        let cells = Vec::from_iter(line.split(','));
        (cells[1].to_owned(), cells[place].to_owned())
    });
    cells.filter(|(_, cell)| !cell.is_empty()).collect()
}

/// Each drive moves the part that the other one measures. An io node acts on two plants, two act on one, and a plant
/// that no drive moves is seen in the frames of one.
#[test]
fn nodes_are_wired_to_any_plant() {
    let folder = tempfile::tempdir().unwrap();
    let played = |name: &str, measured: [&str; 2], feedback: [&str; 2]| {
        let folder = folder.path().join(name);
        fs::create_dir_all(&folder).unwrap();
        let rig = crossed_motors(measured, feedback);
        fs::write(folder.join("rig.toml"), rig).unwrap();
        let path = folder.join("motors.toml");
        fs::write(&path, MOTORS).unwrap();
        let [alone, together] = in_both_worlds(&folder, &path);
        for file in ["bus.log", "signals.csv", "verdict.json"] {
            let read = |run: &Path| fs::read(run.join(file)).unwrap();
            assert!(read(&alone) == read(&together), "{name}: {file}");
        }
        let (code, stdout, stderr) = output(program(&["replay"]).arg(&alone));
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        together
    };
    let straight = played("straight", ["left", "right"], ["a", "b"]);
    let crossed = played("crossed", ["right", "left"], ["b", "a"]);
    // These are the same loops over other wires.
    for name in [
        "a.position_millimetres",
        "b.position_millimetres",
        "b.third_position_metres",
    ] {
        let values = |run: &Path| {
            let cells = column(run, name).into_iter();
            Vec::from_iter(cells.map(|(_, value)| value.parse::<f64>().unwrap()))
        };
        // Their commands are at other places of the cycle.
        let (one, other) = (values(&straight), values(&crossed));
        let apart = one
            .iter()
            .zip(&other)
            .map(|(one, other)| (one - other).abs());
        let apart = apart.fold(0.0, f64::max);
        assert!(
            one.len() > 1000 && one.len() == other.len() && apart < 0.02,
            "{name}: {apart}"
        );
    }
    // The third motor rests until its current flows.
    let third = column(&straight, "b.third_position_metres");
    let at = |seconds: f64| {
        let mut cells = third
            .iter()
            .map(|(time, value)| [time, value].map(|cell| cell.parse::<f64>().unwrap()));
        cells.find(|[time, _]| *time >= seconds).unwrap()[1]
    };
    assert!(at(0.9).abs() < 1e-6, "{}", at(0.9));
    assert!(at(2.4) > 5e-3, "{}", at(2.4));
}

/// An ambiguous name of two io nodes requires a choice; an unconnected one is refused at its place.
#[test]
fn an_output_that_two_io_nodes_have_needs_the_name_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let from = "convection_factor = \"left.";
    let to = format!("added_load_grams = \"right.added_load_kilograms\", {from}");
    let rig = changed_rig("three_motors", &[(from, &to)]);
    fs::write(folder.path().join("rig.toml"), &rig).unwrap();
    let path = folder.path().join("motors.toml");
    fs::write(&path, MOTORS).unwrap();
    let (code, _, stderr) = output(program(&["check"]).arg(&path));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("`node` is missing; known are: fan, weight"),
        "{stderr}"
    );
    fs::write(
        &path,
        MOTORS.replace("added_grams", "node = \"fan\"\nadded_grams"),
    )
    .unwrap();
    let (code, stdout, stderr) = output(canrig(&folder.path().join("runs"), "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
}

/// A number without a unit is measured in percent, or in a word that the rig defines.
#[test]
fn a_number_without_a_unit_has_the_word_of_its_sensor() {
    let folder = tempfile::tempdir().unwrap();
    let rig = |unit: &str, max: f64| {
        let (unit, max) = (format!("unit = {unit:?}"), format!("max = {max:?}"));
        let changes = [("unit = \"percent\"", &*unit), ("max = 100.0", &*max)];
        changed_rig("martensite", &changes)
    };
    let play = |unit: &str, full: f64| {
        let folder = folder.path().join(unit);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("rig.toml"), rig(unit, full)).unwrap();
        let path = folder.join("heat.toml");
        // More current gives less martensite, so only a law with its own sign could hold it.
        let text = format!(
            "schema = 1\nrig = \"rig.toml\"\nname = \"heat\"\nduration_seconds = 8.0\n\
             [[controller.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.8\n\
             [[reference.hold]]\nat_seconds = 0.0\nmartensite_{unit} = {:?}\n\
             [expect]\ntracking_error_{unit}_rms = {{ max = {:?} }}\n\
             [[expect.signal]]\nname = \"true_martensite_{unit}\"\nfrom_seconds = 7.0\nstays = {{ min = 0.0, max = {:?} }}\n",
            0.5 * full,
            full,
            0.2 * full
        );
        fs::write(&path, text).unwrap();
        let [_, run] = in_both_worlds(&folder, &path);
        metric(&verdict(&run), &format!("tracking_error_{unit}_rms")) / full
    };
    let (percent, fraction) = (play("percent", 100.0), play("fraction", 1.0));
    assert!((percent - fraction).abs() < 1e-3, "{percent} {fraction}");
    let file = folder.path().join("wrong.toml");
    fs::write(&file, rig("celsius", 1.0)).unwrap();
    let (code, _, stderr) = output(program(&["check"]).arg(&file));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("write unit = \"percent\", or a word of yours"),
        "{stderr}"
    );
}

/// The set-point of a loop in celsius is no temperature of its plant, nor is what the loop measures.
#[test]
fn a_loop_of_a_temperature_is_not_the_temperature_of_its_plant() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = "schema = 1\nrig = \"rig.toml\"\nname = \"warm\"\nduration_seconds = 1.0\n\
        [controller.pid]\nproportional_amperes_per_celsius = 0.1\nintegral_amperes_per_celsius_second = 0.0\n\
        derivative_ampere_seconds_per_celsius = 0.0\n\
        [[reference.hold]]\nat_seconds = 0.0\ntemperature_celsius = 60.0\n\
        [expect]\ntemperature_celsius = { max = 50.0 }\n";
    let path = folder.path().join("warm.toml");
    fs::write(&path, scenario).unwrap();
    let judged = |recorded: &str| {
        let record = format!("record = [{recorded:?}]");
        let rig = changed_rig(
            "winding",
            &[("record = [\"winding_temperature_celsius\"]", &record)],
        );
        fs::write(folder.path().join("rig.toml"), rig).unwrap();
        let runs = folder.path().join(&recorded[..6]);
        let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
        (code, format!("{stdout}{stderr}"))
    };
    let (code, said) = judged("motor_speed_revolutions_per_minute");
    assert!(
        code == Some(5) && said.contains("no temperature of the plant is known"),
        "{said}"
    );
    let (code, said) = judged("winding_temperature_celsius");
    assert!(
        code == Some(0) && said.contains("│ temperature_celsius            ┆    25.54"),
        "{said}"
    );
}

/// Plays the two motors with other tables, on a rig with changes; returns the exit code, the output, and the verdict.
fn motors(more: &str, changes: &[(&str, &str)]) -> (Option<i32>, String, Value) {
    let folder = tempfile::tempdir().unwrap();
    let rig = changed_rig("three_motors", changes);
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let path = folder.path().join("motors.toml");
    fs::write(&path, format!("{MOTORS}{more}")).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
    let verdict = match code {
        Some(3) => Value::Null,
        _ => verdict(&only_run(&runs)),
    };
    let (_, listed, _) = output(program(&["signals"]).arg(&path));
    (code, format!("{stdout}{stderr}{listed}"), verdict)
}

fn is_met(verdict: &Value, name: &str) -> Option<bool> {
    let metrics = verdict["metrics"].as_array().unwrap();
    let metric = metrics.iter().find(|metric| metric["name"] == name);
    metric.unwrap_or_else(|| panic!("{name}: {verdict}"))["passed"].as_bool()
}

/// A signal of several io nodes has one name in the table, in the list and in demands, and its current counts.
#[test]
fn signals_of_several_io_nodes_have_one_name_everywhere() {
    let signal =
        "[[expect.a.signal]]\nname = \"weight.added_load_grams\"\nstays = { max = 400.0 }\n";
    let (code, said, _) = motors(signal, &[]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains(" weight.current_milliamperes "), "{said}");
    let crash =
        "[[fault.node.crash]]\nnode = \"a\"\nfrom_seconds = 2.0\n[expect.a]\nsafe_state = true\n";
    let (code, said, verdict) = motors(crash, &[]);
    // The io node `weight` let 0.4 A flow until it had missed its manager for 0.25 s.
    assert_eq!(
        (code, is_met(&verdict, "a.safe_state")),
        (Some(1), Some(true)),
        "{said}"
    );
}

#[test]
fn what_is_demanded_of_all_loops_holds_beside_the_demands_of_one() {
    let signals = "[[expect.all.signal]]\nname = \"position_millimetres\"\nstays = { max = 15.0 }\n\
        [[expect.b.signal]]\nname = \"current_amperes\"\nstays = { max = 1.5 }\n";
    let (code, said, verdict) = motors(signals, &[]);
    let metrics = verdict["metrics"].as_array().unwrap();
    let missed = metrics.iter().filter(|metric| metric["passed"] == false);
    let missed = Vec::from_iter(missed.map(|metric| metric["name"].as_str().unwrap()));
    assert!(code == Some(1) && missed.len() == 1, "{said}");
    assert!(
        missed[0].starts_with("b.") && missed[0].contains("position_millimetres"),
        "{said}"
    );
}

#[test]
fn the_bus_is_judged_for_as_long_as_one_of_its_loops() {
    let load = |until: &str| {
        let (_, said, verdict) = motors(until, &[]);
        assert!(!verdict.is_null(), "{said}");
        metric(&verdict, "bus_load_percent")
    };
    let whole = load("");
    for name in ["a", "b"] {
        let ended = load(&format!("[expect.{name}]\njudged_until_seconds = 0.05\n"));
        assert!((ended - whole).abs() < 1e-12, "{name}: {ended}, {whole}");
    }
}

#[test]
fn a_limit_of_the_bus_that_is_missed_is_missed_by_no_loop() {
    let (code, said, verdict) = motors("[expect]\nbus_load_percent = { max = 1.0 }\n", &[]);
    let reason = verdict["reason"].as_str().unwrap();
    assert!(
        code == Some(1) && reason.starts_with("the bus load of "),
        "{said}"
    );
    let rows = verdict["metrics"].as_array().unwrap().iter();
    let of_bus = rows.filter(|row| row["name"] == "bus_load_percent");
    assert!(of_bus.map(|row| &row["passed"]).eq([false]), "{verdict}");
}

#[test]
fn what_would_be_judged_on_something_else_is_refused() {
    let contour = "[[expect.contour]]\nloops = [\"a\", \"b\"]\ncontour_error_millimetres_max = { max = 1.0 }\n";
    for (more, reason) in [
        (
            "[[fault.plant.jammed_pulley]]\nplant = \"third\"\nfrom_seconds = 1.0\n",
            "no drive moves this plant",
        ),
        (
            &format!("{contour}{contour}from_seconds = 1.0\n"),
            "`a_b` is the name of two things",
        ),
        (
            &contour.replace("\"b\"]", "\"a_b\"]"),
            "the rig has no loop `a_b`",
        ),
    ] {
        let (code, said, _) = motors(more, &[]);
        assert!(code == Some(3) && said.contains(reason), "{said}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("idle.toml");
    let idle = "schema = 1\nrig = \"two_axes\"\nname = \"idle\"\nduration_seconds = 1.0\n\
        [controller.y.open_loop]\n[controller.x.pid]\n\
        proportional_amperes_per_metre = 22.8\n\
        integral_amperes_per_metre_second = 37.9\n\
        derivative_ampere_seconds_per_metre = 3.59\n\
        [[reference.hold]]\nloop = \"x\"\n\
        at_seconds = 0.0\nposition_millimetres = 10.0\n";
    let contour = contour.replace("\"a\", \"b\"", "\"x\", \"y\"");
    fs::write(&path, format!("{idle}{contour}")).unwrap();
    let (code, _, stderr) = output(program(&["check"]).arg(&path));
    assert!(
        code == Some(3) && stderr.contains("the loop `y` has no set-point"),
        "{stderr}"
    );
}

/// An output of an io node is a column of the loop that it disturbs, whichever loop has the other outputs of the node.
#[test]
fn an_output_of_an_io_node_is_a_signal_of_the_loop_that_it_disturbs() {
    let more = "current_milliamperes = \"third.current_amperes\"\n\
        more_grams = \"right.added_load_kilograms\"";
    let change = [("current_milliamperes = \"third.current_amperes\"", more)];
    let load = "[[disturbance.output]]\nname = \"more_grams\"\nat_seconds = 1.0\nvalue = 100.0\n";
    let stays = |name: &str, in_loop: &str| {
        format!("{load}[[expect.{in_loop}.signal]]\nname = \"{name}\"\nstays = {{ max = 50.0 }}\n")
    };
    let (code, said, _) = motors(&stays("more_grams", "b"), &change);
    assert!(code == Some(1) && said.contains(" more_grams "), "{said}");
    let (code, said, _) = motors(&stays("weight.more_grams", "a"), &change);
    assert!(
        code == Some(3) && said.contains("no signal is called `weight.more_grams`"),
        "{said}"
    );
}

#[test]
fn a_disturbance_of_a_further_drive_s_plant_is_a_signal_of_that_drive() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("rig.toml"), rig("gantry")).unwrap();
    let path = folder.path().join("moves.toml");
    let write = |grams: f64| {
        let text = format!(
            "schema = 1\nrig = \"rig.toml\"\nname = \"moves\"\nduration_seconds = 2.0\n\
             [controller.pid_pair]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
             [[disturbance.load]]\nat_seconds = 1.0\nadded_grams = {grams:?}\n\
             [expect.gantry]\nmaximum_deviation_millimetres = {{ min = 0.0 }}\n\
             [[expect.second.signal]]\nname = \"added_load_grams\"\nreaches = {{ min = 50.0 }}\n"
        );
        fs::write(&path, text).unwrap();
    };
    write(50.0);
    let [_, run] = in_both_worlds(folder.path(), &path);
    assert!(!column(&run, "second.added_load_grams").is_empty());
    write(-100.0);
    let (code, _, stderr) = output(program(&["check"]).arg(&path));
    let said = "nothing is left of the load";
    assert!(code == Some(3) && stderr.contains(said), "{stderr}");
    // The loop would be that of the drive which its law leads besides.
    let path = folder.path().join("rig.toml");
    let rig = changed_rig("gantry", &[("[loop.gantry]", "[loop.second]")]);
    fs::write(&path, rig).unwrap();
    let (code, _, stderr) = output(program(&["check"]).arg(&path));
    assert!(
        code == Some(3) && stderr.contains("the name of two things"),
        "{stderr}"
    );
}

/// The drives of a plant have one CAN controller, so one that loses frames keeps them from all.
#[test]
fn a_receiver_that_loses_frames_excuses_the_drives_that_share_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lost.toml");
    let steps = fs::read_to_string(scenario("sma_pair_step.toml")).unwrap();
    let fault = "[[fault.bus.lose]]\nreceiver = \"flexor\"\nidentifier = 128\nprobability = 0.05\nfrom_seconds = 1.0\n";
    fs::write(&path, steps + fault).unwrap();
    let (code, stdout, stderr) = output(canrig(&folder.path().join("runs"), "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
}

/// Until then the loop is watched, whichever of its drives fails.
#[test]
fn a_recovery_ends_where_a_fault_of_another_drive_begins() {
    let folder = tempfile::tempdir().unwrap();
    let steps = fs::read_to_string(scenario("sma_pair_step.toml")).unwrap();
    let (law, _) = steps.split_once("[[reference.step]]").unwrap();
    let recoveries = ["flexor", "extensor"].map(|node| {
        let path = folder.path().join(format!("{node}.toml"));
        let more = format!(
            "[[disturbance.load]]\nat_seconds = 2.0\nadded_grams = 20.0\n\
             [[fault.amplifier.dead]]\nnode = \"{node}\"\nfrom_seconds = 6.0\n"
        );
        fs::write(&path, law.to_owned() + &more).unwrap();
        let runs = folder.path().join(node);
        let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
        assert!(matches!(code, Some(0 | 1)), "{stdout}{stderr}");
        metric(&verdict(&only_run(&runs)), "angle.recovery_time_seconds")
    });
    assert_eq!(recoveries[0], recoveries[1]);
}

/// A position has the name of the loop that follows it, not of the drive that this loop commands.
#[test]
fn a_program_reads_what_its_loop_follows() {
    let folder = tempfile::tempdir().unwrap();
    let pair = fs::read_to_string(scenario("rigs/sma_pair.toml")).unwrap();
    let (nodes, _) = pair.split_once("[loop.angle]").unwrap();
    let of_loop =
        "[loop.angle]\nfeedback = \"extensor.position\"\noutputs = [\"flexor.current\"]\n";
    fs::write(folder.path().join("rig.toml"), nodes.to_owned() + of_loop).unwrap();
    let path = folder.path().join("program.toml");
    for (reads, writes, said) in [
        ("angle.position_degrees", "flexor.current_amperes", "valid"),
        ("extensor.position_degrees", "current_amperes", "valid"),
        (
            "flexor.position_degrees",
            "current_amperes",
            "cannot read `flexor.position_degrees`",
        ),
        (
            "position_degrees",
            "extensor.current_amperes",
            "does not command the drive `flexor`",
        ),
        (
            "position_degrees",
            "current_amperes\", \"extensor.current_amperes",
            "which is only followed",
        ),
    ] {
        let text = format!(
            "schema = 1\nrig = \"rig.toml\"\nname = \"program\"\nduration_seconds = 1.0\n\
             [controller.angle.program]\ncommand = [\"true\"]\nreads = [\"{reads}\"]\nwrites = [\"{writes}\"]\n\
             [[reference.hold]]\nat_seconds = 0.0\nposition_degrees = 1.0\n"
        );
        fs::write(&path, text).unwrap();
        let (code, stdout, stderr) = output(program(&["check"]).arg(&path));
        let is_valid = code == Some(0);
        assert_eq!(is_valid, said == "valid", "{reads} {writes}: {stderr}");
        assert!(format!("{stdout}{stderr}").contains(said), "{stderr}");
    }
}

/// Returns the rig `idle_motor` with another name of the idle plant; its drive `b` measures the
/// plant `measured`, and the loop `b` follows the drive `followed`.
fn motors_and_an_idle_one(idle: &str, measured: &str, followed: &str) -> String {
    let plant = format!("[plant.{idle}.dc_motor]");
    let output = format!("\"{idle}.convection_factor\"");
    let sensor = format!("sensor.port = \"{measured}.position_metres\"");
    let feedback = format!("[loop.b]\nfeedback = \"{followed}.position\"");
    changed_rig(
        "idle_motor",
        &[
            ("[plant.idle.dc_motor]", &plant),
            ("\"idle.convection_factor\"", &output),
            ("sensor.port = \"mb.position_metres\"", &sensor),
            ("[loop.b]\nfeedback = \"a.position\"", &feedback),
        ],
    )
}

/// Plays both loops with the same set-points, and returns the verdict.
fn played_with_an_idle_one(idle: &str, measured: &str, followed: &str) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let rig = motors_and_an_idle_one(idle, measured, followed);
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let path = folder.path().join("steps.toml");
    let of_loop = ["a", "b"].map(|name| {
        format!(
            "[[reference.hold]]\nloop = \"{name}\"\nat_seconds = 0.0\nposition_millimetres = 5.0\n\
             [[reference.step]]\nloop = \"{name}\"\nat_seconds = 1.0\nposition_millimetres = 6.0\n"
        )
    });
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"steps\"\nduration_seconds = 2.0\n[controller.all.pid]\n\
        proportional_amperes_per_metre = 22.8\n\
        integral_amperes_per_metre_second = 37.9\n\
        derivative_ampere_seconds_per_metre = 3.59\n\
        [[disturbance.fan]]\nfrom_seconds = 1.05\nuntil_seconds = 1.4\nconvection_factor = 3.0\n";
    fs::write(&path, text.to_owned() + &of_loop.concat()).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    verdict(&only_run(&runs))
}

/// The plant without a drive is emulated with those of the first drive, and none of them a second time for another drive.
#[test]
fn a_plant_is_emulated_once_whatever_the_name_of_another() {
    for idle in ["idle", "zidle"] {
        let verdict = played_with_an_idle_one(idle, "ma", "b");
        let [a, b] =
            ["a", "b"].map(|name| metric(&verdict, &format!("{name}.position_millimetres_max")));
        assert_eq!(a, b, "{idle}");
        assert!(a > 5.0, "{idle}: {a}");
    }
}

/// Neither the disturbance of a plant without a loop nor the order of the loops changes a step.
#[test]
fn loops_that_follow_the_same_signal_are_judged_alike() {
    let verdict = played_with_an_idle_one("idle", "mb", "a");
    for name in ["overshoot_percent", "tracking_error_millimetres_rms"] {
        let [a, b] = ["a", "b"].map(|one| metric(&verdict, &format!("{one}.{name}")));
        assert_eq!(a, b, "{name}");
    }
    let rows = verdict["metrics"].as_array().unwrap();
    let names = rows.iter().map(|row| row["name"].as_str().unwrap());
    let disturbed = names.filter(|name| name.contains("deviation"));
    assert_eq!(disturbed.count(), 0, "{verdict}");
}

/// The fan acts on no loop, so it is a column of each, and a disturbance of none.
#[test]
fn an_output_at_an_idle_plant_is_a_column_of_each_loop() {
    let folder = tempfile::tempdir().unwrap();
    let rig = motors_and_an_idle_one("idle", "mb", "a");
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let path = folder.path().join("rest.toml");
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"rest\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n";
    fs::write(&path, text).unwrap();
    let (code, listed, stderr) = output(program(&["signals"]).arg(&path));
    assert_eq!(code, Some(0), "{stderr}");
    let rows = listed
        .lines()
        .filter(|line| line.contains(" convection_factor "));
    assert_eq!(rows.count(), 2, "{listed}");
}

/// The fan at the plant of the other drive is one of the loop that follows that drive, in `check`, in the run and in its replay.
#[test]
fn an_output_at_a_plant_that_is_emulated_elsewhere_is_a_signal_as_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let fan = "[node.xfan]\nkind = \"io\"\nnode_id = 49\noutputs = { convection_factor = \"mb.convection_factor\" }\n";
    let changes = [
        ("[plant.idle.dc_motor]\n", ""),
        ("\"idle.convection_factor\"", "\"ma.convection_factor\""),
    ];
    let rig = changed_rig("idle_motor", &changes);
    fs::write(folder.path().join("rig.toml"), format!("{rig}{fan}")).unwrap();
    let path = folder.path().join("rest.toml");
    let rest = "schema = 1\nrig = \"rig.toml\"\nname = \"rest\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n\
        [[disturbance.fan]]\nnode = \"gust\"\nfrom_seconds = 0.2\nuntil_seconds = 0.4\nconvection_factor = 3.0\n";
    let demand = |name: &str| {
        let signal = format!("[[expect.b.signal]]\nname = \"{name}\"\nreaches = {{ min = 3.0 }}\n");
        fs::write(&path, format!("{rest}{signal}")).unwrap();
        output(program(&["check"]).arg(&path))
    };
    let (code, _, stderr) = demand("convection_factor");
    assert!(
        code == Some(3) && stderr.contains("the name of 2 signals"),
        "{stderr}"
    );
    let (code, _, stderr) = demand("gust.convection_factor");
    assert_eq!(code, Some(0), "{stderr}");
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let run = only_run(&runs);
    assert!(!column(&run, "b.gust.convection_factor").is_empty());
    let (code, stdout, stderr) = output(program(&["replay"]).arg(&run));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let events = fs::read_to_string(run.join("report.html")).unwrap();
    assert_eq!(events.matches("gust: fan, convection × 3").count(), 1);
}

/// A true position counts in the cycles in which it is published, not in those up to the next one.
#[test]
fn true_metrics_do_not_depend_on_how_often_the_truth_is_published() {
    let folder = tempfile::tempdir().unwrap();
    let text = fs::read_to_string(scenario("sma_pair_step.toml")).unwrap();
    let (text, _) = text.split_once("[expect.angle]").unwrap();
    let played = |every_cycles: u8| {
        let path = folder.path().join(format!("every_{every_cycles}.toml"));
        let more = format!(
            "[node.flexor]\ntruth_every_cycles = {every_cycles}\n\
             [[fault.sensor.offset]]\nnode = \"flexor\"\nfrom_seconds = 3.0\nuntil_seconds = 4.0\noffset_degrees = 2.0\n\
             [[expect.angle.signal]]\nname = \"true_position_degrees\"\nstays = {{ min = -40.0, max = 40.0 }}\n"
        );
        fs::write(&path, text.to_owned() + &more).unwrap();
        let runs = folder.path().join(format!("runs_{every_cycles}"));
        let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
        assert_eq!(code, Some(0), "{every_cycles}: {stdout}{stderr}");
        metric(
            &verdict(&only_run(&runs)),
            "angle.true_tracking_error_degrees_rms",
        )
    };
    let (each, fifth) = (played(1), played(5));
    assert!((fifth / each - 1.0).abs() < 1e-3, "{each} {fifth}");
    // The time between two of them is no silence.
    assert!(played(100) > 0.0);
}

/// Both loops are pushed by the weight that hangs on their plant; the io node gets each command once.
#[test]
fn a_disturbance_of_a_plant_that_two_loops_move_is_one_of_both() {
    let folder = tempfile::tempdir().unwrap();
    let pair = fs::read_to_string(scenario("rigs/sma_pair.toml")).unwrap();
    let (nodes, _) = pair.split_once("[loop.angle]").unwrap();
    let loops = [["angle", "flexor"], ["back", "extensor"]].map(|[name, drive]| {
        format!("[loop.{name}]\nfeedback = \"{drive}.position\"\noutputs = [\"{drive}.current\"]\n")
    });
    fs::write(
        folder.path().join("rig.toml"),
        nodes.to_owned() + &loops.concat(),
    )
    .unwrap();
    let path = folder.path().join("pushed.toml");
    let each = ["angle", "back"].map(|name| {
        format!(
            "[[controller.{name}.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.3\n\
             [[reference.hold]]\nloop = \"{name}\"\nat_seconds = 0.0\nposition_degrees = 0.0\n\
             [expect.{name}]\nmaximum_deviation_degrees = {{ min = 1.0, max = 60.0 }}\n\
             [[expect.{name}.signal]]\nname = \"added_load_grams\"\nreaches = {{ min = 50.0 }}\n"
        )
    });
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"pushed\"\nduration_seconds = 4.0\n\
        [[disturbance.load]]\nat_seconds = 2.0\nadded_grams = 50.0\n";
    fs::write(&path, text.to_owned() + &each.concat()).unwrap();
    let [alone, together] = in_both_worlds(folder.path(), &path);
    let read = |run: &Path, file: &str| fs::read_to_string(run.join(file)).unwrap();
    for file in ["bus.log", "signals.csv", "verdict.json"] {
        assert!(read(&alone, file) == read(&together, file), "{file}");
    }
    assert_eq!(read(&alone, "bus.log").matches(" 218#").count(), 1);
    let verdict = verdict(&alone);
    let deviations = ["angle", "back"]
        .map(|name| metric(&verdict, &format!("{name}.maximum_deviation_degrees")));
    assert_eq!(deviations[0], deviations[1]);
}

/// The table of a run with several loops is that of each of them.
#[test]
fn a_signal_of_any_loop_follows_the_table_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("axes.toml");
    let scenario = "schema = 1\nrig = \"two_axes\"\nname = \"axes\"\nduration_seconds = 1.0\n[controller.all.pid]\n\
        proportional_amperes_per_metre = 22.8\n\
        integral_amperes_per_metre_second = 37.9\n\
        derivative_ampere_seconds_per_metre = 3.59\n\
        [[reference.hold]]\nloop = \"x\"\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
        [[reference.hold]]\nloop = \"y\"\nat_seconds = 0.0\nposition_millimetres = 20.0\n";
    fs::write(&path, scenario).unwrap();
    let runs = folder.path().join("runs");
    output(canrig(&runs, "simulate").arg(&path));
    let table = only_run(&runs).join("signals.csv");
    fs::copy(table, folder.path().join("golden.csv")).unwrap();
    let follows = "[[expect.all.signal]]\nname = \"position_millimetres\"\n\
        follows = { file = \"golden.csv\", tolerance = 0.1 }\n";
    fs::write(&path, format!("{scenario}{follows}")).unwrap();
    let again = folder.path().join("again");
    let (code, stdout, stderr) = output(canrig(&again, "simulate").arg(&path));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
}

/// The bus is judged as long as one of its loops, so the row of the run is that of a loop that missed it.
#[test]
fn a_limit_of_the_bus_that_one_loop_missed_is_shown_as_missed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stops.toml");
    let hold = |name: &str| {
        format!(
            "[[reference.hold]]\nloop = \"{name}\"\nat_seconds = 0.0\nposition_millimetres = 10.0\n"
        )
    };
    let scenario = format!(
        "schema = 1\nrig = \"two_axes\"\nname = \"stops\"\nduration_seconds = 3.0\n[controller.all.pid]\n\
         proportional_amperes_per_metre = 22.8\n\
         integral_amperes_per_metre_second = 37.9\n\
         derivative_ampere_seconds_per_metre = 3.59\n\
         {}{}\
         [[fault.node.crash]]\nnode = \"controller\"\nfrom_seconds = 2.0\n\
         [expect]\nsync_interval_milliseconds_max = {{ max = 3.0 }}\n[expect.x]\njudged_until_seconds = 1.0\n",
        hold("x"),
        hold("y")
    );
    fs::write(&path, scenario).unwrap();
    let runs = folder.path().join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    let verdict = verdict(&only_run(&runs));
    let met = is_met(&verdict, "sync_interval_milliseconds_max");
    assert_eq!(met, Some(false), "{verdict}");
}

/// A drive that publishes the temperature of another plant does not know that of its own.
#[test]
fn the_temperature_of_another_plant_is_not_that_of_its_own() {
    let limit = "[expect.b]\ntemperature_celsius = { max = 50.0 }\n";
    for (recorded, met) in [("left", None), ("right", Some(true))] {
        let recorded = format!("\"{recorded}.winding_temperature_celsius\"");
        let (_, said, verdict) = motors(limit, &[("\"third.position_metres\"", &recorded)]);
        assert_eq!(is_met(&verdict, "b.temperature_celsius"), met, "{said}");
    }
}

/// The currents of a pair are limited together; a reaction is demanded where there is a fault.
#[test]
fn what_is_demanded_of_all_drives_holds_for_a_further_drive() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = fs::read_to_string(scenario("sma_pair_step.toml")).unwrap();
    let (scenario, _) = shipped.split_once("[expect").unwrap();
    let played = |name: &str, more: &str| {
        let path = folder.path().join(format!("{name}.toml"));
        fs::write(&path, format!("{scenario}{more}")).unwrap();
        let runs = folder.path().join(name);
        let (_, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
        assert!(runs.exists(), "{stdout}{stderr}");
        verdict(&only_run(&runs))
    };
    for table in ["expect", "expect.all"] {
        let limits = format!("[{table}]\ncurrent_amperes_rms = {{ max = 0.3 }}\n");
        let verdict = played(&table.replace('.', "_"), &limits);
        assert_eq!(
            is_met(&verdict, "extensor.current_amperes_rms"),
            Some(false)
        );
    }
    let limits = "[expect]\ncurrent_amperes_rms = { max = 0.3 }\nmissed_cycles_percent = { max = 1.0 }\n\
        [expect.requirements]\ncurrent_amperes_rms = [\"REQ-7\"]\n\
        [[fault.node.hang]]\nnode = \"extensor\"\nfrom_seconds = 1.0\nuntil_seconds = 1.3\n";
    let hung = played("hung", limits);
    let row = |name: &str| {
        let mut rows = hung["metrics"].as_array().unwrap().iter();
        rows.find(|row| row["name"] == name).unwrap()
    };
    for drive in ["angle", "extensor"] {
        let row = row(&format!("{drive}.current_amperes_rms"));
        assert_eq!(row["requirements"][0], "REQ-7", "{row}");
    }
    assert_eq!(is_met(&hung, "extensor.missed_cycles_percent"), Some(false));
    let crash = "[expect]\nsafe_state = true\n[[fault.node.crash]]\nfrom_seconds = 1.0\nnode = ";
    let verdict = played("flexor", &format!("{crash}\"flexor\"\n"));
    assert_eq!(is_met(&verdict, "angle.safe_state"), Some(true));
    let metrics = verdict["metrics"].as_array().unwrap();
    let mut of_further = metrics
        .iter()
        .filter(|metric| metric["name"] == "extensor.safe_state");
    assert!(
        of_further.all(|metric| metric["passed"].is_null()),
        "{verdict}"
    );
}

/// An io node heats the other wire of a pair when the controller dies: its own watch (0x1016)
/// switches it off, and the current counts until then.
#[test]
fn a_current_of_an_io_node_ends_with_its_watch_over_its_manager() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("rig.toml"), rig("heated_pair")).unwrap();
    let played = |name: &str, more: &str| {
        let path = folder.path().join(format!("{name}.toml"));
        let text = format!(
            "schema = 1\nrig = \"rig.toml\"\nname = \"{name}\"\nduration_seconds = 2.0\n[controller.open_loop]\n\
             [[controller.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.3\n\
             [[disturbance.output]]\nname = \"current_milliamperes\"\nat_seconds = 0.5\nvalue = 800.0\n\
             [[fault.node.crash]]\nfrom_seconds = 1.0\nnode = \"hand\"\n\
             [expect]\nsafe_state = true\n{more}"
        );
        fs::write(&path, text).unwrap();
        let runs = folder.path().join(name);
        let (_, stdout, stderr) = output(canrig(&runs, "simulate").arg(&path));
        assert!(runs.exists(), "{stdout}{stderr}");
        verdict(&only_run(&runs))
    };
    let verdict = played("watched", "current_zero_within_milliseconds = 300.0\n");
    assert_eq!(is_met(&verdict, "safe_state"), Some(true), "{verdict}");
    let mut rows = verdict["metrics"].as_array().unwrap().iter();
    let zero = rows.find(|row| row["name"] == "current_zero_within_milliseconds");
    let milliseconds = zero.and_then(|row| row["value"].as_f64()).unwrap();
    assert!((200.0..=260.0).contains(&milliseconds), "{verdict}");
}
