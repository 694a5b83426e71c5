//! The pages of the book with all keys of scenario and rig files, written from the schemas, so that they cannot age.
//! `UPDATE_SCHEMA=1 cargo test --release -p scenario` writes them.
#![expect(clippy::unwrap_used, reason = "tests fail by panicking")]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use dbc::{known_units, singular};
use serde_json::{Map, Value};

/// Largest number of references to a table that is repeated below each of them; other tables appear once, after all others.
const OWN_SECTIONS_MAX: usize = 2;
const REFERENCE: &str = "#/definitions/";

/// Page while it is written.
struct Page<'a> {
    definitions: &'a Map<String, Value>,
    /// Tables that many properties refer to.
    shared: BTreeSet<&'a str>,
    text: String,
}

/// Table below another one.
struct Child<'a> {
    path: String,
    is_list: bool,
    description: &'a str,
    table: &'a Value,
}

impl<'a> Page<'a> {
    fn text_of(schema: &'a Value, head: &str) -> String {
        let definitions = schema["definitions"].as_object().unwrap();
        let mut page = Self {
            definitions,
            shared: shared(schema),
            text: format!("{head}\n"),
        };
        page.section("Top of the file", "", "", schema);
        for name in page.shared.clone() {
            let table = &definitions[name];
            page.section(name, description(table), name, table);
        }
        page.text
    }

    /// Writes a table with its keys, then the tables below it.
    fn section(&mut self, heading: &str, about: &str, path: &str, table: &'a Value) {
        write!(self.text, "\n## {heading}\n\n").unwrap();
        if !about.is_empty() {
            write!(self.text, "{}\n\n", line(about)).unwrap();
        }
        let Some(properties) = table["properties"].as_object() else {
            return;
        };
        let mut children = Vec::new();
        self.text += "| key | value | meaning |\n|---|---|---|\n";
        for (key, property) in properties.iter() {
            if is_in_other_unit(key, properties) {
                continue;
            }
            let child = self.child(path, key, property);
            let section = child
                .as_ref()
                .map(|child| child.path.replace('.', "").to_lowercase());
            let row = self.row(key, property, is_required(table, key), section);
            self.text += &row;
            children.extend(child);
        }
        for child in children {
            let (open, close) = if child.is_list {
                ("[[", "]]")
            } else {
                ("[", "]")
            };
            let heading = format!("`{open}{}{close}`", child.path);
            self.section(&heading, child.description, &child.path, child.table);
        }
    }

    /// Writes the row of a key; `section` is the section of its table.
    fn row(
        &self,
        key: &str,
        property: &'a Value,
        is_required: bool,
        section: Option<String>,
    ) -> String {
        let kind = self.kind(property);
        let kind = match section {
            Some(section) => format!("[{kind}](#{section})"),
            None => kind,
        };
        let default = match &property["default"] {
            _ if is_required => "required".to_owned(),
            Value::Object(_) | Value::Array(_) | Value::Null => String::new(),
            value => format!("default `{value}`"),
        };
        let value: Vec<String> = [kind, range(property), default]
            .into_iter()
            .filter(|part| !part.is_empty())
            .collect();
        let meaning = format!("{}{}", line(description(property)), self.choices(property));
        format!("| `{key}` | {} | {meaning} |\n", value.join("; "))
    }

    /// Returns the table of a property, if it has a section.
    fn child(&self, path: &str, key: &str, property: &'a Value) -> Option<Child<'a>> {
        let is_list = property["type"] == "array";
        // A table whose keys the user chooses has tables that are all alike.
        let are_alike =
            property["additionalProperties"].is_object() && !property["properties"].is_object();
        if !is_list && property["properties"].is_object() {
            let separator = if path.is_empty() { "" } else { "." };
            return Some(Child {
                path: format!("{path}{separator}{key}"),
                is_list,
                description: description(property),
                table: property,
            });
        }
        let name = referred(match () {
            () if is_list => &property["items"],
            () if are_alike => &property["additionalProperties"],
            () => property,
        })?;
        let suffix = if are_alike { ".NAME" } else { "" };
        let table = &self.definitions[name];
        let is_child = table["properties"].is_object() && !self.shared.contains(name);
        let separator = if path.is_empty() { "" } else { "." };
        is_child.then(|| Child {
            path: format!("{path}{separator}{key}{suffix}"),
            is_list,
            description: match description(property) {
                "" => description(table),
                description => description,
            },
            table,
        })
    }

    /// Describes the type of a property.
    fn kind(&self, property: &Value) -> String {
        if let Some(name) = referred(property) {
            return self.definition_kind(name, "table");
        }
        match property["type"].as_str() {
            Some("array") => match referred(&property["items"]) {
                Some(name) => self.definition_kind(name, "list of tables"),
                None => format!("list of {}s", self.kind(&property["items"])),
            },
            Some("integer") => "whole number".to_owned(),
            Some("string") => "text".to_owned(),
            Some("boolean") => "`true` or `false`".to_owned(),
            Some("object") => "table".to_owned(),
            other => other.unwrap_or("table").to_owned(),
        }
    }

    fn definition_kind(&self, name: &str, table: &str) -> String {
        if self.shared.contains(name) {
            return format!("[{name}](#{})", name.to_lowercase());
        }
        let values: Vec<String> = self
            .values(name)
            .map(|(value, _)| format!("`{value}`"))
            .collect();
        if values.is_empty() {
            table.to_owned()
        } else {
            values.join(", ")
        }
    }

    /// Returns the values of a choice, each with its description.
    fn values(&self, name: &str) -> impl Iterator<Item = (&Value, &str)> {
        let values = self.definitions[name]["oneOf"]
            .as_array()
            .into_iter()
            .flatten();
        values.map(|value| (&value["const"], description(value)))
    }

    fn choices(&self, property: &Value) -> String {
        let name = referred(property).into_iter();
        let values = name
            .flat_map(|name| self.values(name))
            .map(|(value, meaning)| format!(" `{value}`: {}", line(meaning)));
        values.collect()
    }
}

fn description(schema: &Value) -> &str {
    schema["description"].as_str().unwrap_or_default()
}

/// Returns a text for a cell of a table.
fn line(text: &str) -> String {
    text.replace('\n', " ").replace('|', "\\|")
}

/// Checks whether a table must have a key. A key with another name in another loop is only counted there.
fn is_required(table: &Value, key: &str) -> bool {
    let mut required = table["required"].as_array().into_iter().flatten();
    let is_counted = table["minProperties"].is_number() && names_loop(key);
    required.any(|one| one == key) || is_counted
}

/// Checks whether a key has other names in other loops.
fn names_loop(key: &str) -> bool {
    ["millimetres", "amperes"]
        .iter()
        .any(|unit| key.contains(unit))
}

/// Returns the definition to which a schema refers.
fn referred(schema: &Value) -> Option<&str> {
    let reference = schema["$ref"]
        .as_str()
        .or_else(|| schema["allOf"][0]["$ref"].as_str());
    reference?.strip_prefix(REFERENCE)
}

/// Returns the tables to which many properties refer.
fn shared(schema: &Value) -> BTreeSet<&str> {
    let definitions = schema["definitions"].as_object().unwrap();
    let tables = definitions.values().chain([schema]);
    let properties = tables.filter_map(|table| table["properties"].as_object());
    let mut count: BTreeMap<&str, usize> = BTreeMap::new();
    for property in properties.flat_map(Map::values) {
        for name in [property, &property["items"]]
            .into_iter()
            .filter_map(referred)
        {
            *count.entry(name).or_default() += 1;
        }
    }
    let is_table = |name: &str| definitions[name]["properties"].is_object();
    let often = count
        .into_iter()
        .filter(|(name, count)| *count > OWN_SECTIONS_MAX && is_table(name));
    often.map(|(name, _)| name).collect()
}

/// Describes the values that a property may have.
fn range(property: &Value) -> String {
    let mut parts = Vec::new();
    let number = |key: &str| {
        let number = property[key].as_number()?.to_string();
        Some(
            number
                .strip_suffix(".0")
                .map_or(number.clone(), str::to_owned),
        )
    };
    let (least, above) = (number("minimum"), number("exclusiveMinimum"));
    let least = least.or_else(|| Some(format!("> {}", above?)));
    match (least, number("maximum")) {
        _ if property["enum"].is_array() => {}
        (Some(least), Some(most)) if least == most => parts.push(least),
        (Some(least), Some(most)) => parts.push(format!("{least} … {most}")),
        (Some(least), None) if least.starts_with('>') => parts.push(least),
        (Some(least), None) => parts.push(format!("≥ {least}")),
        (None, Some(most)) => parts.push(format!("≤ {most}")),
        (None, None) => {}
    }
    if let Some(values) = property["enum"].as_array() {
        let values: Vec<String> = values.iter().map(ToString::to_string).collect();
        parts.push(format!("one of {}", values.join(", ")));
    }
    parts.extend(number("x-multiple-of").map(|step| format!("a multiple of {step}")));
    parts.extend(number("maxLength").map(|most| format!("up to {most} characters")));
    parts.extend(number("maxItems").map(|most| format!("up to {most}")));
    parts.join("; ")
}

/// Checks whether a key of a table is another key in another unit.
fn is_in_other_unit(key: &str, properties: &Map<String, Value>) -> bool {
    let is_same = |shipped: &String, unit: &str| {
        shipped.replace("millimetres", unit) == key
            || shipped.replace("per_metre", &format!("per_{}", singular(unit))) == key
    };
    let is_key = |shipped: &String| known_units().any(|unit| is_same(shipped, unit));
    properties
        .keys()
        .any(|shipped| shipped != key && is_key(shipped))
}

#[track_caller]
fn check(name: &str, head: &str, schema: &str) {
    let current = Page::text_of(&serde_json::from_str(schema).unwrap(), head);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference");
    let path = folder.join(name);
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &current).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == current,
        "{name} is out of date: run the tests with UPDATE_SCHEMA=1"
    );
}

#[test]
fn the_page_of_scenario_keys_is_that_of_the_schema() {
    let head = "# Scenario keys\n\n\
        This page is written from the schema that `canrig schema` prints. A scenario is a TOML file; [a scenario of your own](../tutorial/own-scenario.md) builds one, \
        and [rigs with several drives](../several-drives.md#the-scenario) says how a scenario names loops and nodes.\n\
        The [metrics](metrics.md) page defines what each key of `[expect]` measures. Keys in millimetres end in the unit of the loop's sensor: `position_degrees` for `position_millimetres`, and a gain `per_degree` for one `per_metre`. Keys in amperes have the name of what its amplifier gives: `voltage_volts_rms` for `current_amperes_rms`. A gain may be by another unit of the quantity, `per_millimetre` or `per_revolution`, and is converted; any other key in another unit is refused with the right one. A law of your own adds its table.\n\n\
        \"Paper\" and the numbers of equations refer to Romano and Tannuri, \"New development on shape memory alloys actuators\": the wire and the sliding-mode law come from there. \"Assumed\" means that no source gives the value.";
    check("scenario-keys.md", head, &scenario::schema::json_schema());
}

#[test]
fn the_page_of_rig_keys_is_that_of_the_schema() {
    let head = "# Rig keys\n\n\
        This page is written from the schema that `canrig schema --rig` prints. A rig file names plants, nodes and loops: [rigs with several drives](../several-drives.md) builds one, \
        and [from the emulator to a drive](../hardware.md#the-rig-file) describes a real drive. A scenario gives other values to its rig by the same paths, without the name of a plant's model. A plant of your own adds its table.";
    check("rig-keys.md", head, &scenario::schema::rig_json_schema());
}

/// Every key of a schema is on a page: the keys of plants are on that of rigs.
#[test]
fn no_key_is_left_out() {
    use scenario::schema::{json_schema, rig_json_schema};
    let schemas = [json_schema(), rig_json_schema()];
    let schemas: [Value; 2] = schemas.map(|schema| serde_json::from_str(&schema).unwrap());
    let pages = schemas
        .each_ref()
        .map(|schema| Page::text_of(schema, ""))
        .concat();
    for schema in &schemas {
        let tables = schema["definitions"].as_object().unwrap().values();
        let keys = tables
            .chain([schema])
            .filter_map(|table| table["properties"].as_object());
        for (key, table) in keys.flat_map(|table| table.keys().map(move |key| (key, table))) {
            let is_there = pages.contains(&format!("| `{key}` |"));
            assert!(is_there || is_in_other_unit(key, table), "{key}");
        }
    }
}
