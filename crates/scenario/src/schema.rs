//! The JSON Schemas of scenario and rig files: what editors complete from and what the loader checks against.

use std::sync::LazyLock;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::Value;

use crate::null::TakeNullAway;
use crate::own;
use crate::rig::RigFile;
use crate::scenario::Scenario;
use crate::view::ControllerView;

/// What scenario files are checked against. To make a schema takes most of the time that loading takes, so each is made once.
pub(crate) static SCENARIO: LazyLock<Value> = LazyLock::new(schema_of::<Scenario>);
/// What recorded scenarios are checked against: the same without plants and laws from outside.
pub(crate) static SHIPPED: LazyLock<Value> = LazyLock::new(shipped::<Scenario>);
/// What the controller checks of scenario files.
pub(crate) static CONTROLLER_VIEW: LazyLock<Value> = LazyLock::new(schema_of::<ControllerView>);
/// What rig files are checked against.
pub(crate) static RIG: LazyLock<Value> = LazyLock::new(schema_of::<RigFile>);

/// The JSON Schema of scenario files, as committed in `scenarios/schema.json`.
#[must_use]
pub fn json_schema() -> String {
    format!("{:#}\n", schema_of::<Scenario>())
}

/// The JSON Schema of rig files, as committed in `scenarios/rig_schema.json`.
#[must_use]
pub fn rig_json_schema() -> String {
    format!("{:#}\n", schema_of::<RigFile>())
}

/// The schema of a type, with the plants and laws from outside; its definitions stand in `definitions`.
pub(crate) fn schema_of<T: JsonSchema>() -> Value {
    let mut schema = shipped::<T>();
    own::describe(&mut schema);
    schema
}

/// The schema of a type as it ships.
fn shipped<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft07().with_transform(TakeNullAway);
    settings.into_generator().into_root_schema_for::<T>().into()
}

/// The copy in `scenarios/` is the schema; with UPDATE_SCHEMA it becomes so.
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
