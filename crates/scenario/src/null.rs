//! Schemas without null, which TOML does not have.

use schemars::Schema;
use serde_json::Value;

/// Removes null from a schema: TOML omits an optional value, so "or null" only misleads.
#[derive(Clone, Debug)]
pub(crate) struct TakeNullAway;

impl schemars::transform::Transform for TakeNullAway {
    fn transform(&mut self, schema: &mut Schema) {
        schemars::transform::transform_subschemas(self, schema);
        let Some(object) = schema.as_object_mut() else {
            return;
        };
        if let Some(Value::Array(types)) = object.get_mut("type") {
            types.retain(|name| name != "null");
            if let [only] = types.as_slice() {
                let only = only.clone();
                object.insert("type".to_owned(), only);
            }
        }
        if let Some(default) = object.get_mut("default") {
            without_nulls(default);
            if default.is_null() {
                object.remove("default");
            }
        }
        if let Some(Value::Array(mut alternatives)) = object.remove("anyOf") {
            alternatives.retain(|alternative| alternative["type"] != "null");
            let name = if alternatives.len() == 1 {
                "allOf"
            } else {
                "anyOf"
            };
            object.insert(name.to_owned(), Value::Array(alternatives));
        }
    }
}

/// Removes the keys without a value from the tables of a default.
fn without_nulls(default: &mut Value) {
    if let Value::Object(table) = default {
        table.retain(|_, value| !value.is_null());
        table.values_mut().for_each(without_nulls);
    }
}
