//! The JSON Schema of `[fault]`, made from the table of faults, and its text.

use serde_json::{Map, Value, json};

use super::{Form, Group, KINDS, Key, Kind, Need, Time};
use crate::TIME_SECONDS_MAX;
use crate::schema::reference;

/// Largest number of entries of an array.
const ENTRIES_MAX: usize = 100;
const TEXT: &str = "Injected faults, by where they act; the nodes do not know of them. Each kind says where it acts and whether `bus.log` shows it.";

/// Returns a schema whose only section is `[fault]`. The entries of arrays are tables with schemas of their own, among the
/// definitions: each has the unit of its own loop.
pub(crate) fn described() -> Value {
    let mut schema = json!({"type": "object", "properties": {}, "definitions": {}});
    describe(&mut schema);
    for kind in KINDS {
        let arrays = &mut schema["definitions"][group_definition(kind.group)]["properties"];
        arrays[kind.name]["items"] = json!({"type": "object", "anyOf": []});
    }
    schema
}

/// Adds `[fault]` to a schema.
pub(crate) fn describe(schema: &mut Value) {
    let definitions = &mut schema["definitions"];
    for kind in KINDS {
        definitions[definition(kind)] = kind_schema(kind);
        for key in kind.keys {
            if let Form::Word(words) = key.form {
                let choices = words.iter().map(
                    |(word, text)| json!({"const": word, "description": text, "type": "string"}),
                );
                definitions[capitalised(key.name)] = json!({"oneOf": Vec::from_iter(choices)});
            }
        }
    }
    let groups = Group::ALL.map(|group| {
        let name = group_definition(group);
        definitions[&name] = kinds_schema(group);
        (group.name().to_owned(), reference_to(&name, group.text()))
    });
    definitions["Faults"] = table(TEXT, groups);
    schema["properties"]["fault"] = reference_to("Faults", TEXT);
}

/// Returns the name of a group's definition.
fn group_definition(group: Group) -> String {
    format!("{}Faults", capitalised(group.name()))
}

/// Returns the name of a kind's definition.
pub(super) fn definition(kind: &Kind) -> String {
    let words = kind.name.split('_').map(capitalised);
    format!("{}Fault", words.collect::<String>())
}

fn capitalised(word: &str) -> String {
    let (first, rest) = word.split_at(1);
    format!("{}{rest}", first.to_ascii_uppercase())
}

fn reference_to(definition: &str, text: &str) -> Value {
    json!({"allOf": [reference(definition)], "description": text})
}

fn kinds_schema(group: Group) -> Value {
    let kinds = KINDS.iter().filter(|kind| kind.group == group);
    let arrays = kinds.map(|kind| {
        let array = json!({
            "description": kind.text,
            "type": "array",
            "items": reference(&definition(kind)),
            "maxItems": ENTRIES_MAX,
        });
        (kind.name.to_owned(), array)
    });
    table(group.text(), arrays)
}

fn kind_schema(kind: &Kind) -> Value {
    let mut properties = Map::new();
    let mut required = Vec::new();
    for key in times(kind.time).iter().chain(kind.keys) {
        properties.insert(key.name.to_owned(), key_schema(key));
        required.extend(matches!(key.need, Need::Required).then_some(key.name));
    }
    if kind.is_drive_fault() {
        let node = name("The drive; needed where there are several.");
        properties.insert("node".to_owned(), node);
    }
    if kind.group == Group::Plant {
        let plant = name("The plant, in place of one of its drives.");
        properties.insert("plant".to_owned(), plant);
    }
    let mut schema = table(kind.text, properties);
    schema["required"] = required.into();
    schema
}

/// Returns the schema of a table with these keys alone.
fn table(text: &str, properties: impl IntoIterator<Item = (String, Value)>) -> Value {
    json!({
        "description": text,
        "type": "object",
        "properties": Map::from_iter(properties),
        "additionalProperties": false,
    })
}

/// Returns the keys of the time of a fault.
fn times(time: Time) -> Vec<Key> {
    let seconds = |name| Key::number(name, 0.0, TIME_SECONDS_MAX);
    let from = seconds("from_seconds").with_text("When the fault begins.");
    let until = seconds("until_seconds").needed(Need::Optional);
    match time {
        Time::Lasts => vec![
            from,
            until.with_text("When the fault ends; with the run if absent."),
        ],
        Time::Ends => vec![from, until.with_text("When the fault ends.")],
        Time::Instant => vec![seconds("at_seconds").with_text("When it happens.")],
        Time::Boot => Vec::new(),
    }
}

fn name(text: &str) -> Value {
    json!({"description": text, "type": "string"})
}

fn key_schema(key: &Key) -> Value {
    let mut schema = match key.form {
        Form::Number(min, max) => {
            json!({"type": "number", "format": "double", "minimum": min, "maximum": max})
        }
        Form::Whole(min, max) => {
            json!({"type": "integer", "format": "uint32", "minimum": min, "maximum": max})
        }
        Form::Word(_) => json!({"allOf": [reference(&capitalised(key.name))]}),
        Form::Node | Form::Station => json!({"type": "string"}),
    };
    schema["description"] = match key.form {
        Form::Station => {
            let whose = key.text.trim_end_matches('.');
            format!("{whose}: the name of a node; `bench` is canrig's own node.").into()
        }
        _ => key.text.into(),
    };
    match key.need {
        Need::Default(number) if matches!(key.form, Form::Whole(..)) => {
            #[expect(clippy::cast_possible_truncation, reason = "a whole number")]
            let whole = number as i64;
            schema["default"] = whole.into();
        }
        Need::Default(number) => schema["default"] = number.into(),
        Need::DefaultWord(word) => schema["default"] = word.into(),
        Need::Required | Need::Optional => {}
    }
    schema
}
