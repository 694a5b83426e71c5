//! The schema of scenarios, composed of those of their parts.

use serde_json::{Map, Value, json};

use super::{HEADER, RIG, SECTIONS, SWEPT, entries, schema_of};
use crate::contour::Contours;
use crate::fault;
use crate::own;
use crate::plant::PlantModel;
use crate::port::Unit;
use crate::rig::nodes::Rig;

/// Tables whose entries say for which loop they are, and those that say for which node.
const OF_LOOPS: &str = "Reference";
const OF_NODES: &str = "Disturbance";
/// Definitions with names of positions besides those of set-points and of faults of the sensor: limits, and laws with gains.
const WITH_UNITS: [&str; 3] = ["Expect", "Pid", "PidPair"];
/// What gains of laws are by.
const PER_METRE: &str = "per_metre";
/// A unit of a loop, whichever it is.
const ANY_UNIT: &str = "[a-z][a-z0-9_]*";
/// What a loop's name is for.
const ALL: &str = "all";

/// Parts of a node to which a scenario may give other values, each with its definition.
const PARTS: [(&str, &str); 5] = [
    ("amplifier", "RigAmplifier"),
    ("sensor", "RigSensor"),
    ("plausible", "Plausible"),
    ("timeouts", "Timeouts"),
    ("preflight", "Preflight"),
];

/// The schema of scenarios on any rig.
pub(super) fn of_scenario() -> Value {
    let mut schema = with_names(of_parts());
    fault::describe(&mut schema);
    let mut schema = with_units(schema);
    let laws = properties(&schema, "Controller");
    let limits = with_contours(&mut schema);
    let models = models(&mut schema);
    schema["properties"]["controller"] = json!({
        "description": "The laws: `[controller.LOOP.LAW]`, or `[controller.all.LAW]` for one law over all loops; `[controller.LAW]` where there is one loop.",
        "type": "object",
        "properties": laws,
        "additionalProperties": {"$ref": "#/definitions/Controller"},
        "minProperties": 1,
    });
    schema["properties"]["expect"] = json!({
        "description": "Limits: `[expect.LOOP]` for a loop, `[expect.all]` for each of them; those of the bus, and of the only loop, in `[expect]` itself.",
        "type": "object",
        "properties": limits,
        "patternProperties": schema["definitions"]["Expect"]["patternProperties"],
        "additionalProperties": {"$ref": "#/definitions/Expect"},
    });
    schema["properties"]["plant"] = json!({
        "description": "Parameters that differ from those of the rig: `[plant.NAME]`.",
        "type": "object",
        "additionalProperties": {"type": "object", "anyOf": models},
    });
    let mut part = rig_part(&mut schema);
    schema["properties"]["node"] = json!({
        "description": "Values of nodes that differ from those of the rig, as in `[node.NAME.sensor]`.",
        "type": "object",
        "additionalProperties": part.take(),
    });
    prune(&mut schema);
    schema
}

/// The keys of a scenario that are no tables, the tables of a loop, the bus and the sweep.
fn of_parts() -> Value {
    let mut schema = HEADER.clone();
    schema["title"] = "Scenario".into();
    schema["description"] = "One scenario file.".into();
    schema["properties"]["bus"] = RIG["properties"]["bus"].clone();
    schema["properties"]["sweep"] = SWEPT["properties"]["sweep"].clone();
    let sections = SECTIONS["properties"].as_object();
    for (name, section) in sections.into_iter().flatten() {
        schema["properties"][name] = section.clone();
    }
    if let Some(required) = schema["required"].as_array_mut() {
        required.push("controller".into());
    }
    for part in [&*SECTIONS, &*SWEPT, &*RIG] {
        add_definitions(&mut schema, part);
    }
    schema
}

/// Takes away definitions to which nothing refers.
fn prune(schema: &mut Value) {
    let Some(mut definitions) = schema["definitions"].as_object().cloned() else {
        return;
    };
    schema["definitions"] = json!({});
    let mut used = Map::new();
    let mut referring = vec![schema.clone()];
    while let Some(value) = referring.pop() {
        for name in references(&value) {
            if let Some(definition) = definitions.remove(&name) {
                referring.push(definition.clone());
                used.insert(name, definition);
            }
        }
    }
    schema["definitions"] = used.into();
}

/// The names of all definitions to which a schema refers.
fn references(value: &Value) -> Vec<String> {
    match value {
        Value::Object(table) => {
            let own = table.get("$ref").and_then(Value::as_str);
            let own = own.and_then(|path| path.rsplit('/').next());
            let below = table.values().flat_map(references);
            own.map(str::to_owned).into_iter().chain(below).collect()
        }
        Value::Array(values) => values.iter().flat_map(references).collect(),
        _ => Vec::new(),
    }
}

/// The definition of the values of a part.
fn values(definition: &str) -> String {
    format!("{definition}Values")
}

/// The parts of a node, without how it is wired.
fn rig_part(schema: &mut Value) -> Value {
    let mut rig = schema_of::<Rig>();
    for (_, definition) in PARTS {
        let properties = rig["definitions"][definition]["properties"].as_object_mut();
        properties.into_iter().for_each(|properties| {
            properties.retain(|key, _| key != "port" && key != "unit");
        });
        // A value may be left out here which the rig file must have.
        if let Some(definition) = rig["definitions"][definition].as_object_mut() {
            definition.remove("required");
        }
        schema["definitions"][values(definition)] = rig["definitions"][definition].clone();
    }
    add_definitions(schema, &rig);
    let truth = rig["definitions"]["RigNode"]["properties"]["truth_every_cycles"].clone();
    let parts = PARTS.map(|(part, definition)| {
        let definition = reference(&values(definition));
        (part.to_owned(), definition)
    });
    let mut properties = Map::from_iter(parts);
    properties.insert("truth_every_cycles".to_owned(), truth);
    json!({"type": "object", "properties": properties, "additionalProperties": false})
}

/// The schema of scenarios on a rig: with the names of its loops, plants and nodes.
pub(crate) fn on_rig(rig: &Rig) -> Value {
    let mut schema = of_scenario();
    for (section, definition) in [("controller", "Controller"), ("expect", "Expect")] {
        let below = &mut schema["properties"][section];
        let names = rig.loops.keys().map(String::as_str).chain([ALL]);
        for name in names {
            below["properties"][name] = reference(definition);
        }
        below["default"] = json!({});
    }
    put_ranges(&mut schema, rig);
    let plants = rig.plant.iter().map(|(name, plant)| {
        let definition = match plant.key() {
            "dc_motor" => reference("DcMotor"),
            "sma" => reference("Sma"),
            "sma_pair" => reference("SmaPair"),
            "fmu" => fmu(&schema, plant),
            own => own::schema_of_plant(own),
        };
        let parameters = json!({"allOf": [definition], "default": {}});
        (name.clone(), parameters)
    });
    let plants = Map::from_iter(plants);
    schema["properties"]["plant"] = json!({"type": "object", "default": {}, "properties": plants});
    let nodes = rig.node.iter().map(|(name, node)| {
        let has = [
            node.amplifier.is_some(),
            node.sensor.is_some(),
            node.plausible.is_some(),
            node.timeouts.is_some(),
            node.preflight.is_some(),
        ];
        let parts = PARTS.into_iter().zip(has).filter(|(_, has)| *has);
        let parts = parts.map(|((part, definition), _)| {
            let definition = reference(&values(definition));
            (
                part.to_owned(),
                json!({"allOf": [definition], "default": {}}),
            )
        });
        let parts = Map::from_iter(parts);
        (
            name.clone(),
            json!({"type": "object", "default": {}, "properties": parts}),
        )
    });
    let nodes = Map::from_iter(nodes);
    schema["properties"]["node"] = json!({"type": "object", "default": {}, "properties": nodes});
    schema
}

/// An FMU with the start values that the rig file gives it, which may be other numbers.
fn fmu(schema: &Value, plant: &PlantModel) -> Value {
    let start = plant.fmu.iter().flat_map(|fmu| &fmu.start);
    let numbers = start.filter(|(_, value)| value.is_float() || value.is_integer());
    let numbers = numbers.map(|(name, _)| (name.clone(), json!({"type": "number"})));
    let mut fmu = schema["definitions"]["Fmu"].clone();
    fmu["properties"]["start"] =
        json!({"type": "object", "default": {}, "properties": Map::from_iter(numbers)});
    fmu
}

/// Set-points lie within what the sensor of one of the loops gives.
fn put_ranges(schema: &mut Value, rig: &Rig) {
    let ranges = rig.loops.keys();
    let ranges = ranges.map(|name| rig.wiring_of(rig.drive_of_loop(name)).feedback.range());
    let hull = ranges.reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])]);
    let Some([min, max]) = hull else { return };
    for definition in entries(schema, OF_LOOPS) {
        let properties = schema["definitions"][definition]["properties"].as_object_mut();
        for (key, property) in properties.into_iter().flatten() {
            let range = match key.split('_').next() {
                Some("position" | "centre") => [min, max],
                Some("amplitude") => [0.0, (max - min) / 2.0],
                _ => continue,
            };
            property["minimum"] = range[0].into();
            property["maximum"] = range[1].into();
        }
    }
}

fn reference(definition: &str) -> Value {
    json!({"$ref": format!("#/definitions/{definition}")})
}

fn properties(schema: &Value, definition: &str) -> Value {
    schema["definitions"][definition]["properties"].clone()
}

/// Lets names of positions, and gains by the metre, end in the units of angles too. Which of them is right is said by the rig file,
/// as is the range of set-points.
fn with_units(mut schema: Value) -> Value {
    let set_points = entries(&schema, OF_LOOPS);
    let others = entries(&schema, "SensorFaults");
    let others = others.into_iter().chain(WITH_UNITS.map(str::to_owned));
    let with_units = Vec::from_iter(set_points.iter().cloned().chain(others));
    let definitions = schema["definitions"].as_object_mut();
    let definitions = definitions.into_iter().flatten();
    for (name, definition) in definitions.filter(|(name, _)| with_units.contains(name)) {
        let Some(properties) = definition["properties"].as_object_mut() else {
            continue;
        };
        let names = Vec::from_iter(properties.keys().cloned());
        let mut any_unit = Map::new();
        for key in names {
            let of_units = [
                (Unit::Degrees, "per_degree"),
                (Unit::Revolutions, "per_revolution"),
            ];
            let of_units = of_units.map(|(unit, per_unit)| match key.contains(PER_METRE) {
                true => key.replacen(PER_METRE, per_unit, 1),
                false => unit.rename(&key),
            });
            let mut property = properties[&key].clone();
            if set_points.contains(name) && key.contains("millimetres") {
                without_range(&mut property);
                properties.insert(key.clone(), property.clone());
            }
            if of_units[0] != key {
                let by_any = key.replacen(PER_METRE, &format!("per_{ANY_UNIT}"), 1);
                let by_any = by_any.replacen("millimetres", ANY_UNIT, 1);
                any_unit.insert(format!("^{by_any}$"), property.clone());
            }
            for other in of_units {
                properties.entry(other).or_insert_with(|| property.clone());
            }
        }
        if !any_unit.is_empty() {
            definition["patternProperties"] = any_unit.into();
        }
        if let Some(required) = definition.get_mut("required").and_then(Value::as_array_mut) {
            let has_unit =
                |key: &Value| key.as_str().is_some_and(|key| key.contains("millimetres"));
            required.retain(|key| !has_unit(key));
        }
    }
    schema
}

fn without_range(property: &mut Value) {
    for key in ["minimum", "maximum"] {
        if let Some(property) = property.as_object_mut() {
            property.remove(key);
        }
    }
}

/// Lets entries name their loop or their node, and the scenario its rig.
fn with_names(mut schema: Value) -> Value {
    for (table, key, text) in [
        (
            OF_LOOPS,
            "loop",
            "The loop; needed where there are several.",
        ),
        (
            OF_NODES,
            "node",
            "The node; needed where there are several drives.",
        ),
    ] {
        for entry in entries(&schema, table) {
            let properties = &mut schema["definitions"][entry]["properties"];
            properties[key] = json!({"description": text, "type": "string"});
        }
    }
    let of_rig = json!({
        "description": "The rig: one that ships, such as `sma_actuator`, or a rig file beside this one.",
        "type": "string",
        "minLength": 1,
        "maxLength": 200,
    });
    schema["properties"]["rig"] = of_rig;
    if let Some(required) = schema["required"].as_array_mut() {
        required.push("rig".into());
    }
    schema
}

/// The limits of one loop, and of several together.
fn with_contours(schema: &mut Value) -> Value {
    let contours = schema_of::<Contours>();
    let mut limits = properties(schema, "Expect");
    limits["contour"] = contours["properties"]["contour"].clone();
    add_definitions(schema, &contours);
    limits
}

/// What the parameters of a plant may be.
fn models(schema: &mut Value) -> Value {
    let mut model = schema_of::<PlantModel>();
    own::describe_plants(&mut model["properties"]);
    add_definitions(schema, &model);
    let models = model["properties"].as_object().into_iter().flatten();
    models.map(|(_, model)| without_null(model)).collect()
}

/// The table alone of one that may be absent.
fn without_null(model: &Value) -> Value {
    let mut model = model.clone();
    if let Some(model) = model.as_object_mut() {
        model.remove("default");
        model.remove("description");
    }
    model
}

fn add_definitions(schema: &mut Value, other: &Value) {
    let added = other["definitions"].as_object().into_iter().flatten();
    for (name, definition) in added {
        if schema["definitions"].get(name).is_none() {
            schema["definitions"][name] = definition.clone();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Document;
    use crate::error::Source;
    use crate::schema::{assert_committed, json_schema, rig_json_schema};
    use crate::structure;

    #[test]
    fn the_committed_schemas_are_current() {
        assert_committed("schema.json", &json_schema());
        assert_committed("rig_schema.json", &rig_json_schema());
    }

    const SCENARIO: &str = r#"
schema = 1
name = "two moves"
rig = "rig.toml"
duration_seconds = 3.0
[controller.all.pid]
[controller.x.pid]
proportional_amperes_per_metre = 3.0
[plant.gantry_x]

load_kilograms = 0.3
[[reference.hold]]
loop = "x"
at_seconds = 1.0
position_millimetres = 20.0
[[disturbance.fan]]
node = "module"
from_seconds = 1.0
until_seconds = 2.0
convection_factor = 2.0
[[fault.sensor.noise]]
node = "y"
from_seconds = 2.5
noise_millimetres_rms = 0.1
[[fault.bus.lose]]
receiver = "y"
from_seconds = 1.0
[[fault.node.hang]]
node = "x"
from_seconds = 1.0
[expect]
bus_load_percent = { max = 60.0 }
[expect.x]
overshoot_percent = { max = 60.0 }
[[expect.contour]]
loops = ["x", "y"]
contour_error_millimetres_max = { max = 0.3 }
"#;

    fn problems(text: &str) -> String {
        let document = Document::parse(Source::new("s.toml", text), text).unwrap();
        let problems = structure::check(&document, "the scenario", &of_scenario());
        problems
            .iter()
            .map(|problem| format!("{problem:?}"))
            .collect()
    }

    #[test]
    fn an_editor_knows_what_has_names() {
        assert_eq!(problems(SCENARIO), "");
        for (right, wrong, said) in [
            ("schema = 1", "schema = 2", "`schema` = 2 is out of range"),
            (
                "loop = \"x\"",
                "loop = 3",
                "`reference.hold.loop` must be a string",
            ),
            ("node = \"y\"", "nod = \"y\"", "did you mean `node`?"),
            (
                "receiver = \"y\"",
                "reciever = \"y\"",
                "did you mean `receiver`?",
            ),
            ("overshoot", "overshot", "did you mean `overshoot_percent`?"),
            (
                "proportional",
                "proportionel",
                "did you mean `proportional_amperes",
            ),
            ("rig = ", "rigg = ", "did you mean `rig`?"),
        ] {
            let found = problems(&SCENARIO.replacen(right, wrong, 1));
            assert!(found.contains(said), "{wrong}: {found}");
        }
    }
}
