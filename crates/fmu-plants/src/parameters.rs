//! Parameters of a plant as variables, by the schema of its table.

use fmu::StartValue;
use fmu::export::{ModelVariable, Role};
use fmu::unit::unit_in_name;
use scenario::custom;
use serde_json::{Map, Value, json};

/// Parameters of a plant: numbers and choices, each with its path of keys.
pub(crate) struct Parameters(Vec<Parameter>);

struct Parameter {
    keys: Vec<String>,
    is_whole: bool,
    variable: ModelVariable,
}

impl Parameters {
    /// Returns the parameters of a type.
    pub(crate) fn of<C: custom::Parameters>() -> Self {
        let mut parameters = Vec::new();
        collect(&custom::schema::<C>(), &[], &mut parameters);
        // Maps may have any order, but description and library must agree.
        parameters.sort_by(|one, other| one.keys.cmp(&other.keys));
        Self(parameters)
    }

    pub(crate) fn variables(&self) -> impl Iterator<Item = ModelVariable> {
        self.0.iter().map(|parameter| parameter.variable.clone())
    }

    /// Returns the default values, in the order of the variables.
    pub(crate) fn defaults(&self) -> impl Iterator<Item = StartValue> {
        let parameters = self.0.iter();
        parameters.filter_map(|parameter| parameter.variable.role.start())
    }

    /// Returns the table with these values, in the order of the variables.
    pub(crate) fn read<C: custom::Parameters>(&self, values: &[StartValue]) -> Result<C, String> {
        let mut table = Value::Object(Map::new());
        for (parameter, value) in self.0.iter().zip(values) {
            let value = match value {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "a whole number, or refused below"
                )]
                StartValue::Number(number) if parameter.is_whole && number.fract() == 0.0 => {
                    json!(*number as i64)
                }
                StartValue::Number(number) => json!(number),
                StartValue::Text(text) => json!(text),
            };
            let place = parameter
                .keys
                .iter()
                .fold(&mut table, |table, key| &mut table[key.as_str()]);
            *place = value;
        }
        serde_json::from_value(table).map_err(|error| error.to_string())
    }
}

/// Collects the numbers and choices of a schema and of its tables, if they have a default.
fn collect(schema: &Value, keys: &[String], into: &mut Vec<Parameter>) {
    let Some(properties) = schema["properties"].as_object() else {
        return;
    };
    for (key, property) in properties {
        let keys = [keys, std::slice::from_ref(key)].concat();
        // The default of a table contains those of its keys.
        let Some(role) = role(property) else {
            collect(property, &keys, into);
            continue;
        };
        let description = property["description"].as_str().unwrap_or_default();
        let variable = ModelVariable {
            name: keys.join("."),
            description: description.to_owned(),
            unit: unit_in_name(key).map_or("", |known| known.symbol),
            role,
        };
        into.push(Parameter {
            keys,
            is_whole: property["type"] == "integer",
            variable,
        });
    }
}

fn role(property: &Value) -> Option<Role> {
    let default = &property["default"];
    if let Some(start) = default.as_f64() {
        return Some(Role::Number {
            start,
            min: property["minimum"]
                .as_f64()
                .or(property["exclusiveMinimum"].as_f64()),
            max: property["maximum"].as_f64(),
        });
    }
    let start = default.as_str()?.to_owned();
    Some(Role::Word { start })
}
