use std::fs;

use crate::Asked;
use crate::beside::Beside;
use crate::error::ScenarioError;
use crate::expect::Limit;
use crate::rig::nodes::{Rig, Sensor};
use crate::scenario::Scenario;
use crate::trial::Trial;

const RIG: &str = r#"
schema = 1
name = "two axes"
[bus]
sync_period_milliseconds = 2.0
[defaults.drive]
amplifier = { rated = 1.0, min = -1.0, max = 1.0 }
sensor = { unit = "millimetres", min = 0.0, max = 60.0, resolution_bits = 16 }
[plant.gantry_x.dc_motor]
[plant.gantry_y.dc_motor]
load_kilograms = 0.5
[node.controller]
kind = "controller"
node_id = 1
[node.x]
kind = "drive"
node_id = 0x10
amplifier.port = "gantry_x.current_amperes"
sensor.port = "gantry_x.position_metres"
[node.y]
kind = "drive"
node_id = 0x12
amplifier.port = "gantry_y.current_amperes"
sensor = { port = "gantry_y.position_metres", resolution_bits = 12 }
[loop.x]
feedback = "x.position"
outputs = ["x.current"]
[loop.y]
feedback = "y.position"
outputs = ["y.current"]
"#;

const SCENARIO: &str = r#"
schema = 1
name = "two moves"
rig = "rig.toml"
duration_seconds = 3.0
[controller.all.pid]
proportional_amperes_per_metre = 22.8
integral_amperes_per_metre_second = 37.9
derivative_ampere_seconds_per_metre = 3.59
[plant.gantry_x]
load_kilograms = 0.3
[[reference.hold]]
loop = "x"
at_seconds = 1.0
position_millimetres = 20.0
[[reference.hold]]
loop = "y"
at_seconds = 2.0
position_millimetres = 10.0
[[fault.sensor.noise]]
node = "y"
from_seconds = 2.5
noise_millimetres_rms = 0.1
[[fault.node.hang]]
node = "x"
from_seconds = 1.5
[[fault.node.hang]]
node = "controller"
from_seconds = 1.6
until_seconds = 1.61
[expect.x]
tracking_error_millimetres_rms = { max = 0.2 }
"#;

fn load_text(scenario: &str, rig: &str) -> Result<Scenario, String> {
    let loaded = load_files(scenario, rig);
    loaded.map_err(|error| crate::without_colours(&error))
}

fn load_files(scenario: &str, rig: &str) -> Result<Scenario, ScenarioError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scenario.toml");
    fs::write(&path, scenario).unwrap();
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let beside = Beside::new(&path);
    let mut read = |name: &str| beside.read(name);
    let text = scenario.to_owned();
    Scenario::parse(&beside, text, &mut read, &Asked::default())
}

/// Returns the number of a loop's faults of a kind.
fn faults(one: &Trial, kind: &str) -> usize {
    let faults = one.loop_faults();
    faults.filter(|fault| fault.kind.name == kind).count()
}

#[test]
fn each_loop_has_what_the_scenario_and_the_rig_say_of_it() {
    let loops = load_text(SCENARIO, RIG).unwrap();
    let [x, y] = &loops.loops[..] else {
        panic!("{loops:?}")
    };
    let place = |one: &Trial| {
        (
            one.wiring.loop_name.clone(),
            one.wiring.drive().id(),
            one.wiring.io_nodes().count(),
        )
    };
    assert_eq!(place(x), ("x".to_owned(), 0x10, 0));
    assert_eq!(place(y), ("y".to_owned(), 0x12, 0));
    for one in [x, y] {
        assert_eq!(one.run.name, "two moves");
        assert!((one.run.bus.sync_period_milliseconds - 2.0).abs() < 1e-12);
        assert!((one.amplifier.range().min + 1.0).abs() < 1e-12);
        assert!(one.controller.pid.is_some());
        assert_eq!(one.reference.hold.len(), 1);
    }
    let load = |one: &Trial| one.plant().load_kilograms();
    assert_eq!((load(x), load(y)), (Some(0.3), Some(0.5)));
    assert_eq!(x.sensor.resolution_bits(), 16);
    assert_eq!(y.sensor.resolution_bits(), 12);
    assert_eq!(faults(x, "noise"), 0);
    assert_eq!(faults(y, "noise"), 1);
    // A fault of the controller belongs to all loops.
    assert_eq!(faults(x, "hang"), 2);
    assert_eq!(faults(y, "hang"), 1);
    assert!(x.expect.of("tracking_error_{unit}_rms").is_some());
    assert!(y.expect.of("tracking_error_{unit}_rms").is_none());
}

#[test]
fn what_a_scenario_names_wrongly_is_underlined_once() {
    for (right, wrong, said) in [
        ("loop = \"y\"", "loop = \"z\"", "the rig has no loop `z`"),
        ("node = \"y\"", "node = \"yy\"", "did you mean `y`?"),
        ("loop = \"y\"\n", "", "for which loop?"),
        (
            "[controller.all.pid]",
            "[controller.x.pid]",
            "no law closes the loop `y`",
        ),
        ("[expect.x]", "[expect.z]", "the rig has no loop `z`"),
        ("rig = \"rig.toml\"\n", "", "the scenario names no rig"),
        ("\"rig.toml\"", "3", "`rig` must be a string"),
        (
            "\"rig.toml\"",
            "\"../rig.toml\"",
            "must lie in the scenario's folder",
        ),
        (
            "\"rig.toml\"",
            "\"rig.dbc\"",
            "no rig that ships is called `rig.dbc`",
        ),
        (
            "\"rig.toml\"",
            "\"./scenario.toml\"",
            "`./scenario.toml` is this scenario itself",
        ),
        (
            "duration_seconds",
            "duration_second",
            "did you mean `duration_seconds`?",
        ),
        ("[expect.x]", "[buss]", "unknown key `buss` in the scenario"),
        ("rig.toml", "ring.toml", "ring.toml does not exist"),
        (
            "duration_seconds = 3.0",
            "duration_seconds = -3.0",
            "-3 is out of range",
        ),
        (
            "load_kilograms = 0.3",
            "load_kilogram = 0.3",
            "did you mean `load_kilograms`?",
        ),
    ] {
        let text = SCENARIO.replacen(right, wrong, 1);
        let error = load_text(&text, RIG).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
        assert_eq!(error.matches(said).count(), 1, "{wrong}: {error}");
    }
}

#[test]
fn a_table_under_the_wrong_key_is_one_problem() {
    for (right, wrong, said) in [
        (
            "[[reference.hold]]\nloop = \"y\"\n",
            "[[reference.y.hold]]\n",
            "unknown key `y` in [reference]",
        ),
        (
            "[controller.all.pid]",
            "[controller.y]\n[controller.x.pid]",
            "name the law: [controller.y.pid]",
        ),
    ] {
        let text = SCENARIO.replacen(right, wrong, 1);
        let error = load_files(&text, RIG).unwrap_err();
        let shown = crate::without_colours(&error);
        assert_eq!(error.problems().len(), 1, "{shown}");
        assert!(shown.contains(said), "{shown}");
    }
}

#[test]
fn what_is_wrong_with_a_rig_names_both_places() {
    for (right, wrong, said) in [
        (
            "node_id = 0x12",
            "node_id = 0x10",
            "`x` and `y` have the same node-ID 16",
        ),
        (
            "outputs = [\"y.current\"]",
            "outputs = []",
            "`loop.y.outputs` has 0 entries",
        ),
        (
            "outputs = [\"y.current\"]",
            "outputs = [\"x.current\"]",
            "the drive `x` is in two loops",
        ),
        (
            "outputs = [\"y.current\"]",
            "outputs = [\"y.current\", \"y.current\"]",
            "the drive `y` is twice in the loop `y`",
        ),
        (
            "kind = \"controller\"",
            "kind = \"io\"",
            "nobody leads the drives",
        ),
        (
            "gantry_y.current",
            "gantry_x.current",
            "two nodes drive the port",
        ),
        (
            "gantry_y.current",
            "gantry_z.current",
            "there is no plant `gantry_z`",
        ),
        ("[loop.y]", "[loop.all]", "a loop cannot be called `all`"),
        (
            "[plant.gantry_y.dc_motor]",
            "[plant.x.dc_motor]",
            "`x` is the name of two things",
        ),
    ] {
        let error = load_text(SCENARIO, &RIG.replacen(right, wrong, 1)).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
    }
}

#[test]
fn a_rig_that_could_be_misread_is_refused() {
    for (right, wrong, said) in [
        (
            "[node.controller]",
            "[node.bench]",
            "a node cannot be called `bench`",
        ),
        (
            "[plant.gantry_y.dc_motor]",
            "[plant.bus.dc_motor]",
            "a plant cannot be called `bus`",
        ),
        ("[loop.y]", "[loop.pid]", "a loop cannot be called `pid`"),
        (
            "[loop.y]",
            "[loop.contour]",
            "a loop cannot be called `contour`",
        ),
        (
            "[loop.y]",
            "[loop.sine_gain]",
            "a loop cannot be called `sine_gain`",
        ),
        (
            "[loop.y]",
            "[loop.hunting_millimetres]",
            "a loop cannot be called `hunting_millimetres`",
        ),
        (
            "[loop.y]",
            "[loop.requirements]",
            "a loop cannot be called `requirements`",
        ),
        ("[loop.y]", "[loop.Y]", "`Y` can be no name of a loop"),
        (
            "[plant.gantry_y.dc_motor]",
            "[plant.gantry_z.dc_motor]\n[plant.gantry_y.dc_motor]",
            "no node names the plant `gantry_z`",
        ),
        ("schema = 1", "schema = 2", "`schema` = 2 is out of range"),
        (
            "[loop.x]",
            "[controller.all.pid]\n[loop.x]",
            "this is a scenario, not a rig file",
        ),
        (
            "[bus]",
            "[limits]\n[bus]",
            "a drive is a node of a rig file",
        ),
    ] {
        let error = load_text(SCENARIO, &RIG.replacen(right, wrong, 1)).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
    }
}

#[test]
fn a_rig_file_of_a_drive_without_a_node_is_told_so_and_nothing_else() {
    let drive_fault =
        "schema = 1\nname = \"one\"\n[drive]\nnode_id = 3\n[limits]\ncurrent_amperes = 1.0\n";
    let error = load_text(SCENARIO, drive_fault).unwrap_err();
    assert!(error.contains("a drive is a node of a rig file"), "{error}");
    assert_eq!(error.matches("help:").count(), 1, "{error}");
}

#[test]
fn emergencies_are_of_the_nodes_as_the_rig_calls_them() {
    let expecting = |emcy: &str| {
        let expect = format!(
            "[[expect.y.sequence]]\nname = \"it ends\"\nevent = [{{ emcy = \"{emcy}\" }}]\n[expect.y]\nemcy = [\"{emcy}\"]\n"
        );
        format!("{SCENARIO}\n{expect}")
    };
    for emcy in ["y 0x8130", "x 0x8130", "controller 0x7300"] {
        let loops = load_text(&expecting(emcy), RIG).unwrap().loops;
        let expect = &loops[1].expect;
        assert_eq!(expect.listed("emcy"), [emcy]);
        let event = &expect.sequence[0].event[0];
        assert_eq!(event.emcy.as_deref(), Some(emcy));
    }
    for (emcy, said) in [
        ("drive 0x8130", "the rig has no node `drive`"),
        ("yy 0x8130", "the rig has no node `yy`"),
        ("y 8130", "names no emergency"),
    ] {
        let error = load_text(&expecting(emcy), RIG).unwrap_err();
        assert!(error.contains(said), "{emcy}: {error}");
    }
}

/// Copies of a default and consequences of another mistake are not reported.
#[test]
fn a_mistake_is_said_once() {
    for (right, wrong, said, unsaid) in [
        (
            "min = -1.0",
            "mn = -1.0",
            "unknown key `mn` in [defaults.drive.amplifier]",
            "[node.x.amplifier]",
        ),
        (
            "resolution_bits = 16",
            "resolution_bits = 99",
            "`defaults.drive.sensor.resolution_bits` = 99 is out of range",
            "`node.x",
        ),
        (
            "outputs = [\"y.current\"]",
            "outputs = [\"x.current\"]",
            "the drive `x` is in two loops",
            "is the name of two things",
        ),
        (
            "outputs = [\"y.current\"]",
            "outputs = [\"x.current\"]",
            "the drive `x` is in two loops",
            "no loop leads the drive",
        ),
        (
            "outputs = [\"y.current\"]",
            "outputs = []",
            "`loop.y.outputs` has 0 entries",
            "which no drive measures",
        ),
        (
            "outputs = [\"y.current\"]",
            "outputs = []",
            "at least 1 is needed",
            "no loop leads the drive",
        ),
    ] {
        assert!(RIG.contains(right), "{right}");
        let error = load_text(SCENARIO, &RIG.replacen(right, wrong, 1)).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
        assert!(!error.contains(unsaid), "{wrong}: {error}");
    }
}

#[test]
fn both_places_are_underlined() {
    for (right, wrong, labels) in [
        ("node_id = 0x12", "node_id = 0x10", ["here", "and here"]),
        (
            "outputs = [\"y.current\"]",
            "outputs = [\"x.current\"]",
            ["here", "and here"],
        ),
        (
            "[node.x]",
            "[node.second]\nkind = \"controller\"\nnode_id = 2\n[node.x]",
            ["the first one", "a second one"],
        ),
        (
            "[plant.gantry_y.dc_motor]",
            "[plant.x.dc_motor]",
            ["a plant here", "a node here"],
        ),
    ] {
        let error = load_text(SCENARIO, &RIG.replacen(right, wrong, 1)).unwrap_err();
        for label in labels {
            assert!(error.contains(&format!("─ {label}")), "{wrong}: {error}");
        }
    }
}

#[test]
fn a_rig_file_is_no_scenario() {
    let error = load_text(RIG, RIG).unwrap_err();
    assert!(
        error.contains("this is a rig file, not a scenario"),
        "{error}"
    );
    assert!(Rig::is_meant(RIG) && !Rig::is_meant(SCENARIO));
    assert!(Scenario::may_be(SCENARIO) && Scenario::may_be("[controller"));
    for text in [RIG, "", "schema = 1\n"] {
        assert!(!Scenario::may_be(text), "{text}");
    }
}

#[test]
fn what_is_expected_of_the_bus_stands_beside_the_loops() {
    let whole = "[expect]\nbus_load_percent = { max = 60.0 }\n\
        [expect.timing]\nframes_delayed = { max = 0.0 }\n\
        [expect.requirements]\nbus_load_percent = [\"REQ-1\"]\n\
        [expect.all]\ntracking_error_millimetres_rms = { min = 0.1, max = 0.5 }\nsafe_state = true\n\
        [expect.all.requirements]\nsafe_state = [\"REQ-2\"]\n[expect.x]";
    let loops = load_text(&SCENARIO.replace("[expect.x]", whole), RIG).unwrap();
    let [x, y] = &loops.loops[..] else {
        panic!("{loops:?}")
    };
    let (x, y) = (&x.expect, &y.expect);
    let is_of_bus = |expect: &crate::expect::Expect| {
        let timing = expect.timing.rows().next();
        [expect.of("bus_load_percent").is_some(), timing.is_some()]
    };
    assert_eq!([x, y].map(is_of_bus), [[false; 2]; 2]);
    assert_eq!(is_of_bus(&loops.shared.run.expect), [true; 2]);
    let rms = |expect: &crate::expect::Expect| {
        let limit = expect.limit("tracking_error_{unit}_rms").unwrap();
        (limit.min, limit.max)
    };
    // A limit of the loop itself replaces the whole limit.
    assert_eq!(
        (rms(x), rms(y)),
        ((None, Some(0.2)), (Some(0.1), Some(0.5)))
    );
    let yes = Some(Limit {
        min: Some(1.0),
        max: Some(1.0),
    });
    assert_eq!([x, y].map(|expect| expect.limit("safe_state")), [yes, yes]);
    let required = |place: usize| {
        let mut rows = loops.loops[place].expected_rows();
        rows.retain(|row| !row.requirements.is_empty());
        Vec::from_iter(rows.into_iter().map(|row| row.name))
    };
    assert_eq!(required(0), ["bus_load_percent", "safe_state"]);
    assert_eq!(required(1), ["bus_load_percent", "safe_state"]);
}

#[test]
fn what_is_expected_in_the_wrong_place_is_shown_the_right_one() {
    for (wrong, said) in [
        (
            "[expect.x]\nbus_load_percent = { max = 6.0 }",
            "`bus_load_percent` is of the whole bus",
        ),
        (
            "[expect.y.timing]\nframes_delayed = { max = 0.0 }\n[expect.x]",
            "move it to [expect]",
        ),
        (
            "[expect]\nsafe_state = true\n[expect.x]",
            "write [expect.x], or [expect.all]",
        ),
        (
            "[expect]\ntracking_error_millimetres_rms = { max = 1.0 }\n[expect.x]",
            "`tracking_error_millimetres_rms` of which loop?",
        ),
        (
            "[expect.requirements]\nsafe_state = [\"R\"]\n[expect.x]",
            "`safe_state` of which loop?",
        ),
        (
            "[expect.requirements]\ntracking_error_millimetres_rms = [\"R\"]\n[expect.x]",
            "`tracking_error_millimetres_rms` of which loop?",
        ),
        (
            "[expect.requirements]\nbus_load_percent = [\"R\"]\n[expect.x]",
            "`bus_load_percent` tests no requirement",
        ),
        (
            "[expect.x.requirements]\nbus_load_percent = [\"R\"]\n[expect]\nbus_load_percent = { max = 1.0 }\n[expect.x]",
            "move it to [expect.requirements]",
        ),
        ("[controller.pid]\n[expect.x]", "`pid` of which loop?"),
    ] {
        let error = load_text(&SCENARIO.replace("[expect.x]", wrong), RIG).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
        assert_eq!(error.matches(said).count(), 1, "{wrong}: {error}");
    }
    let law = SCENARIO.replace("[controller.all.pid]", "[controller.pid]");
    let error = load_files(&law, RIG).unwrap_err();
    let said = error.problems().iter().map(ToString::to_string);
    assert!(said.eq(["`pid` of which loop?"]), "{error:?}");
}

const SWEEP: &str = "[sweep]\ndraws = 2\n\
    [[sweep.list]]\nkey = \"reference.hold[1].position_millimetres\"\nvalues = [5, 15]\n\
    [[sweep.uniform]]\nkey = \"plant.gantry_y.load_kilograms\"\nfrom = 0.3\nto = 0.5\n\
    [[sweep.uniform]]\nkey = \"expect.x.tracking_error_millimetres_rms.max\"\nfrom = 0.3\nto = 0.5\n\
    [[sweep.uniform]]\nkey = \"controller.all.pid.proportional_amperes_per_metre\"\nfrom = 0.3\nto = 0.5\n\
    [expect.x]";

#[test]
fn a_sweep_varies_what_has_the_names_of_the_rig() {
    let scenario = SCENARIO.replace("[expect.x]", SWEEP);
    let loops = load_text(&scenario, RIG).unwrap();
    let sweep = loops.shared.sweep.as_ref().unwrap();
    assert_eq!(sweep.runs(), 4);
    for (right, wrong, said) in [
        (
            "gantry_y.load",
            "gantry_z.load",
            "did you mean `plant.gantry_y.load_kilograms`?",
        ),
        (
            "controller.all.pid.p",
            "controller.x.pid.p",
            "no number of this scenario",
        ),
        ("hold[1]", "hold[2]", "no number of this scenario"),
        (
            "reference.hold[1].position_millimetres",
            "expect.judged_until_seconds",
            "did you mean `expect.x.judged_until_seconds`?",
        ),
        ("draws", "drawn", "did you mean `draws`?"),
        (
            "values = [5",
            "values = [95",
            "`reference.hold[1].position_millimetres` = 95 is out of range",
        ),
    ] {
        let error = load_text(&scenario.replacen(right, wrong, 1), RIG).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
    }
}

/// The smallest scenario on the shipped rig.
const ON_SHIPPED: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"step\"\nduration_seconds = 3.0\n[controller.pid]\n\
    [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
    [[fault.node.hang]]\nnode = \"drive\"\nfrom_seconds = 1.0\nuntil_seconds = 2.0\n\
    [expect]\nsafe_state = true\n";

fn load_shipped(text: &str) -> Result<Scenario, ScenarioError> {
    let mut none = |_: &str| Err(std::io::ErrorKind::NotFound.into());
    let beside = Beside::new(std::path::Path::new("step.toml"));
    Scenario::parse(&beside, text.to_owned(), &mut none, &Asked::default())
}

#[test]
fn a_rig_that_ships_is_a_rig_file_whose_text_is_kept() {
    let loops = load_shipped(ON_SHIPPED).unwrap();
    let [one] = &loops.loops[..] else {
        panic!("{loops:?}")
    };
    assert_eq!(one.wiring.plausible.max, Some(59.5));
    let rig = crate::rig::shipped::text("sma_actuator").unwrap();
    assert_eq!(loops.shared.tables["rig/sma_actuator.toml"], rig);
    assert_eq!(loops.shared.tables.len(), 1);
    for (flat, by_loop) in [
        ("[controller.pid]", "[controller.position.pid]"),
        ("[controller.pid]", "[controller.all.pid]"),
        ("[expect]", "[expect.position]"),
    ] {
        let named = load_shipped(&ON_SHIPPED.replace(flat, by_loop)).unwrap();
        assert_eq!(named.loops.first().unwrap(), one, "{by_loop}");
    }
}

#[test]
fn every_rig_that_ships_is_valid() {
    for name in crate::rig::shipped::names() {
        let text = crate::rig::shipped::text(name).unwrap();
        Rig::parse(text, name).unwrap();
    }
}

#[test]
fn a_rig_that_is_not_there_is_one_error() {
    for (rig, said) in [
        ("", "the scenario names no rig"),
        ("", "`rig` is missing"),
        ("", "help: rig = \"sma_actuator\" is the actuator"),
        ("rig = 3\n", "`rig` must be a string"),
        ("rig = \"sma_actuatr\"\n", "did you mean `sma_actuator`?"),
        ("rig = \"bench\"\n", "no rig that ships is called `bench`"),
        (
            "rig = \"bench\"\n",
            "known are: dc_motor, four_drives, press, sma_actuator",
        ),
        (
            "rig = \"bench\"\n",
            "is named with its ending: rig = \"FILE.toml\"",
        ),
        ("rig = \"x.toml\"\n", "the rig file x.toml does not exist"),
        (
            "rig = \"rigs/press.toml\"\n",
            "the one that ships is named rig = \"press\"",
        ),
        ("rig = \"../x.toml\"\n", "must lie in the scenario's folder"),
    ] {
        let text = ON_SHIPPED.replace("rig = \"sma_actuator\"\n", rig);
        let error = load_shipped(&text).unwrap_err();
        assert_eq!(error.problems().len(), 1, "{rig}");
        let error = crate::without_colours(&error);
        assert!(error.contains(said), "{rig}: {error}");
    }
}

#[test]
fn a_scenario_gives_other_values_to_its_rig() {
    let more = "[bus]\nsync_period_milliseconds = 2.0\n[plant.wire.heat]\nambient_celsius = 30.0\n\
        [node.drive.sensor]\nnoise_rms = 0.1\nmax = 50.0\n[node.drive.amplifier]\nmax = 0.5\n";
    let loops = load_shipped(&format!("{ON_SHIPPED}{more}")).unwrap();
    let scenario = loops.loops.first().unwrap();
    assert_eq!(scenario.run.bus.sync_period_milliseconds, 2.0);
    assert_eq!(loops.shared.rig.bus.sync_period_milliseconds, 2.0);
    assert_eq!(
        scenario.plant().sma.as_ref().unwrap().heat.ambient_celsius,
        30.0
    );
    let (sensor, amplifier) = (&scenario.sensor, &scenario.amplifier);
    let below = Sensor {
        min: Some(-10.0),
        ..Sensor::default()
    };
    assert_eq!((below.range(), below.span()), ([-10.0, 60.0], 70.0));
    assert_eq!(sensor.noise_rms(), 0.1);
    assert_eq!((sensor.resolution_bits(), sensor.span()), (10, 50.0));
    assert_eq!(amplifier.range().max, 0.5);
    assert_eq!(scenario.wiring.sensor.range(), [0.0, 50.0]);
}

/// Each of these entries is wrong by itself, and none is checked before their number is refused. `tests/allocation.rs` counts how
/// the work until then grows with the number.
#[test]
fn a_rig_with_a_hundred_thousand_nodes_is_refused_by_their_number() {
    for (table, max) in [("node", 127), ("plant", 127), ("loop", 8)] {
        let names = (0..100_000)
            .map(|number| format!("n{number}={{}}\n"))
            .collect::<String>();
        let rig = format!("schema=1\nname=\"r\"\n[{table}]\n{names}");
        let error = load_files(SCENARIO, &rig).unwrap_err();
        let [problem] = error.problems() else {
            panic!("{error}")
        };
        let text = format!("{problem:?}");
        assert!(
            text.contains(&format!("100000 entries in [{table}]")),
            "{text}"
        );
        assert!(text.contains(&format!("at most {max}")), "{text}");
    }
    let long = format!("{RIG}#{}", "x".repeat(1 << 20));
    let error = load_text(SCENARIO, &long).unwrap_err();
    assert!(error.contains("longer than"), "{error}");
}

#[test]
fn a_contour_needs_two_loops_each_once() {
    let limited = |loops: &str| {
        let limit = "contour_error_millimetres_max = { max = 0.3 }";
        format!("{SCENARIO}[[expect.contour]]\nloops = {loops}\n{limit}\n")
    };
    assert_eq!(
        load_text(&limited("[\"x\", \"y\"]"), RIG)
            .unwrap()
            .shared
            .contours
            .len(),
        1
    );
    for (loops, said) in [
        ("[\"x\"]", "at least 2 are needed"),
        (
            "[\"x\", \"x\"]",
            "the loop `x` is an axis of this contour twice",
        ),
        ("[\"x\", \"z\"]", "the rig has no loop `z`"),
    ] {
        let error = load_text(&limited(loops), RIG).unwrap_err();
        assert!(error.contains(said), "{said}: {error}");
    }
    let millimetres = "contour_error_millimetres_max";
    for (key, said) in [
        (
            "contour_error_degrees_max",
            "write `contour_error_millimetres_max`",
        ),
        (
            "\"contour_error_{unit}_max\"",
            "unknown key `contour_error_{unit}_max`",
        ),
    ] {
        let text = limited("[\"x\", \"y\"]").replace(millimetres, key);
        let error = load_text(&text, RIG).unwrap_err();
        assert!(error.contains(said), "{said}: {error}");
    }
}

const JOINT_RIG: &str = r#"
schema = 1
name = "joint"
[bus]
sync_period_milliseconds = 2.0
[defaults.drive]
sensor = { port = "joint.angle_degrees", unit = "degrees", min = -60.0, max = 60.0 }
[plant.joint.sma_pair]
[node.hand]
kind = "controller"
node_id = 1
[node.flexor]
kind = "drive"
node_id = 0x10
amplifier.port = "joint.flexor_current_amperes"
[node.extensor]
kind = "drive"
node_id = 0x12
amplifier.port = "joint.extensor_current_amperes"
[loop.angle]
feedback = "flexor.position"
outputs = ["flexor.current", "extensor.current"]
"#;

const JOINT: &str = r#"
schema = 1
name = "a step"
rig = "rig.toml"
duration_seconds = 3.0
[controller.pid_pair]
proportional_amperes_per_degree = 0.03
[[reference.step]]
at_seconds = 1.0
position_degrees = -20.0
[[fault.sensor.offset]]
node = "extensor"
from_seconds = 2.0
offset_degrees = 5.0
[expect.angle]
steady_state_error_degrees = { max = 1.0 }
"#;

#[test]
fn a_loop_of_two_drives_is_one_with_a_law_and_one_that_it_leads() {
    let loops = load_text(JOINT, JOINT_RIG).unwrap();
    let [angle, extensor] = &loops.loops[..] else {
        panic!("{loops:?}")
    };
    assert_eq!(
        [&*angle.wiring.loop_name, &*extensor.wiring.loop_name],
        ["angle", "extensor"],
        "the second drive is played under its own name"
    );
    let (leader, led) = (&angle.wiring, &extensor.wiring);
    assert_eq!((leader.drives_commanded(), &leader.led_by), (2, &None));
    let by = crate::wiring::LedBy {
        loop_name: "angle".to_owned(),
        place: 1,
    };
    assert_eq!((led.drives_commanded(), &led.led_by), (1, &Some(by)));
    assert!(led.is_second && !leader.is_second);
    assert!(angle.controller.pid_pair.is_some());
    assert!(extensor.controller.open_loop.is_some());
    assert!(extensor.reference.is_empty());
    assert_eq!(faults(angle, "offset"), 0);
    assert_eq!(faults(extensor, "offset"), 1);
}

#[test]
fn a_drive_that_another_law_leads_has_no_law_and_no_set_point() {
    for (more, said) in [
        (
            "[[reference.step]]\nloop = \"extensor\"\nat_seconds = 2.0\nposition_degrees = 1.0\n",
            "the rig has no loop `extensor`",
        ),
        (
            "[controller.extensor.pid]\n",
            "the rig has no loop `extensor`",
        ),
    ] {
        let text = JOINT.replace("[controller.pid_pair]", "[controller.angle.pid_pair]");
        let error = load_text(&format!("{text}{more}"), JOINT_RIG).unwrap_err();
        assert!(error.contains(said), "{more}: {error}");
    }
}

#[test]
fn a_disturbance_is_one_of_each_drive_at_its_plant() {
    let module = "[node.module]\nkind = \"io\"\nnode_id = 0x18\noutputs = { added_load_grams = \"joint.added_load_kilograms\" }\n";
    let disturbance = "[[disturbance.load]]\nat_seconds = 2.0\nadded_grams = 20.0\n";
    for flexor in ["node_id = 0x10", "node_id = 0x13"] {
        let rig = JOINT_RIG.replace("node_id = 0x10", flexor);
        let loops = load_text(&format!("{JOINT}{disturbance}"), &format!("{rig}{module}")).unwrap();
        let counts = loops
            .loops
            .iter()
            .map(|one| one.judged_disturbances().len());
        assert_eq!(Vec::from_iter(counts), [1, 1], "{flexor}");
    }
}

/// A plant that no loop moves or measures disturbs none; its output is commanded all the same.
#[test]
fn a_disturbance_of_a_plant_without_a_loop_is_not_judged() {
    let disturbance =
        "[[disturbance.output]]\nname = \"weight_kilograms\"\nat_seconds = 2.0\nvalue = 0.1\n";
    for (plant, other, judged) in [("spare", "joint", 0), ("joint", "spare", 1)] {
        let module = format!(
            "[plant.spare.dc_motor]\n[node.module]\nkind = \"io\"\nnode_id = 0x18\n\
             outputs = {{ weight_kilograms = \"{plant}.added_load_kilograms\", other_kilograms = \"{other}.added_load_kilograms\" }}\n"
        );
        let rig = format!("{JOINT_RIG}{module}");
        let loops = load_text(&format!("{JOINT}{disturbance}"), &rig)
            .unwrap()
            .loops;
        assert_eq!(loops.first().unwrap().disturbances().len(), 1);
        assert_eq!(
            loops.first().unwrap().judged_disturbances().len(),
            judged,
            "{plant}"
        );
    }
}

/// Returns what is said of these disturbances, beside a fault after the end of the run.
fn said_of(disturbances: &str) -> String {
    let io = |name: &str, id: u8, plant: &str| {
        format!(
            "[node.{name}]\nkind = \"io\"\nnode_id = {id}\noutputs = {{ convection_factor = \"{plant}.convection_factor\" }}\n"
        )
    };
    let [east, west] = [io("east", 0x18, "spare"), io("west", 0x19, "joint")];
    let rig = format!("{JOINT_RIG}[plant.spare.dc_motor]\n{east}{west}");
    let fault = "[[fault.sensor.stuck]]\nnode = \"flexor\"\nfrom_seconds = 999.0\n";
    load_text(&format!("{JOINT}{disturbances}{fault}"), &rig).unwrap_err()
}

#[test]
fn disturbances_of_one_node_are_checked_whatever_comes_between_them() {
    let fan = |node: &str, from: f64| {
        format!(
            "[[disturbance.fan]]\nnode = \"{node}\"\nfrom_seconds = {from:?}\nuntil_seconds = {:?}\nconvection_factor = 3.0\n",
            from + 1.0
        )
    };
    let all = [fan("west", 1.0), fan("east", 1.2), fan("west", 1.5)].concat();
    let said = said_of(&all);
    assert!(said.contains("two fans blow at a time"), "{said}");
    assert!(said.contains("starts after the end of the run"), "{said}");
    let all = [fan("west", 1.0), fan("east", 1.2), fan("west", 2.0)].concat();
    assert!(!said_of(&all).contains("two fans"));
    // An unknown node is one problem.
    let said = said_of(&fan("north", 1.0));
    assert!(
        said.contains("no node `north`") && !said.contains("no io node"),
        "{said}"
    );
    let said = said_of(&[fan("north", 1.0), fan("north", 1.2)].concat());
    assert!(!said.contains("two fans"), "{said}");
    // A wrong entry hides no other problem, and causes none.
    let wrong = fan("west", 3.0).replace("convection_factor", "convection");
    let said = said_of(&[fan("west", 1.0), fan("east", 0.5), wrong].concat());
    assert!(!said.contains("out of order"), "{said}");
    let wrong = fan("west", 1.0).replace("convection_factor", "convection");
    let limits =
        "recovery_time_seconds = { max = 1.0 }\novershoot_percent = { min = 2.0, max = 1.0 }\n";
    let said = said_of(&format!("{limits}{wrong}"));
    assert!(said.contains("no value meets the limit"), "{said}");
    assert!(said.contains("starts after the end of the run"), "{said}");
    assert!(
        said.contains("`convection`") && !said.contains("needs a [[disturbance"),
        "{said}"
    );
}

#[test]
fn a_disturbance_of_a_node_without_outputs_is_refused_in_a_rig_of_several_loops() {
    let disturbance = "[[disturbance.load]]\nnode = \"x\"\nat_seconds = 1.0\nadded_grams = 2.0\n";
    let error = load_text(&format!("{SCENARIO}{disturbance}"), RIG).unwrap_err();
    assert!(
        error.contains("no io node has a load at this plant"),
        "{error}"
    );
}

#[test]
fn a_law_is_refused_in_a_loop_that_it_cannot_lead() {
    let error = |scenario: &str, rig: &str| load_text(scenario, rig).unwrap_err();
    let gain = "[controller.pid_pair]\nproportional_amperes_per_degree = 0.03";
    let sliding_mode = JOINT.replace(gain, "[controller.sliding_mode]");
    let found = error(&sliding_mode, JOINT_RIG);
    assert!(found.contains("`sliding_mode` leads a length"), "{found}");
    let rig = JOINT_RIG.replace("extensor_current_amperes", "extensor_volts");
    let found = error(JOINT, &rig.replace("extensor.current", "extensor.voltage"));
    assert!(
        found.contains("the drives' commands are in amperes and in volts"),
        "{found}"
    );
    let named = |text: &str| text.replace("extensor", "timing");
    let found = error(&named(JOINT), &named(JOINT_RIG));
    assert!(
        found.contains("a node cannot be called `timing`"),
        "{found}"
    );
    let lost = "[[fault.sensor.lost_bits]]\nnode = \"flexor\"\nfrom_seconds = 1.0\nmask = 0x800\n";
    let rig = JOINT_RIG.replace("max = 60.0 }", "max = 60.0, resolution_bits = 11 }");
    let found = error(&format!("{JOINT}{lost}"), &rig);
    assert!(found.contains("the converter has 11 bits"), "{found}");
}

#[test]
fn gains_and_names_are_those_of_the_loop() {
    let spindle = JOINT_RIG
        .replacen("sensor = {", "sensor = { signal = \"tilt\",", 1)
        .replace("flexor.position", "flexor.tilt");
    let tilted = JOINT.replacen("position_degrees", "tilt_degrees", 1);
    load_text(&tilted, &spindle).unwrap();
    for (scenario, rig, right, wrong, said) in [
        (
            JOINT,
            JOINT_RIG,
            "amperes_per_degree = 0.03",
            "amperes_per_degree = 0.03\nproportional_amperes_per_revolution = 10.8",
            "one gain by two units",
        ),
        (
            JOINT,
            JOINT_RIG,
            "amperes_per_degree = 0.03",
            "amperes_per_metre = 36.0",
            "write `proportional_amperes_per_degree`",
        ),
        (
            JOINT,
            JOINT_RIG,
            "amperes_per_degree = 0.03",
            "amperes_per_revolution = 200_000.0",
            "`controller.pid_pair.proportional_amperes_per_revolution` = 200000 is out of range",
        ),
        (
            &tilted,
            &spindle,
            "tilt_degrees",
            "position_degrees",
            "write `tilt_degrees`",
        ),
        (
            &tilted,
            &spindle,
            "tilt_degrees",
            "tilt_millimetres",
            "write `tilt_degrees`",
        ),
        (
            &tilted,
            &spindle,
            "tilt_degrees",
            "\"{signal}_{unit}\"",
            "unknown key `{signal}_{unit}`",
        ),
    ] {
        let error = load_text(&scenario.replacen(right, wrong, 1), rig).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
    }
    let by_revolution = JOINT.replacen(
        "amperes_per_degree = 0.03",
        "amperes_per_revolution = 10.8",
        1,
    );
    let converted = load_text(&by_revolution, JOINT_RIG).unwrap();
    let gains = converted
        .loops
        .first()
        .unwrap()
        .controller
        .pid_pair
        .as_ref()
        .unwrap();
    assert!((gains.proportional - 0.03).abs() < 1e-12);
    let said = |from: &str, to: &str| load_text(&tilted, &spindle.replace(from, to)).unwrap_err();
    let error = said("flexor.tilt", "flexor.position");
    assert!(error.contains("write \"flexor.tilt\""), "{error}");
    for ambiguous in ["set_point", "error"] {
        let error = said("\"tilt\"", &format!("\"{ambiguous}\""));
        assert!(error.contains("the name of something else"), "{error}");
    }
}

#[test]
fn a_loop_in_degrees_is_as_one_in_millimetres_under_its_own_names() {
    let loops = load_text(JOINT, JOINT_RIG).unwrap();
    let angle = loops.loops.first().unwrap();
    assert_eq!(angle.wiring.feedback.quantity.unit.word(), "degrees");
    assert_eq!(angle.wiring.feedback.range(), [-60.0, 60.0]);
    let law = angle.controller.pid_pair.as_ref().unwrap();
    assert!((law.proportional - 0.03).abs() < 1e-12);
    assert!((angle.reference.step[0].position + 20.0).abs() < 1e-12);
    assert!(angle.expect.of("steady_state_error_{unit}").is_some());
    assert!((angle.sensor.span() - 120.0).abs() < 1e-12);
    for (right, wrong, said) in [
        (
            "position_degrees",
            "position_millimetres",
            "write `position_degrees`",
        ),
        (
            "offset_degrees",
            "offset_revolutions",
            "write `offset_degrees`",
        ),
        (
            "error_degrees",
            "error_millimetres",
            "write `steady_state_error_degrees`",
        ),
        (
            "= -20.0",
            "= -70.0",
            "`reference.step.position_degrees` = -70 is out of range",
        ),
        (
            "proportional_amperes_per_degree",
            "proportinal_amperes_per_degree",
            "did you mean `proportional_amperes_per_degree`?",
        ),
        (
            "[controller.pid_pair]",
            "[controller.pid]",
            "the law `pid` leads one drive",
        ),
        ("node = \"extensor\"\n", "", "for which node?"),
    ] {
        let error = load_text(&JOINT.replacen(right, wrong, 1), JOINT_RIG).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
    }
    for (right, wrong, said) in [
        (
            ", min = -60.0, max = 60.0",
            "",
            "`min` and `max` are missing, in degrees",
        ),
        (
            "min = -60.0, max = 60.0",
            "min = 60.0, max = -60.0",
            "must be above 60, its lowest",
        ),
        ("unit = \"degrees\"", "unit = \"°\"", "`°` is no unit"),
        (
            "flexor.position",
            "extensors.position",
            "which no drive measures",
        ),
        (
            "joint.extensor_current",
            "joint.flexor_current",
            "two nodes drive the port",
        ),
        (
            "\"joint.extensor_current_amperes\"",
            "\"joint\"",
            "`joint` names no port",
        ),
    ] {
        let error = load_text(JOINT, &JOINT_RIG.replacen(right, wrong, 1)).unwrap_err();
        assert!(error.contains(said), "{wrong}: {error}");
    }
}

#[test]
fn a_default_co_contraction_is_within_the_range_of_the_amplifier() {
    let port = "amplifier.port = \"joint.flexor_current_amperes\"";
    let small = JOINT_RIG.replace(port, &format!("{port}\namplifier.max = 0.3"));
    let error = load_text(JOINT, &small).unwrap_err();
    let said = "`controller.pid_pair.co_contraction_amperes` = 0.5 is out of range";
    assert!(error.contains(said), "{error}");
}

/// A wire in addition to the motors of the two axes.
const MIXED: &str = "[plant.wire.sma]\n[node.w]\nkind = \"drive\"\nnode_id = 0x14\n\
    amplifier = { port = \"wire.current_amperes\", rated = 1.0, min = 0.0, max = 1.0 }\nsensor.port = \"wire.position_metres\"\n\
    [loop.w]\nfeedback = \"w.position\"\noutputs = [\"w.current\"]\n";
const HOLD: &str =
    "[[reference.hold]]\nloop = \"w\"\nat_seconds = 1.0\nposition_millimetres = 20.0\n";

#[test]
fn a_fault_of_a_plant_is_held_against_the_plant_of_its_drive() {
    let rig = format!("{RIG}{MIXED}");
    let ageing = |whose: &str| {
        let fault =
            format!("[[fault.plant.ageing]]\n{whose}\nfrom_seconds = 1.0\nuntil_seconds = 2.0\n");
        SCENARIO.replace(
            "[[fault.sensor.noise]]",
            &format!("{HOLD}{fault}[[fault.sensor.noise]]"),
        )
    };
    for whose in ["node = \"w\"", "plant = \"wire\""] {
        let loops = load_text(&ageing(whose), &rig).unwrap();
        let counts = loops.loops.iter().map(|one| faults(one, "ageing"));
        assert_eq!(Vec::from_iter(counts), [1, 0, 0], "{whose}");
    }
    for (whose, said) in [
        ("node = \"x\"", "cannot happen to the plant `dc_motor`"),
        (
            "plant = \"gantry_y\"",
            "cannot happen to the plant `dc_motor`",
        ),
        ("node = \"z\"", "the rig has no node `z`"),
        ("plant = \"gantry_z\"", "the rig has no plant `gantry_z`"),
        ("", "for which node?"),
    ] {
        let problems = load_text(&ageing(whose), &rig).unwrap_err();
        assert!(!problems.contains(" problems"), "{problems}");
        assert!(problems.contains(said), "{whose}: {problems}");
    }
}

#[test]
fn a_fault_happens_to_a_node_that_can_have_it() {
    for (fault, said) in [
        ("[[fault.sensor.stuck]]\nnode = \"controller\"", "no drive"),
        (
            "[[fault.bus.duplicate]]\nsender = \"module\"",
            "faults of the bus happen to drives",
        ),
        (
            "[[fault.node.hang]]\nnode = \"bench\"",
            "the rig has no node `bench`",
        ),
    ] {
        let fault = format!("{fault}\nfrom_seconds = 1.0\n[[fault.sensor.noise]]");
        let scenario = SCENARIO.replace("[[fault.sensor.noise]]", &fault);
        let module = "[node.module]\nkind = \"io\"\nnode_id = 0x11\noutputs = { load = \"gantry_x.added_load_kilograms\" }\n";
        let problems = load_text(&scenario, &format!("{RIG}{module}")).unwrap_err();
        assert!(problems.contains(said), "{problems}");
    }
}
