//! Tests of a scenario's values for its rig: values that are read, values that are refused, and the places of the errors.

use std::io;
use std::path::Path;

use crate::Asked;
use crate::beside::Beside;
use crate::error::{Problem, ScenarioError};
use crate::scenario::Scenario;
use crate::trial::Trial;

/// A rig with an emulated drive and a real one; the plant of the real one is unknown.
const RIG: &str = r#"
schema = 1
name = "a motor and a real drive"
[bus]
sync_period_milliseconds = 4.0
[plant.motor.dc_motor]
load_kilograms = 0.4
[node.controller]
kind = "controller"
node_id = 1
[node.axis]
kind = "drive"
node_id = 0x10
amplifier = { port = "motor.current_amperes", rated = 1.0, min = -1.0, max = 1.0 }
sensor = { port = "motor.position_metres", min = 0.0, max = 60.0, resolution_bits = 16 }
[node.lift]
kind = "drive"
node_id = 0x30
[node.lift.limits]
current_amperes = 0.9
min = -1.0
max = 45.0
rate_max = 400.0
[node.lift.timeouts]
bring_up_seconds = 20.0
[loop.axis]
feedback = "axis.position"
outputs = ["axis.current"]
[loop.lift]
feedback = "lift.position"
outputs = ["lift.current"]
"#;

const HEAD: &str = "schema = 1\nname = \"t\"\nduration_seconds = 3.0\n[controller.all.open_loop]\n";
/// Line at which the tables of a test begin; the rig is named four lines before.
const BEGIN: i32 = 6;

fn scenario(rig: &str, tables: &str) -> String {
    let name = format!("schema = 1\nrig = \"{rig}\"\n");
    HEAD.replacen("schema = 1\n", &name, 1) + tables
}

fn read_file(name: &str) -> io::Result<String> {
    match name {
        "rig.toml" => Ok(RIG.to_owned()),
        _ => Err(io::ErrorKind::NotFound.into()),
    }
}

fn load(rig: &str, tables: &str) -> Result<Scenario, ScenarioError> {
    let beside = Beside::new(Path::new("s.toml"));
    let text = scenario(rig, tables);
    Scenario::parse(&beside, text, &mut read_file, &Asked::default())
}

/// Returns the problems of a scenario, each of which is in its text, and their rendering.
#[track_caller]
fn refused(rig: &str, tables: &str) -> (Vec<Problem>, String) {
    let error = load(rig, tables).expect_err(tables);
    let shown = crate::without_colours(&error);
    let problems = error.problems().to_vec();
    let are_here = problems.iter().all(|one| one.file_name() == "s.toml");
    assert!(are_here, "{shown}");
    (problems, shown)
}

/// Checks the one problem of some tables: the line counted from the first of them, the column, the message and the label.
#[track_caller]
fn check(rig: &str, tables: &str, (line, column): (i32, usize), message: &str, label: &str) {
    let (problems, shown) = refused(rig, tables);
    let [problem] = &problems[..] else {
        panic!("{shown}");
    };
    assert_eq!(problem.to_string(), message, "{shown}");
    assert!(shown.contains(&format!("─ {label}\n")), "{label}: {shown}");
    let (found, found_column) = problem.line_and_column().unwrap();
    let found = i32::try_from(found).unwrap() - BEGIN + 1;
    assert_eq!((found, found_column), (line, column), "{shown}");
}

#[test]
fn values_take_the_places_of_those_of_the_rig() {
    let tables = "[bus]\nbitrate_kilobits_per_second = 500\n[plant.motor]\ngear_ratio = 20.0\n\
        [node.axis]\ntruth_every_cycles = 7\nsensor.noise_rms = 0.1\n[node.lift.timeouts]\nsdo_answer_milliseconds = 900\n";
    let loops = load("rig.toml", tables).unwrap();
    let [axis, lift] = &loops.loops[..] else {
        panic!("{loops:?}")
    };
    for bus in [&loops.shared.rig.bus, &axis.run.bus, &lift.run.bus] {
        assert_eq!(bus.bitrate_kilobits_per_second, 500);
        assert!((bus.sync_period_milliseconds - 4.0).abs() < 1e-12);
    }
    let motor = axis.plant().dc_motor.as_ref().unwrap();
    assert!((motor.gear_ratio - 20.0).abs() < 1e-12);
    assert!((motor.load_kilograms - 0.4).abs() < 1e-12);
    let sensor = &axis.sensor;
    assert_eq!(sensor.resolution_bits(), 16);
    assert!((sensor.noise_rms() - 0.1).abs() < 1e-12);
    assert_eq!(loops.shared.rig.node["axis"].truth_every_cycles, Some(7));
    let timeouts = loops.shared.rig.real_drive("lift").unwrap().timeouts;
    assert_eq!(timeouts.sdo_answer_milliseconds, 900);
    assert!((timeouts.bring_up_seconds - 20.0).abs() < 1e-12);
}

#[test]
fn what_the_rig_does_not_have_gets_no_values() {
    for (tables, place, message, label) in [
        (
            "[plant.wir.heat]\nambient_celsius = 20.0\n",
            (1, 8),
            "the rig has no plant `wir`",
            "did you mean `wire`?",
        ),
        (
            "[plant.heat]\nambient_celsius = 20.0\n",
            (1, 8),
            "the rig has no plant `heat`",
            "known are: wire",
        ),
        (
            "[node.drve.sensor]\nnoise_rms = 0.1\n",
            (1, 7),
            "the rig has no node `drve`",
            "did you mean `drive`?",
        ),
        (
            "[node.drive.sensr]\nnoise_rms = 0.1\n",
            (1, 13),
            "`drive` of the rig has no sensr",
            "did you mean `sensor`?",
        ),
        (
            "[node.drive.timeouts]\nbring_up_seconds = 5.0\n",
            (1, 13),
            "`drive` of the rig has no timeouts",
            "a scenario gives other values and adds nothing",
        ),
        (
            "[node.disturbance.sensor]\nnoise_rms = 0.1\n",
            (1, 19),
            "`disturbance` of the rig has no sensor",
            "a scenario gives other values and adds nothing",
        ),
        (
            "[node.drive]\ntruth_every_cycle = 5\n",
            (2, 1),
            "`drive` of the rig has no truth_every_cycle",
            "did you mean `truth_every_cycles`?",
        ),
        (
            "[loop.position]\noutputs = []\n",
            (1, 2),
            "unknown key `loop` in the scenario",
            "a table of rig files",
        ),
        (
            "[plant.wire.dc_motor]\ngear_ratio = 2.0\n",
            (1, 13),
            "the model of `wire` is `sma`, not `dc_motor`",
            "a scenario gives other values and no other model",
        ),
        (
            "[node]\ndrive = 3\n",
            (2, 9),
            "`node.drive` must be a table",
            "this is an integer",
        ),
    ] {
        check("sma_actuator", tables, place, message, label);
    }
    let (_, shown) = refused("sma_actuator", "[plant.motor]\nload_kilograms = 1.0\n");
    assert!(shown.contains("play it on a rig that has this"), "{shown}");
}

#[test]
fn how_a_rig_is_wired_is_said_by_its_file_alone() {
    for (tables, place, key) in [
        ("[node.drive]\nnode_id = 3\n", (2, 1), "node_id"),
        ("[node.drive]\nkind = \"io\"\n", (2, 1), "kind"),
        ("[node.drive]\nexternal = true\n", (2, 1), "external"),
        ("[node.drive.sensor]\nunit = \"degrees\"\n", (2, 1), "unit"),
        (
            "[node.drive.amplifier]\nmax = 0.5\nport = \"wire.current_amperes\"\n",
            (3, 1),
            "port",
        ),
        (
            "[node.disturbance.outputs]\nadded_load_grams = \"wire.x\"\n",
            (1, 19),
            "outputs",
        ),
    ] {
        let message = format!("a scenario cannot give its rig another `{key}`");
        check(
            "sma_actuator",
            tables,
            place,
            &message,
            "only the rig file says this",
        );
    }
}

/// The rig file guarantees the limits of a real drive.
#[test]
fn no_scenario_changes_the_limits_of_a_real_drive() {
    check(
        "rig.toml",
        "[node.lift.limits]\ncurrent_amperes = 1.0\n",
        (1, 12),
        "a scenario cannot change the limits of `lift`",
        "they stand in the rig file and hold whatever a scenario says",
    );
}

#[test]
fn a_wrong_value_of_a_plant_is_shown_where_it_stands_without_the_name_of_the_model() {
    for (rig, tables, place, message, label) in [
        (
            "sma_actuator",
            "[plant.wire.heat]\nambient_celcius = 20.0\n",
            (2, 1),
            "unknown key `ambient_celcius` in [plant.wire.heat]",
            "did you mean `ambient_celsius`?",
        ),
        (
            "sma_actuator",
            "[plant.wire.het]\nambient_celsius = 20.0\n",
            (1, 13),
            "unknown key `het` in [plant.wire]",
            "did you mean `heat`?",
        ),
        (
            "sma_actuator",
            "[plant.wire.heat]\nambient_celsius = \"warm\"\n",
            (2, 19),
            "`plant.wire.heat.ambient_celsius` must be a number",
            "this is a string",
        ),
        (
            "sma_actuator",
            "[plant.wire.phase]\naustenite_finish_celsius = 50.0\n",
            (2, 28),
            "`austenite_finish_celsius` must be above `austenite_start_celsius`",
            "must be above 53",
        ),
        (
            "rig.toml",
            "[plant.motor]\nload_kilograms = -1.0\n",
            (2, 18),
            "`plant.motor.load_kilograms` = -1 is out of range",
            "must be from 0 to 100",
        ),
        (
            "sma_actuator",
            "[plant.wire.sma.heat]\nambient_celsius = 20.0\n",
            (1, 13),
            "unknown key `sma` in [plant.wire]",
            "write [plant.wire], without the name of the model",
        ),
    ] {
        check(rig, tables, place, message, label);
    }
}

#[test]
fn a_wrong_value_of_a_node_or_the_bus_is_shown_where_it_stands() {
    for (tables, place, message, label) in [
        (
            "[node.drive.sensor]\nnoise_rms = 1e9\n",
            (2, 13),
            "`node.drive.sensor.noise_rms` = 1000000000 is out of range",
            "must be from 0 to 1000000",
        ),
        (
            "[node.drive.amplifier]\ncurrent_amperes_max = 0.5\n",
            (2, 1),
            "unknown key `current_amperes_max` in [node.drive.amplifier]",
            "not a key of the format",
        ),
        (
            "[bus]\nbitrate_kilobits_per_second = 300\n",
            (2, 31),
            "`bus.bitrate_kilobits_per_second` = 300 is out of range",
            "must be one of: 10, 20, 50, 125, 250, 500, 800, 1000",
        ),
        (
            "[node.drive]\nsensor = 3\n",
            (2, 10),
            "`node.drive.sensor` must be a table",
            "this is an integer",
        ),
        (
            "[node.drive.sensor]\nmax = -1.0\n",
            (2, 7),
            "the range of `drive` ends where it has not begun",
            "must be above 0, its lowest",
        ),
        (
            "[node.drive.sensor]\nmin = 70.0\n",
            (-3, 7),
            "the range of `drive` ends where it has not begun",
            "the lowest",
        ),
    ] {
        check("sma_actuator", tables, place, message, label);
    }
}

#[test]
fn all_that_is_wrong_is_said_at_once() {
    let tables = "[bus]\nsync_period_milliseconds = 0.0\n[plant.wir]\n[node.drive.sensor]\nnoise_rms = -1.0\n\
        [node.drve]\n[expect]\novershoot_percent = { min = 2.0, max = 1.0 }\n";
    let (problems, shown) = refused("sma_actuator", tables);
    let lines = problems.iter().filter_map(Problem::line_and_column);
    assert!(
        lines.map(|(line, _)| line).eq([7, 8, 10, 11, 13]),
        "{shown}"
    );
}

/// A problem of the rig file is shown there, whatever other values the scenario has.
#[test]
fn a_mistake_in_the_rig_file_is_shown_in_the_rig_file() {
    for (right, wrong, said, line) in [
        (
            "schema = 1",
            "schema = 2",
            "`schema` = 2 is out of range",
            2,
        ),
        (
            "load_kilograms = 0.4",
            "load_kilograms = -0.4",
            "`plant.motor.dc_motor.load_kilograms` = -0.4 is out of range",
            7,
        ),
        (
            "[plant.motor.dc_motor]\nload_kilograms = 0.4",
            "[plant.motor.sma.phase]\naustenite_finish_celsius = 50.0",
            "`austenite_finish_celsius` must be above `austenite_start_celsius`",
            7,
        ),
        (
            "[node.axis]",
            "[limits]\n[node.axis]",
            "a drive is a node of a rig file",
            11,
        ),
    ] {
        let rig = RIG.replacen(right, wrong, 1);
        let beside = Beside::new(Path::new("s.toml"));
        let text = scenario("rig.toml", "[bus]\nsync_period_milliseconds = 2.0\n");
        let mut read = |_: &str| Ok(rig.clone());
        let loaded = Scenario::parse(&beside, text, &mut read, &Asked::default());
        let error = loaded.expect_err(wrong);
        let shown = crate::without_colours(&error);
        let [problem] = error.problems() else {
            panic!("{shown}");
        };
        assert_eq!(problem.to_string(), said, "{shown}");
        assert_eq!(problem.file_name(), "rig.toml", "{shown}");
        assert_eq!(problem.line_and_column().map(|(line, _)| line), Some(line));
    }
}

#[test]
fn a_section_without_a_law_is_shown_where_it_is() {
    let text = scenario("sma_actuator", "").replace("[controller.all.open_loop]", "[controller]");
    let error = Trial::parse(&text, "s.toml", read_file).unwrap_err();
    let [problem] = error.problems() else {
        panic!("{error:?}");
    };
    assert_eq!(problem.to_string(), "no control law");
    assert_eq!(problem.line_and_column(), Some((5, 2)));
}
