//! The JSON Schemas of scenario and rig files: editors complete from them, and the loader checks against them.

mod loops;

use std::sync::LazyLock;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use crate::contour::Contours;
use crate::custom;
use crate::fault;
use crate::null::TakeNullAway;
use crate::rig::nodes::Rig;
use crate::run::Run;
use crate::trial::Trial;

/// Schema of the trial of a loop. Making a schema takes most of the time of loading, so each is made once.
pub(crate) static TRIAL: LazyLock<Value> = LazyLock::new(schema_of::<Trial>);
/// Schema of the keys of a scenario that are not tables, and of `[sweep]`.
pub(crate) static RUN: LazyLock<Value> = LazyLock::new(schema_of::<Run>);
/// Schema of rig files.
pub(crate) static RIG: LazyLock<Value> = LazyLock::new(schema_of::<Rig>);

/// Schema of `[[expect.contour]]`.
pub(crate) static CONTOURS: LazyLock<Value> = LazyLock::new(schema_of::<Contours>);

/// Schema of `[fault]`.
pub(crate) static FAULTS: LazyLock<Value> = LazyLock::new(fault::described);

/// Keyword of the loader for numbers in steps. Editors would take `multipleOf` in binary fractions, of which 12.7 is no multiple
/// of 0.1.
pub(crate) const MULTIPLE_OF: &str = "x-multiple-of";

pub(crate) use loops::{on_rig, reference};

/// Returns the schema for a recording, which may have any plant and any law: it holds their effects, and they need not be known
/// here.
pub(crate) fn recorded(schema: &Value) -> Value {
    let mut schema = schema.clone();
    for (section, definition) in custom::DEFINITIONS {
        let table = &mut schema["definitions"][definition];
        // A schema without keywords admits everything.
        table["additionalProperties"] = json!({});
        for name in custom::names(section) {
            table["properties"][name] = json!({});
        }
    }
    schema
}

/// Returns the definitions of a table's arrays.
pub(crate) fn entries(schema: &Value, table: &str) -> Vec<String> {
    let arrays = schema["definitions"][table]["properties"].as_object();
    let names = arrays.into_iter().flatten().filter_map(|(_, array)| {
        let name = array["items"]["$ref"].as_str()?.rsplit('/').next()?;
        Some(name.to_owned())
    });
    names.collect()
}

/// Checks whether a table of a loop or of the run has a key.
pub(crate) fn is_key(table: &str, key: &str) -> bool {
    let has = |schema: &Value| {
        let table = resolve(schema, &schema["properties"][table]);
        table["properties"].get(key).is_some()
    };
    [&*TRIAL, &*RUN].into_iter().any(has)
}

/// Returns the JSON Schema of scenario files, as committed in `scenarios/schema.json`.
pub fn json_schema() -> String {
    format!("{:#}\n", loops::scenario_schema())
}

/// Returns the JSON Schema of rig files, as committed in `scenarios/rig_schema.json`.
pub fn rig_json_schema() -> String {
    let mut schema = RIG.clone();
    let defaults = RIG["definitions"]["DriveDefaults"]["properties"].as_object();
    for key in defaults.into_iter().flat_map(Map::keys) {
        // Missing keys come from the defaults.
        let property = &mut schema["definitions"]["RigNode"]["properties"][key];
        *property = part_of(&RIG, property);
    }
    format!("{schema:#}\n")
}

/// Returns the schema of a table and its tables without required keys.
pub(crate) fn part_of(root: &Value, table: &Value) -> Value {
    let mut part = resolve(root, table).clone();
    let Some(keywords) = part.as_object_mut() else {
        return part;
    };
    keywords.remove("required");
    if let Some(text) = table.get("description") {
        keywords.insert("description".to_owned(), text.clone());
    }
    let properties = keywords
        .get_mut("properties")
        .and_then(Value::as_object_mut);
    for (_, property) in properties.into_iter().flatten() {
        if resolve(root, property)["properties"].is_object() {
            *property = part_of(root, property);
        }
    }
    part
}

/// Returns the schema of a type, with the plants and laws from outside; its definitions are in `definitions`.
pub(crate) fn schema_of<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft07().with_transform(TakeNullAway);
    let mut schema = settings.into_generator().into_root_schema_for::<T>().into();
    custom::describe(&mut schema);
    schema
}

/// Follows references to the definition that has the keywords; `root` is the whole schema.
pub(crate) fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    let target = schema["allOf"].get(0).unwrap_or(schema);
    let Some(reference) = target["$ref"].as_str() else {
        return target;
    };
    let name = reference.strip_prefix("#/definitions/");
    name.map_or(&Value::Null, |name| &root["definitions"][name])
}

/// Checks that the copy in `scenarios/` equals the schema; with UPDATE_SCHEMA it writes the copy.
#[cfg(test)]
#[track_caller]
pub(crate) fn assert_committed(name: &str, current: &str) {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios");
    let path = folder.join(name);
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, current).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == current,
        "out of date: run the tests with UPDATE_SCHEMA=1"
    );
}
