use std::fs;

use can::CanFrame;

use super::*;
use crate::plan::message_of;

const SERVO: &str = include_str!("../../../../../tests/foreign/servo.eds");
const SCENARIO: &str = "schema = 1\nname = \"two servos\"\nrig = \"rigs/two.toml\"\nduration_seconds = 4.0\n\
    [controller.all.open_loop]\n";
const TWO_AXES: &str = include_str!("../../../../worlds/tests/data/two_axes_rig.toml");

fn servo(name: &str, node_id: u8) -> String {
    format!(
        "[node.{name}]\nkind = \"drive\"\nnode_id = {node_id}\neds = \"sheets/servo.eds\"\n\
         mode_of_operation = -1\ncommand = {{ object = \"0x2200\", units_per_ampere = 10000.0 }}\n\
         position = {{ object = \"0x2100:01\", increments_per_unit = -40.0, increments_at_zero = 5000.0 }}\n\
         current = {{ object = \"0x2201\" }}\n[node.{name}.limits]\ncurrent_amperes = 1.0\n\
         min = -1.0\nmax = 45.0\nrate_max = 600.0\n\
         [loop.{name}]\nfeedback = \"{name}.position\"\noutputs = [\"{name}.current\"]\n"
    )
}

fn two_servos(second: u8) -> String {
    let head = "schema = 1\nname = \"two servos\"\n[bus]\nsync_period_milliseconds = 5.0\n\
        [node.controller]\nkind = \"controller\"\nnode_id = 1\n";
    head.to_owned() + &servo("x", 0x20) + &servo("y", second)
}

/// Returns the plan of a scenario on this rig, in a separate folder.
fn loaded(rig: &str) -> Result<Plan, String> {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    fs::create_dir_all(place("rigs/sheets")).unwrap();
    fs::write(place("rigs/two.toml"), rig).unwrap();
    fs::write(place("rigs/sheets/servo.eds"), SERVO).unwrap();
    fs::write(place("two.toml"), SCENARIO).unwrap();
    let loaded = Plan::load(&place("two.toml"), &Catalogue::shipped());
    loaded.map_err(|error| format!("{:?}", miette::Report::new(error)))
}

#[test]
fn each_external_drive_is_led_by_its_own_eds_limits_and_scaling() {
    let plan = loaded(&two_servos(0x22)).unwrap();
    let [x, y] = &plan.loops[..] else {
        panic!("two loops")
    };
    assert_eq!(plan.shared.tables["rigs/sheets/servo.eds"], SERVO);
    assert_eq!(plan.external_names(), ["x", "y"]);
    for (one, name, node_id) in [(x, "x", 0x20), (y, "y", 0x22)] {
        assert_eq!(
            (one.drive().name.as_str(), one.drive().id()),
            (name, node_id)
        );
        assert!(one.drive().is_external() && one.controller().is_ours());
        let drive = one.real_drive.as_ref().unwrap();
        assert_eq!(drive.layout.node_id.get(), node_id);
        assert_eq!(drive.layout.mode_of_operation, -1);
        assert!((drive.real.limits.current_amperes - 1.0).abs() < 1e-12);
        let feedback = drive.layout.feedback.id();
        assert_eq!(
            one.position(plan.database()).unwrap().raw_id(),
            u32::from(feedback)
        );
        assert!(message_of(plan.database(), one.drive(), "truth").is_err());
    }
    let id = |name: &str| plan.database().message(name).unwrap().raw_id;
    assert_eq!(id("y_heartbeat"), 0x722);
    assert_eq!(id("controller_y_tpdo1"), 0x1A1);
    let frame = CanFrame::new(0x722, &[5]);
    assert!(plan.database().message_of(&frame).unwrap().name == "y_heartbeat");
}

#[test]
fn terms_that_another_node_s_identifier_keeps_from_their_place_have_another_one() {
    // TPDO1 of node 0x21 has the identifier of the second loop's terms.
    let plan = loaded(&two_servos(0x21)).unwrap();
    let id = |name: &str| plan.database().message(name).unwrap().raw_id;
    assert_eq!((id("y_tpdo1"), id("controller_y_tpdo1")), (0x1A1, 0x6DD));
}

#[test]
fn what_an_external_drive_cannot_be_is_refused() {
    let strange = two_servos(0x22).replacen("0x2100:01", "0x2345:01", 1);
    let refused = loaded(&strange).unwrap_err();
    assert!(refused.contains("the drive `x` cannot be led"), "{refused}");
    assert!(refused.contains("no object 0x2345:01"), "{refused}");
    let elsewhere = two_servos(0x22).replacen("sheets/servo.eds", "sheets/none.eds", 1);
    let refused = loaded(&elsewhere).unwrap_err();
    assert!(
        refused.contains("the EDS of `x` cannot be read"),
        "{refused}"
    );
}

#[test]
fn a_program_of_a_rig_that_is_read_alone_is_wrong_at_its_place_in_the_rig_file() {
    let program = "node_id = 1\nprogram = [\"./nope.py\"]\n";
    let rig = two_servos(0x22)
        .replacen("node_id = 1\n", program, 1)
        .replace("eds = \"sheets/servo.eds\"", "external = true");
    let error = Plan::from_rig(Path::new("rig.toml"), &rig, &Catalogue::shipped()).unwrap_err();
    let shown = format!("{:?}", miette::Report::new(error));
    assert!(shown.contains("[rig.toml:8:12]"), "{shown}");
    assert!(
        shown.contains("no such file beside the rig file"),
        "{shown}"
    );
}

#[test]
fn an_emulated_drive_may_be_somebody_else_s() {
    let catalogue = Catalogue {
        find_ports: Some(|_| None),
        ..Catalogue::shipped()
    };
    let plan = Plan::from_rig(Path::new("two_axes_rig.toml"), TWO_AXES, &catalogue).unwrap();
    let truth = |plan: &Plan| {
        let names = ["x_truth", "y_truth"];
        names.map(|name| plan.database().message(name).is_none())
    };
    assert_eq!(truth(&plan), [false, false]);
    let external = |names: &[&str]| {
        let owned = names.iter().map(ToString::to_string);
        plan.clone().with_external(&Vec::from_iter(owned))
    };
    let y = external(&["y"]).unwrap();
    assert_eq!(truth(&y), [false, true]);
    let are_external = y.loops.iter().map(|one| one.drive().is_external());
    assert_eq!(Vec::from_iter(are_external), [false, true]);
    assert_eq!(y.external_names(), ["y"]);
    let controller = external(&["controller"]).unwrap();
    assert!(
        controller
            .loops
            .iter()
            .all(|one| one.controller().is_external())
    );
    let unknown = external(&["controler"]).unwrap_err();
    assert!(unknown.contains("did you mean `controller`?"), "{unknown}");
}

/// Returns the plan of a scenario on the shipped rig, with these nodes external.
fn with_external(names: &[&str], fault: &str) -> Result<Plan, String> {
    let head = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n";
    let beside = Beside::new(Path::new("t.toml"));
    let plan = Plan::parse_beside(&beside, format!("{head}{fault}"), &Catalogue::shipped());
    plan.unwrap()
        .with_external(&Vec::from_iter(names.iter().map(ToString::to_string)))
}

#[test]
fn a_fan_is_external_only_beside_an_external_drive() {
    let refused = with_external(&["disturbance"], "").unwrap_err();
    assert_eq!(
        refused,
        "--external disturbance needs --external drive: a real node cannot act on an emulated plant"
    );
    let plan = with_external(&["disturbance", "drive", "disturbance"], "").unwrap();
    assert_eq!(plan.external_names(), ["drive", "disturbance"]);
}

/// An io node between a real and an emulated plant would be played by nobody as the scenario means it.
#[test]
fn drives_that_one_io_node_acts_on_are_external_together() {
    let drive = |name: &str, node_id: u8| {
        format!(
            "[plant.{name}_motor.dc_motor]\n[node.{name}]\nkind = \"drive\"\nnode_id = {node_id}\n\
             amplifier.port = \"{name}_motor.current_amperes\"\nsensor = {{ port = \"{name}_motor.position_metres\", unit = \"millimetres\", max = 60.0 }}\n\
             [loop.{name}]\nfeedback = \"{name}.position\"\noutputs = [\"{name}.current\"]\n"
        )
    };
    let head = "schema = 1\nname = \"two motors\"\n[node.controller]\nkind = \"controller\"\nnode_id = 1\n\
        [bus]\nsync_period_milliseconds = 2.0\n\
        [node.weight]\nkind = \"io\"\nnode_id = 20\noutputs = { added_load_grams = \"a_motor.added_load_kilograms\", \
        more_grams = \"b_motor.added_load_kilograms\" }\n";
    let plan = loaded(&[head, &drive("a", 16), &drive("b", 17)].concat()).unwrap();
    let refused = |names: &[&str]| {
        let owned = names.iter().map(ToString::to_string);
        let refused = plan.clone().with_external(&Vec::from_iter(owned)).err();
        refused.map(|refused| refused.split(':').next().unwrap_or_default().to_owned())
    };
    let needs =
        |real: &str, other: &str| Some(format!("--external {real} needs --external {other}"));
    assert_eq!(refused(&["a"]), needs("a", "b"));
    assert_eq!(refused(&["a", "weight"]), needs("weight", "b"));
    assert_eq!(refused(&["a", "b"]), None);
    assert_eq!(refused(&["a", "b", "weight"]), None);
}

#[test]
fn no_fault_happens_to_a_node_that_is_external() {
    let admits = |name: &str, fault: &str| {
        let plan = with_external(&[name], fault).unwrap();
        plan.admits_faults()
    };
    let stuck = "[[fault.sensor.stuck]]\nfrom_seconds = 1.0\n";
    let crash = |node| format!("[[fault.node.crash]]\nfrom_seconds = 1.0\nnode = \"{node}\"\n");
    let stop = "[[fault.node.nmt_stop]]\nat_seconds = 1.0\nnode = \"drive\"\n";
    let refused = admits("drive", stuck).unwrap_err();
    assert!(refused.starts_with("[[fault.sensor.stuck]] cannot be played: the drive"));
    assert!(admits("drive", &crash("drive")).is_err());
    assert!(admits("controller", &crash("controller")).is_err());
    assert!(admits("controller", &crash("drive")).is_ok());
    assert!(admits("drive", &crash("controller")).is_ok());
    assert!(admits("drive", stop).is_ok());
    assert!(admits("controller", stuck).is_ok());
}
