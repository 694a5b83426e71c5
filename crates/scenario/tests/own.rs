//! Tables of plants and laws from outside: read, refused, described and written as the shipped ones. A program of its own,
//! since they are registered once.

use std::sync::Once;

use scenario::own::{OwnTable, Section};
use scenario::registration::{InvalidOwn, register};
use scenario::{ControllerView, Scenario};
use schemars::JsonSchema;
use serde::Deserialize;

/// A pendulum.
#[derive(Debug, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, default)]
struct Pendulum {
    /// Its length.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    length_metres: f64,
    /// What it hangs on.
    pivot: Pivot,
    /// A place.
    place: (f64, f64),
    /// How often.
    count: u8,
}

/// Called like a type of ours, and another one.
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
    current_amperes: f64,
}

fn register_once() {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        let pendulum = OwnTable::new::<Pendulum>("pendulum").with_faults(&["jammed_pulley"]);
        register(Section::Plant, vec![pendulum]).expect("a table of a plant");
        let relay = OwnTable::new::<Relay>("relay");
        register(Section::Controller, vec![relay]).expect("a table of a law");
    });
}

fn text(controller: &str, plant: &str) -> String {
    format!(
        "schema = 1\nname = \"t\"\nduration_seconds = 9.0\n{controller}\n{plant}\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 1.0\n"
    )
}

fn parsed(controller: &str, plant: &str) -> Result<Scenario, String> {
    register_once();
    let text = text(controller, plant);
    Scenario::parse(&text, "t.toml", |_| unreachable!("no table"))
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
    assert_eq!(scenario.plant.name(), "pendulum");
    assert_eq!(scenario.controller.law_name(), "relay");
    let own = scenario.plant.own.as_ref().unwrap();
    let expected = Pendulum {
        length_metres: 2.0,
        pivot: Pivot { is_dry: true },
        place: (1.0, 2.5),
        count: 1,
    };
    assert_eq!(own.parameters::<Pendulum>().unwrap(), expected);
    assert!(own.parameters::<Relay>().is_err());
}

#[test]
fn a_written_scenario_is_read_again() {
    let scenario = parsed(RELAY, "[plant.pendulum]\nlength_metres = 2.5\n").unwrap();
    let text = toml::to_string(&scenario).unwrap();
    let again = Scenario::parse(&text, "t.toml", |_| unreachable!("no table")).unwrap();
    assert_eq!(again, scenario, "{text}");
}

#[test]
fn the_controller_sees_its_law_and_no_plant() {
    register_once();
    let text = text(RELAY, "[plant.pendulum]\nlength_metres = -1.0\n");
    let view = ControllerView::parse(&text, "t.toml", |_| unreachable!("no table")).unwrap();
    assert_eq!(view.controller.law_name(), "relay");
}

#[test]
fn wrong_parameters_are_shown_as_those_of_a_shipped_table() {
    refused(
        RELAY,
        "[plant.pendulum]\nlenght_metres = 1.0\n",
        &[
            "unknown key `lenght_metres` in [plant.pendulum]",
            "did you mean `length_metres`?",
        ],
    );
    refused(
        RELAY,
        "[plant.pendulum]\nlength_metres = \"long\"\n",
        &[
            "`plant.pendulum.length_metres` must be a number",
            "this is a string",
        ],
    );
    refused(
        RELAY,
        "[plant.pendulum]\nlength_metres = 0.0\n",
        &[
            "`plant.pendulum.length_metres` = 0 is out of range",
            "must be above 0, at most 10",
        ],
    );
    refused(
        RELAY,
        "[plant.pendulum]\npivot.is_wet = true\n",
        &["unknown key `is_wet` in [plant.pendulum.pivot]"],
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
        "[plant.rocket]\nthrust_newtons = 3.0\n",
        &[
            "unknown control law `fuzzy`",
            "known here: open_loop, pid, pid_pair, relay, sliding_mode, sliding_mode_paper;",
            "unknown plant `rocket`",
            "known here: dc_motor, fmu, pendulum, sma_pair, and without a plant's table the",
        ],
    );
}

/// Reads a scenario from a file, as that of a recording.
fn recorded(controller: &str, plant: &str) -> Result<Scenario, String> {
    register_once();
    let folder = tempfile::tempdir().expect("a folder can be made");
    let path = folder.path().join("scenario.toml");
    std::fs::write(&path, text(controller, plant)).expect("it can be written");
    Scenario::load_recorded(&path, |_| Vec::new())
        .map(|(scenario, _)| scenario)
        .map_err(|error| format!("{:?}", miette::Report::new(error)))
}

#[test]
fn a_recorded_scenario_keeps_what_the_bench_does_not_have() {
    let rocket = "[plant.rocket]\nthrust_newtons = 3.0\nstages = [{ name = \"a\" }]\n\
        [[fault.plant.dropped_load]]\nfrom_seconds = 1.0\n\
        [sweep]\n[[sweep.list]]\nkey = \"plant.rocket.thrust_newtons\"\nvalues = [1.0, 2.0]\n";
    let scenario = recorded("[controller.fuzzy]\nrules = 3\n", rocket).unwrap();
    assert_eq!(scenario.plant.name(), "rocket");
    assert_eq!(scenario.controller.law_name(), "fuzzy");
    // One that the bench has may have been another one when it was played.
    let scenario = recorded(RELAY, "[plant.pendulum]\nmass_kilograms = 1.0\n").unwrap();
    assert_eq!(scenario.plant.name(), "pendulum");
    let scenario = recorded("[controller.pid]\n", "").unwrap();
    assert_eq!(scenario.plant.name(), scenario::plant::SMA_ACTUATOR);
}

#[test]
fn a_recorded_scenario_is_checked_in_all_else() {
    for (controller, plant, expected) in [
        (
            RELAY,
            "[plant]\nrocket = 3\n",
            "unknown key `rocket` in [plant]",
        ),
        (RELAY, "[plant.Rocket]\n", "unknown plant `Rocket`"),
        (
            RELAY,
            "[plant.rocket]\n[plant.dc_motor]\n",
            "is a second plant beside",
        ),
        (RELAY, "[plant.a]\n[plant.b]\n", "is a second plant beside"),
        (
            "[controller.a]\n[controller.b]\n",
            "",
            "more than one control law",
        ),
        ("[controller.pid]\nkp = 1.0\n", "", "unknown key `kp`"),
        (
            RELAY,
            "[plant.sensor]\nresolution_bits = 0\n",
            "out of range",
        ),
        (RELAY, "[rocket]\n", "unknown key `rocket` in the scenario"),
    ] {
        let error = recorded(controller, plant).expect_err(expected);
        assert!(error.contains(expected), "{expected} is not in {error}");
    }
}

#[test]
fn two_plants_two_laws_a_wire_and_a_strange_fault_are_refused() {
    let pendulum = "[plant.pendulum]\n";
    refused(
        RELAY,
        &format!("{pendulum}[plant.dc_motor]\n"),
        &["`dc_motor` is a second plant beside `pendulum`"],
    );
    refused(
        &format!("{RELAY}[controller.pid]\n"),
        pendulum,
        &["more than one control law"],
    );
    refused(
        RELAY,
        &format!("{pendulum}[plant.heat]\nambient_celsius = 21.0\n"),
        &["`plant.heat` is a key of the wire, and the plant is `pendulum`"],
    );
    let fault = |kind| format!("{pendulum}[[fault.plant.{kind}]]\nfrom_seconds = 1.0\n");
    refused(
        RELAY,
        &fault("dropped_load"),
        &[
            "cannot happen to the plant `pendulum`",
            "what can: jammed_pulley",
        ],
    );
    assert!(parsed(RELAY, &fault("jammed_pulley")).is_ok());
}

#[test]
fn the_schema_describes_them() {
    register_once();
    let schema: serde_json::Value = serde_json::from_str(&scenario::schema::json_schema()).unwrap();
    let pendulum = &schema["definitions"]["Plant"]["properties"]["pendulum"];
    assert_eq!(pendulum["description"], "A pendulum.");
    assert_eq!(pendulum["properties"]["length_metres"]["maximum"], 10.0);
    assert_eq!(
        schema["definitions"]["Controller"]["properties"]["relay"]["required"][0],
        "current_amperes"
    );
}

#[test]
fn what_cannot_be_a_table_is_refused_when_it_is_registered() {
    let plant = |table| register(Section::Plant, vec![table]).unwrap_err();
    assert!(matches!(
        plant(OwnTable::new::<Pendulum>("heat")),
        InvalidOwn::Taken { .. }
    ));
    assert!(matches!(
        plant(OwnTable::new::<Pendulum>("sma_actuator")),
        InvalidOwn::Taken { .. }
    ));
    assert!(matches!(
        plant(OwnTable::new::<Pendulum>("My Plant")),
        InvalidOwn::Name(_)
    ));
    assert!(matches!(
        plant(OwnTable::new::<f64>("number")),
        InvalidOwn::NoTable(_)
    ));
    let fault = OwnTable::new::<Pendulum>("swing").with_faults(&["rain"]);
    assert!(matches!(
        plant(fault),
        InvalidOwn::Fault { fault: "rain", .. }
    ));
    register_once();
    assert_eq!(
        plant(OwnTable::new::<Pendulum>("swing")),
        InvalidOwn::RegisteredAlready
    );
}
