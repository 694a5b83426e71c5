//! The schema of scenarios, composed of the schemas of their parts.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use super::{CONTOURS, RIG, RUN, TRIAL, entries, part_of, resolve};
use crate::document::KeyContext;
use crate::fault;
use crate::node::Profile;
use crate::plant::PlantModel;
use crate::rig::nodes::Rig;
use dbc::{Quantities, Quantity, Unit, conversion, is_gain, is_pattern, known_units};

/// Tables whose entries name their loop, and tables whose entries name their node.
const LOOP_ENTRIES: &str = "Reference";
const NODE_ENTRIES: &str = "Disturbance";
/// Pattern of a unit or a signal.
const ANY_WORD: &str = "[a-z][a-z0-9_]*";
/// Key in the place of a loop's name.
const ALL: &str = "all";

/// Key of a node that is no part.
const TRUTH: &str = "truth_every_cycles";
/// Parts of a node that a scenario may change, each with its definition.
const PARTS: [(&str, &str); 5] = [
    ("amplifier", "RigAmplifier"),
    ("sensor", "RigSensor"),
    ("plausible", "Plausible"),
    ("timeouts", "Timeouts"),
    ("preflight", "Preflight"),
];

/// Returns the schema of scenarios on any rig.
pub(super) fn scenario_schema() -> Value {
    let mut schema = loops_schema(&Unit::NAMED.map(Quantities::of_position), None);
    prune(&mut schema);
    schema
}

/// Returns the schema of scenarios whose loops have these signals, and whose set-points have this range.
fn loops_schema(loops: &[Quantities], travel: Option<KeyContext>) -> Value {
    let mut schema = parts_schema();
    put_name(&mut schema, LOOP_ENTRIES, "loop", "several");
    put_name(&mut schema, NODE_ENTRIES, "node", "several drives");
    fault::describe(&mut schema);
    if let Some(travel) = travel {
        put_travel(&mut schema, &travel);
    }
    name_keys(&mut schema, loops);
    let laws = properties(&schema, "Controller");
    let mut limits = properties(&schema, "Expect");
    limits["contour"] = CONTOURS["properties"]["contour"].clone();
    let plants = properties(&RIG, "PlantModel");
    let all = plants.as_object().into_iter().flatten();
    let models = Vec::from_iter(all.map(|(_, model)| model_values(model)));
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
        "patternProperties": limits_or_loops(&schema),
        "additionalProperties": {"$ref": "#/definitions/Expect"},
    });
    schema["properties"]["plant"] = json!({
        "description": "Parameters that differ from those of the rig: `[plant.NAME]`.",
        "type": "object",
        "additionalProperties": {"type": "object", "anyOf": models},
    });
    let part = rig_part(&mut schema);
    schema["properties"]["node"] = json!({
        "description": "Values of nodes that differ from those of the rig, as in `[node.NAME.sensor]`.",
        "type": "object",
        "additionalProperties": part,
    });
    schema
}

/// Returns the schema of the keys that are not tables, the sweep, the rig, the tables of a loop and the bus.
fn parts_schema() -> Value {
    let mut schema = RUN.clone();
    schema["title"] = "Scenario".into();
    schema["description"] = "One scenario file.".into();
    schema["properties"]["rig"] = json!({
        "description": "The rig: one that ships, such as `sma_actuator`, or a rig file beside this one.",
        "type": "string",
        "minLength": 1,
        "maxLength": 200,
    });
    schema["properties"]["bus"] = RIG["properties"]["bus"].clone();
    let sections = TRIAL["properties"].as_object();
    for (name, section) in sections.into_iter().flatten() {
        schema["properties"][name] = section.clone();
    }
    if let Some(required) = schema["required"].as_array_mut() {
        required.extend(["controller".into(), "rig".into()]);
    }
    let parts = [&*TRIAL, &*RIG, &*CONTOURS].into_iter();
    let added = parts.flat_map(|part| part["definitions"].as_object());
    for (name, definition) in added.flatten() {
        if schema["definitions"].get(name).is_none() {
            schema["definitions"][name] = definition.clone();
        }
    }
    schema
}

/// Removes definitions without a reference, until each one that is left is referred to. No definition refers to itself.
fn prune(schema: &mut Value) {
    let mut count = usize::MAX;
    loop {
        let text = schema.to_string();
        let Some(definitions) = schema["definitions"].as_object_mut() else {
            return;
        };
        definitions.retain(|name, _| text.contains(&format!("\"#/definitions/{name}\"")));
        if definitions.len() == count {
            return;
        }
        count = definitions.len();
    }
}

/// Returns the name of the definition of a part's values.
fn values(definition: &str) -> String {
    format!("{definition}Values")
}

fn schema_of_truth() -> Value {
    RIG["definitions"]["RigNode"]["properties"][TRUTH].clone()
}

/// Returns the schema of the parts of a node, without its wiring. The rig file has the keys that are left out.
fn rig_part(schema: &mut Value) -> Value {
    let mut properties = Map::from_iter([(TRUTH.to_owned(), schema_of_truth())]);
    for (key, definition) in PARTS {
        let mut part = part_of(&RIG, &reference(definition));
        if let Some(keys) = part["properties"].as_object_mut() {
            keys.retain(|key, _| key != "port" && key != "unit");
        }
        schema["definitions"][values(definition)] = part;
        properties.insert(key.to_owned(), reference(&values(definition)));
    }
    json!({"type": "object", "properties": properties, "additionalProperties": false})
}

/// Returns the schema of scenarios on a rig: with the names of its loops, plants and nodes.
pub(crate) fn on_rig(rig: &Rig) -> Value {
    let drives = rig.of_kind(Profile::Drive);
    let mut loops = Vec::from_iter(drives.map(|(_, node)| node.quantities()));
    loops.dedup();
    let mut schema = loops_schema(&loops, travel(rig));
    for (section, definition) in [("controller", "Controller"), ("expect", "Expect")] {
        let below = &mut schema["properties"][section];
        let names = rig.loops.keys().map(String::as_str).chain([ALL]);
        for name in names {
            below["properties"][name] = reference(definition);
        }
        below["default"] = json!({});
    }
    let models = properties(&RIG, "PlantModel");
    let plants = rig.plant.iter().map(|(name, plant)| {
        let definition = match &plant.fmu {
            Some(_) => fmu(&schema, plant),
            None => resolve(&RIG, &models[plant.key()]).clone(),
        };
        let parameters = json!({"allOf": [definition], "default": {}});
        (name.clone(), parameters)
    });
    schema["properties"]["plant"] = table(plants);
    let nodes = rig.node.iter().map(|(name, node)| {
        let has = toml::Table::try_from(node).expect("plain data");
        let parts = PARTS
            .into_iter()
            .filter(|(part, _)| has.contains_key(*part))
            .map(|(part, definition)| {
                let definition = reference(&values(definition));
                let part_schema = json!({"allOf": [definition], "default": {}});
                (part.to_owned(), part_schema)
            });
        let is_emulated = node.kind == Profile::Drive && node.is_ours();
        let truth = is_emulated.then(|| (TRUTH.to_owned(), schema_of_truth()));
        (name.clone(), table(parts.chain(truth)))
    });
    schema["properties"]["node"] = table(nodes);
    schema
}

/// Returns the schema of a table that may be left out, as each of these keys may.
fn table(properties: impl IntoIterator<Item = (String, Value)>) -> Value {
    json!({"type": "object", "default": {}, "properties": Map::from_iter(properties)})
}

/// Returns the schema of an FMU; the start values that the rig file has may be other numbers.
fn fmu(schema: &Value, plant: &PlantModel) -> Value {
    let start = plant.fmu.iter().flat_map(|fmu| &fmu.start);
    let numbers = start
        .filter(|(_, value)| value.is_float() || value.is_integer())
        .map(|(name, _)| (name.clone(), json!({"type": "number"})));
    let mut fmu = schema["definitions"]["Fmu"].clone();
    fmu["properties"]["start"] = table(numbers);
    fmu
}

/// Returns the range of set-points: each lies within the range of one of the loops' sensors.
fn travel(rig: &Rig) -> Option<KeyContext> {
    let followed = rig
        .loops
        .values()
        .filter_map(|one| rig.node.get(one.followed()));
    let ranges = followed.map(|node| node.measured().range());
    let [min, max] = ranges.reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])])?;
    let mut travel = KeyContext::default();
    (travel.measured.min, travel.measured.max) = (min, Some(max));
    Some(travel)
}

/// Returns a reference to a definition.
pub(crate) fn reference(definition: &str) -> Value {
    json!({"$ref": format!("#/definitions/{definition}")})
}

fn properties(schema: &Value, definition: &str) -> Value {
    schema["definitions"][definition]["properties"].clone()
}

/// Gives set-points this range.
fn put_travel(schema: &mut Value, travel: &KeyContext) {
    for definition in entries(schema, LOOP_ENTRIES) {
        let properties = schema["definitions"][definition]["properties"].as_object_mut();
        for (key, property) in properties.into_iter().flatten() {
            if let Some([min, max]) = travel.range_of(key) {
                property["minimum"] = min.into();
                property["maximum"] = max.into();
            }
        }
    }
}

/// Writes out all keys that are patterns, as these loops have them.
fn name_keys(schema: &mut Value, loops: &[Quantities]) {
    let definitions = schema["definitions"].as_object_mut();
    for (_, table) in definitions.into_iter().flatten() {
        name_table_keys(table, loops);
    }
}

/// Returns each loop once for every unit that its gains may be per.
fn by_any_unit(loops: &[Quantities]) -> Vec<Quantities> {
    let by_units = loops.iter().flat_map(|quantities| {
        let is_convertible =
            |unit: &&str| conversion(quantities.feedback.unit.law_word(), unit).is_some();
        let units = known_units()
            .filter(is_convertible)
            .map(|unit| Unit::Other(unit.to_owned()));
        let others = units.map(|unit| {
            let mut by = quantities.clone();
            by.feedback.unit = unit;
            by
        });
        [quantities.clone()].into_iter().chain(others)
    });
    by_units.collect()
}

/// Writes out the keys of a table, and of its tables, as these loops have them. Names in other loops match patterns: the rig file
/// decides which of them is right.
fn name_table_keys(table: &mut Value, loops: &[Quantities]) {
    let Some(properties) = table.get_mut("properties").and_then(Value::as_object_mut) else {
        return;
    };
    let any_share = Quantity::new(ANY_WORD, Unit::Other("percent".to_owned()));
    let any_loop = Quantity::known()
        .chain([any_share])
        .map(|output| Quantities {
            feedback: Quantity::new(ANY_WORD, Unit::Other(ANY_WORD.to_owned())),
            output,
        });
    let any_loop = Vec::from_iter(any_loop);
    let shipped = Quantities::default();
    let mut patterns = Map::new();
    for (key, mut property) in std::mem::take(properties) {
        name_table_keys(&mut property, loops);
        if !is_pattern(&key) {
            properties.insert(key, property);
            continue;
        }
        let mut other = property.clone();
        // A default is in the unit of the shipped rig.
        other
            .as_object_mut()
            .and_then(|keywords| keywords.remove("default"));
        let loops = if is_gain(&key) {
            by_any_unit(loops)
        } else {
            loops.to_vec()
        };
        for name in loops.iter().map(|quantities| quantities.name(&key)) {
            let is_shipped = name == shipped.name(&key);
            let property = if is_shipped { &property } else { &other };
            properties.insert(name, property.clone());
        }
        let any_name = BTreeSet::from_iter(any_loop.iter().map(|any| any.name(&key)));
        let any_name = Vec::from_iter(any_name).join("|");
        patterns.insert(format!("^({any_name})$"), other);
    }
    if patterns.is_empty() {
        return;
    }
    table["patternProperties"] = patterns.into();
    if let Some(required) = table.get_mut("required").and_then(Value::as_array_mut) {
        let count = required.len();
        required.retain(|key| !key.as_str().is_some_and(is_pattern));
        // The count requires as many keys, whatever their names.
        if required.len() < count {
            table["minProperties"] = count.into();
        }
    }
}

/// Returns the schema of keys that may be a limit in any unit, or a loop of the same name.
fn limits_or_loops(schema: &Value) -> Value {
    let limits = schema["definitions"]["Expect"]["patternProperties"].as_object();
    let either = limits.into_iter().flatten().map(|(pattern, limit)| {
        let either = json!({"anyOf": [limit, reference("Expect")]});
        (pattern.clone(), either)
    });
    either.collect::<Map<_, _>>().into()
}

/// Lets the entries of a table name their loop or their node.
fn put_name(schema: &mut Value, table: &str, key: &str, where_needed: &str) {
    for entry in entries(schema, table) {
        let text = format!("The {key}; needed where there are {where_needed}.");
        let properties = &mut schema["definitions"][entry]["properties"];
        properties[key] = json!({"description": text, "type": "string"});
    }
}

/// Returns the schema of other values for a model. The rig file has the keys that are left out.
fn model_values(model: &Value) -> Value {
    let mut model = if model["properties"].is_object() {
        part_of(model, model)
    } else {
        model.clone()
    };
    if let Some(model) = model.as_object_mut() {
        model.remove("default");
        model.remove("description");
    }
    model
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
        let problems = structure::check(&document, "the scenario", &scenario_schema());
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
