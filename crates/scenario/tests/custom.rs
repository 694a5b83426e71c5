//! Tests of tables of plants and laws from outside: they are read, refused, described and written as the shipped ones. They
//! have a separate binary, since tables are registered once.

use std::sync::Once;

use scenario::custom::{CustomTable, Section};
use scenario::registration::{InvalidRegistration, register};
use scenario::{Asked, Beside, Reading, Scenario, Trial};
use schemars::JsonSchema;
use serde::Deserialize;

/// A pendulum.
#[derive(Debug, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, default)]
struct Pendulum {
    /// Its length.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    length_metres: f64,
    /// Pivot on which it hangs.
    pivot: Pivot,
    /// A place.
    place: (f64, f64),
    /// How often.
    count: u8,
}

/// A type with the name of a shipped type and other fields.
#[derive(Debug, Default, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, default)]
struct Pivot {
    /// Is it dry?
    is_dry: bool,
}

impl Default for Pendulum {
    fn default() -> Self {
        Self {
            length_metres: 1.0,
            pivot: Pivot::default(),
            place: (0.0, 0.0),
            count: 1,
        }
    }
}

/// A law.
#[derive(Debug, Default, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
struct Relay {
    /// How much.
    #[serde(rename = "{command}_{command_unit}")]
    _command: f64,
}

fn register_once() {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        let pendulum = CustomTable::new::<Pendulum>("pendulum").with_faults(&["jammed_pulley"]);
        register(Section::Plant, vec![pendulum]).expect("a table of a plant");
        let relay = CustomTable::new::<Relay>("relay");
        register(Section::Controller, vec![relay]).expect("a table of a law");
    });
}

/// Returns a scenario with this law on a rig file.
fn text(controller: &str) -> String {
    format!(
        "schema = 1\nrig = \"rig.toml\"\nname = \"t\"\nduration_seconds = 9.0\n{controller}\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 1.0\n"
    )
}

/// Returns a rig file with a plant `p` of this model, in place of `[plant.sma]`.
fn rig(model: &str) -> String {
    let model = model.replace("[plant.", "[plant.p.");
    let model = if model.is_empty() {
        "[plant.p.sma]\n"
    } else {
        &model
    };
    format!(
        "schema = 1\nname = \"r\"\n{model}[node.controller]\nkind = \"controller\"\nnode_id = 1\n\
         [node.drive]\nkind = \"drive\"\nnode_id = 16\namplifier = {{ port = \"p.current_amperes\" }}\n\
         sensor = {{ port = \"p.position_metres\" }}\n\
         [loop.position]\nfeedback = \"drive.position\"\noutputs = [\"drive.current\"]\n"
    )
}

fn parsed(controller: &str, plant: &str) -> Result<Trial, String> {
    register_once();
    Trial::parse(&text(controller), "t.toml", |_| Ok(rig(plant)))
        .map_err(|error| format!("{:?}", miette::Report::new(error)))
}

const RELAY: &str = "[controller.relay]\ncurrent_amperes = 0.5\n";

#[track_caller]
fn refused(controller: &str, plant: &str, expected: &[&str]) {
    let error = parsed(controller, plant).expect_err("it is wrong");
    // However the lines were broken.
    let error = error.split_whitespace().collect::<Vec<_>>().join(" ");
    for expected in expected {
        assert!(error.contains(expected), "{expected} is not in {error}");
    }
}

#[test]
fn a_table_from_outside_is_read_with_its_defaults() {
    let plant =
        "[plant.pendulum]\nlength_metres = 2\npivot = { is_dry = true }\nplace = [1, 2.5]\n";
    let scenario = parsed(RELAY, plant).unwrap();
    assert_eq!(scenario.plant().name(), "pendulum");
    assert_eq!(scenario.controller.law_name(), "relay");
    let custom = scenario.plant().custom.as_ref().unwrap();
    let expected = Pendulum {
        length_metres: 2.0,
        pivot: Pivot { is_dry: true },
        place: (1.0, 2.5),
        count: 1,
    };
    assert_eq!(custom.parameters::<Pendulum>().unwrap(), expected);
    assert!(custom.parameters::<Relay>().is_err());
}

#[test]
fn wrong_parameters_are_shown_as_those_of_a_shipped_table() {
    refused(
        RELAY,
        "[plant.pendulum]\nlenght_metres = 1.0\n",
        &[
            "unknown key `lenght_metres` in [plant.p.pendulum]",
            "did you mean `length_metres`?",
        ],
    );
    refused(
        RELAY,
        "[plant.pendulum]\nlength_metres = \"long\"\n",
        &[
            "`plant.p.pendulum.length_metres` must be a number",
            "this is a string",
        ],
    );
    refused(
        RELAY,
        "[plant.pendulum]\nlength_metres = 0.0\n",
        &[
            "`plant.p.pendulum.length_metres` = 0 is out of range",
            "must be above 0, at most 10",
        ],
    );
    refused(
        RELAY,
        "[plant.pendulum]\npivot.is_wet = true\n",
        &["unknown key `is_wet` in [plant.p.pendulum.pivot]"],
    );
    refused(
        "[controller.relay]\n",
        "",
        &[
            "[controller.relay] lacks the key `current_amperes`",
            "How much.",
        ],
    );
    // The schema does not know the largest number of eight bits; the type does.
    refused(
        RELAY,
        "[plant.pendulum]\ncount = 300\n",
        &["300", "count = 300"],
    );
}

#[test]
fn what_the_bench_does_not_have_is_named() {
    refused(
        "[controller.fuzzy]\nrules = 3\n",
        "",
        &[
            "unknown control law `fuzzy`",
            "known here: fmu, library, open_loop, pid, pid_pair, program, relay, sliding_mode, sliding_mode_paper;",
        ],
    );
    refused(
        RELAY,
        "[plant.rocket]\nthrust_newtons = 3.0\n",
        &[
            "unknown plant model `rocket`",
            "known here: dc_motor, fmu, pendulum, sma, sma_pair; a plant model of your own",
        ],
    );
}

/// Reads a scenario from its folder, as that of a recording.
fn recorded(controller: &str, plant: &str) -> Result<Trial, String> {
    register_once();
    let folder = tempfile::tempdir().expect("a folder can be made");
    let path = folder.path().join("scenario.toml");
    std::fs::write(folder.path().join("rig.toml"), rig(plant)).expect("it can be written");
    let beside = Beside::new(&path);
    let asked = Asked {
        reading: Reading::Recorded,
        ..Asked::default()
    };
    let read = &mut |name: &str| beside.read_text(name);
    let loaded = Scenario::parse(&beside, text(controller), read, &asked);
    loaded
        .map(|scenario| scenario.loops.first().expect("it has a loop").clone())
        .map_err(|error| format!("{:?}", miette::Report::new(error)))
}

#[test]
fn a_recorded_scenario_keeps_what_the_bench_does_not_have() {
    let rocket = "[plant.rocket]\nthrust_newtons = 3.0\nstages = [{ name = \"a\" }]\n";
    let fuzzy = "[controller.fuzzy]\nrules = 3\n\
        [plant.p]\nthrust_newtons = 4.0\n\
        [[fault.plant.dropped_load]]\nfrom_seconds = 1.0\n\
        [sweep]\n[[sweep.list]]\nkey = \"plant.p.thrust_newtons\"\nvalues = [1.0, 2.0]\n";
    let scenario = recorded(fuzzy, rocket).unwrap();
    assert_eq!(scenario.plant().name(), "rocket");
    assert_eq!(scenario.controller.law_name(), "fuzzy");
    // A law that the bench has may have been another one when the scenario was played.
    let scenario = recorded(RELAY, "[plant.pendulum]\nmass_kilograms = 1.0\n").unwrap();
    assert_eq!(scenario.plant().name(), "pendulum");
    let scenario = recorded("[controller.pid]\n", "").unwrap();
    assert_eq!(scenario.plant().name(), scenario::plant::SMA_ACTUATOR);
}

#[test]
fn a_recorded_scenario_is_checked_in_all_else() {
    for (controller, plant, expected) in [
        (
            RELAY,
            "[plant.rocket]\n[plant.dc_motor]\n",
            "the plant `p` needs one model",
        ),
        (
            RELAY,
            "[plant.a]\n[plant.b]\n",
            "the plant `p` needs one model",
        ),
        (
            "[controller.a]\n[controller.b]\n",
            "",
            "more than one control law",
        ),
        ("[controller.pid]\nkp = 1.0\n", "", "unknown key `kp`"),
        (
            "[controller.pid]\n[node.drive.sensor]\nresolution_bits = 0\n",
            "",
            "out of range",
        ),
        (
            "[controller.pid]\n[rocket]\n",
            "",
            "unknown key `rocket` in the scenario",
        ),
    ] {
        let error = recorded(controller, plant).expect_err(expected);
        assert!(error.contains(expected), "{expected} is not in {error}");
    }
}

#[test]
fn two_plants_two_laws_and_a_strange_fault_are_refused() {
    let pendulum = "[plant.pendulum]\n";
    refused(
        RELAY,
        &format!("{pendulum}[plant.dc_motor]\n"),
        &["the plant `p` needs one model"],
    );
    refused(
        &format!("{RELAY}[controller.pid]\n"),
        pendulum,
        &["more than one control law"],
    );
    let fault = |kind| format!("{RELAY}[[fault.plant.{kind}]]\nfrom_seconds = 1.0\n");
    refused(
        &fault("dropped_load"),
        pendulum,
        &[
            "cannot happen to the plant `pendulum`",
            "what can: jammed_pulley",
        ],
    );
    assert!(parsed(&fault("jammed_pulley"), pendulum).is_ok());
}

#[test]
fn the_schema_describes_them() {
    register_once();
    let schema: serde_json::Value = serde_json::from_str(&scenario::schema::json_schema()).unwrap();
    let models = schema["properties"]["plant"]["additionalProperties"]["anyOf"].as_array();
    let pendulum = models
        .into_iter()
        .flatten()
        .find(|model| model["properties"].get("pivot").is_some())
        .unwrap();
    assert_eq!(pendulum["properties"]["length_metres"]["maximum"], 10.0);
    // A current, or what else the amplifier gives.
    let relay = &schema["definitions"]["Controller"]["properties"]["relay"];
    assert_eq!(relay["minProperties"], 1);
    assert!(relay["properties"]["current_amperes"].is_object());
}

#[test]
fn what_cannot_be_a_table_is_refused_when_it_is_registered() {
    let refused = |table| {
        let error = register(Section::Plant, vec![table]).unwrap_err();
        error.to_string()
    };
    for taken in ["heat", "sma", "sma_actuator"] {
        assert_eq!(
            refused(CustomTable::new::<Pendulum>(taken)),
            format!("[plant.{taken}] is a table already: choose another name")
        );
    }
    let nameless = refused(CustomTable::new::<Pendulum>("My Plant"));
    assert!(nameless.starts_with("`My Plant` cannot be the name of a table: "));
    assert_eq!(
        refused(CustomTable::new::<f64>("number")),
        "the parameters of `number` are no struct with named fields"
    );
    let fault = CustomTable::new::<Pendulum>("swing").with_faults(&["rain"]);
    assert_eq!(
        refused(fault),
        "`swing` names a fault `rain`, and there is no [[fault.plant.rain]]"
    );
    register_once();
    assert_eq!(
        register(Section::Plant, vec![CustomTable::new::<Pendulum>("swing")]),
        Err(InvalidRegistration::again())
    );
}
