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
    let kinds = KINDS
        .iter()
        .map(|kind| (definition(kind), kind_schema(kind)));
    let group_kinds = Group::ALL.map(|group| (group_definition(group), kinds_schema(group)));
    let groups = Group::ALL.map(|group| {
        let described = reference_to(&group_definition(group), group.text());
        (group.name().to_owned(), described)
    });
    let faults = json!({
        "description": TEXT,
        "type": "object",
        "properties": Map::from_iter(groups),
        "additionalProperties": false,
    });
    let choices = KINDS.iter().flat_map(|kind| kind.keys).filter_map(|key| {
        let Form::Word(words) = key.form else {
            return None;
        };
        let words = words
            .iter()
            .map(|(word, text)| json!({"const": word, "description": text, "type": "string"}));
        Some((
            capitalised(key.name),
            json!({"oneOf": Vec::from_iter(words)}),
        ))
    });
    let all = [("Faults".to_owned(), faults)];
    if let Some(definitions) = schema["definitions"].as_object_mut() {
        definitions.extend(kinds.chain(group_kinds).chain(choices).chain(all));
    }
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
    json!({
        "description": group.text(),
        "type": "object",
        "properties": Map::from_iter(arrays),
        "additionalProperties": false,
    })
}

fn kind_schema(kind: &Kind) -> Value {
    let mut properties = times(kind.time);
    let mut required = match kind.time {
        Time::Lasts | Time::Ends => vec!["from_seconds"],
        Time::Instant => vec!["at_seconds"],
        Time::Boot => Vec::new(),
    };
    for key in kind.keys {
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
    json!({
        "description": kind.text,
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    })
}

fn times(time: Time) -> Map<String, Value> {
    let seconds = |text: &str| {
        json!({
            "description": text,
            "type": "number",
            "format": "double",
            "minimum": 0.0,
            "maximum": TIME_SECONDS_MAX,
        })
    };
    let until = match time {
        Time::Ends => "When the fault ends.",
        _ => "When the fault ends; with the run if absent.",
    };
    let keys = match time {
        Time::Lasts | Time::Ends => vec![
            ("from_seconds", "When the fault begins."),
            ("until_seconds", until),
        ],
        Time::Instant => vec![("at_seconds", "When it happens.")],
        Time::Boot => Vec::new(),
    };
    let keys = keys.into_iter();
    keys.map(|(key, text)| (key.to_owned(), seconds(text)))
        .collect()
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
            let text = key.text.trim_end_matches('.');
            format!("{text}: the name of a node; `bench` is canrig's own node.").into()
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
