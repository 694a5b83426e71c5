//! The `[fault]` table as the loader takes it.

use std::collections::BTreeSet;

use serde_json::Value;

use super::{Faults, Touch};
use crate::{Scenario, schema};

fn parse(tables: &str) -> Result<Scenario, Vec<String>> {
    let text = format!(
        "schema = 1\nname = \"t\"\nduration_seconds = 9.0\n[controller.pid]\n[[reference.hold]]\n\
         at_seconds = 0.0\nposition_millimetres = 10.0\n{tables}"
    );
    let parsed = Scenario::parse(&text, "t.toml", |_| unreachable!("no table"));
    parsed.map_err(|error| error.problems().iter().map(ToString::to_string).collect())
}

/// The definition that a schema refers to.
fn resolved<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    let target = schema["allOf"].get(0).unwrap_or(schema);
    let pointer = target["$ref"].as_str().map(|pointer| &pointer[1..]);
    pointer.map_or(target, |pointer| root.pointer(pointer).unwrap())
}

/// Each group and kind of the schema, with the least table of the kind.
fn kinds() -> Vec<(String, String, String)> {
    let root = schema::schema_of::<Faults>();
    let mut kinds = Vec::new();
    for (group, schema) in root["properties"].as_object().unwrap() {
        let all = resolved(&root, schema)["properties"].as_object().unwrap();
        for (kind, schema) in all {
            let fault = resolved(&root, &schema["items"]);
            let required = fault["required"].as_array().unwrap().iter();
            let mut keys: Vec<&str> = required.map(|key| key.as_str().unwrap()).collect();
            if kind == "ageing" {
                keys.push("until_seconds");
            }
            let values = keys.iter().map(|key| {
                let schema = resolved(&root, &fault["properties"][key]);
                let value = match (&schema["oneOf"], schema["type"].as_str()) {
                    (Value::Array(words), _) => words[0]["const"].to_string(),
                    (_, Some("integer")) => schema["minimum"].as_u64().unwrap().to_string(),
                    _ if *key == "until_seconds" => "1.0".to_owned(),
                    _ => format!("{:.1}", schema["minimum"].as_f64().unwrap()),
                };
                format!("{key} = {value}\n")
            });
            let table = format!("[[fault.{group}.{kind}]]\n{}", values.collect::<String>());
            kinds.push((group.clone(), kind.clone(), table));
        }
    }
    kinds
}

#[test]
fn every_kind_is_a_window_with_its_name() {
    let kinds = kinds();
    assert!(kinds.len() >= 31, "{} kinds", kinds.len());
    for (group, kind, table) in kinds {
        let scenario = parse(&table).unwrap_or_else(|problems| panic!("{table}: {problems:?}"));
        let windows = scenario.fault.windows();
        assert_eq!(windows.len(), 1, "{group}.{kind}");
        assert_eq!(
            (windows[0].place.group, windows[0].place.kind),
            (&*group, &*kind)
        );
        let touches_none = matches!(windows[0].touch, Touch::Nothing);
        let is_behind_the_drive = !["bus", "node"].contains(&&*group);
        let touches_none_expected = is_behind_the_drive || kind == "duplicate";
        assert_eq!(touches_none, touches_none_expected, "{group}.{kind}");
        assert!(!scenario.fault.is_empty());
        let text = toml::to_string(&scenario.fault).unwrap();
        assert!(text.contains(&format!("[[{group}.{kind}]]")), "{text}");
    }
}

#[test]
fn every_kind_says_where_it_acts_or_its_group_does() {
    let root = schema::schema_of::<Faults>();
    let groups = root["properties"].as_object().unwrap();
    for (group, schema) in groups {
        let text = |schema: &Value| {
            schema["description"]
                .as_str()
                .unwrap_or_default()
                .to_owned()
        };
        let of_group = text(schema) + &text(resolved(&root, schema));
        let kinds = resolved(&root, schema)["properties"].as_object().unwrap();
        let is_said = |text: &str| text.contains("bus.log");
        let all_say = kinds.values().all(|kind| is_said(&text(kind)));
        assert!(is_said(&of_group) || all_say, "{group}");
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let cases = [
        (
            "[[fault.sensor.stuk]]\nfrom_seconds = 1.0\n",
            "unknown key `stuk` in [fault.sensor]",
        ),
        (
            "[fault.sensor.stuck]\nfrom_seconds = 1.0\n",
            "`fault.sensor.stuck` must be an array of tables",
        ),
        (
            "[[fault.sensor.stuck]]\nfrom_seconds = 2.0\nuntil_seconds = 1.0\n",
            "[[fault.sensor.stuck]] ends before it begins",
        ),
        (
            "[[fault.node.restart]]\nat_seconds = 9.0\nnode = \"drive\"\n",
            "[[fault.node.restart]] starts after the end of the run",
        ),
        (
            "[[fault.node.hang]]\nfrom_seconds = 1.0\nnode = \"wheel\"\n",
            "`fault.node.hang.node` cannot be \"wheel\"",
        ),
        (
            "[[fault.bus.lose]]\nfrom_seconds = 1.0\nreceiver = \"drive\"\nprobability = 1.5\n",
            "`fault.bus.lose.probability` = 1.5 is out of range",
        ),
        (
            "[[fault.plant.ageing]]\nfrom_seconds = 1.0\n",
            "ageing needs an end, at which its factors are reached",
        ),
        (
            "[[fault.bus.babble]]\nfrom_seconds = 1.0\nidentifier = 0x6B0\n",
            "no foreign node may forge what the plant says of itself",
        ),
        (
            "[expect]\nsafe_state = true\n",
            "`safe_state` cannot be judged",
        ),
        (
            "[[fault.sensor.stuck]]\nfrom_seconds = 1.0\n[expect]\nemcy = [\"drive 8130\"]\n",
            "\"drive 8130\" names no emergency",
        ),
        (
            "[[fault.sensor.stuck]]\nfrom_seconds = 1.0\n[expect]\nemcy = 1\n",
            "`expect.emcy` must be an array of strings",
        ),
    ];
    for (tables, expected) in cases {
        assert_eq!(parse(tables).unwrap_err(), [expected]);
    }
}

#[test]
fn kinds_have_different_names() {
    let kinds = kinds();
    let names: BTreeSet<_> = kinds.iter().map(|(_, kind, _)| kind).collect();
    assert_eq!(names.len(), kinds.len());
}
