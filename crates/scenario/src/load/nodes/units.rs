//! The keys of an external drive end in its own unit; what reads them knows millimetres.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::document::Document;
use crate::error::Problem;
use crate::port::Unit;

/// The keys with a unit, each with its table.
const KEYS: [(&str, &str); 4] = [
    ("position", "units_per_millimetre"),
    ("position", "resolution_millimetres"),
    ("limits", "position_millimetres"),
    ("limits", "speed_millimetres_per_second"),
];

/// Gives the keys of all external drives the names that they have in millimetres; the first one in a wrong unit.
pub(super) fn rename(document: &mut Document<'_>) -> Option<Problem> {
    let source = document.source.clone();
    let mut wrong = None;
    document.rewrite(|root| {
        let nodes = root.get_mut("node").map(Spanned::get_mut);
        let Some(DeValue::Table(nodes)) = nodes else {
            return;
        };
        for (name, node) in nodes.iter_mut() {
            let DeValue::Table(node) = node.get_mut() else {
                continue;
            };
            let unit = unit_of(node);
            if let Err((span, right)) = rename_keys(node, &unit) {
                let message = format!("the drive `{}` is in {unit}", name.get_ref());
                wrong.get_or_insert(source.problem(span, message, format!("write `{right}`")));
            }
        }
    });
    wrong
}

/// The unit of a drive's positions.
fn unit_of(node: &DeTable<'_>) -> Unit {
    let sensor = node
        .get("sensor")
        .and_then(|sensor| sensor.get_ref().as_table());
    let unit = sensor.and_then(|sensor| sensor.get("unit"));
    let word = unit.and_then(|unit| unit.get_ref().as_str());
    word.map_or(Unit::Millimetres, Unit::of_word)
}

fn rename_keys(
    node: &mut DeTable<'_>,
    unit: &Unit,
) -> Result<(), (std::ops::Range<usize>, String)> {
    let others = [Unit::Millimetres, Unit::Degrees, Unit::Revolutions];
    for (table, key) in KEYS {
        let Some(DeValue::Table(table)) = node.get_mut(table).map(Spanned::get_mut) else {
            continue;
        };
        let right = unit.rename_rig_key(key);
        let is_wrong = |name: &str| {
            name != right && others.iter().any(|other| other.rename_rig_key(key) == name)
        };
        for (mut name, value) in std::mem::take(table) {
            if is_wrong(name.get_ref()) {
                return Err((name.span(), right));
            }
            if name.get_ref().as_ref() == right {
                *name.get_mut() = key.into();
            }
            table.insert(name, value);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::rig::nodes::Rig;
    use crate::without_colours;

    const RIG: &str = r#"
schema = 2
name = "turntable"
[node.controller]
kind = "controller"
node_id = 1
[node.table]
kind = "drive"
node_id = 0x20
external = true
sensor = { unit = "degrees", min = 0.0, max = 360.0 }
position = { units_per_degree = 100.0, resolution_degrees = 0.01 }
[node.table.limits]
current_amperes = 0.5
position_degrees = { min = -5.0, max = 365.0 }
speed_degrees_per_second = 90.0
[loop.table]
feedback = "table.position"
drives = ["table"]
"#;

    #[test]
    fn the_keys_of_an_external_drive_are_in_its_unit() {
        let rig = Rig::parse(RIG, "rig.toml").unwrap();
        let file = rig.rig_file_of("table").unwrap();
        assert_eq!(file.drive.position.units_per_millimetre, 100.0);
        assert_eq!(file.drive.position.resolution_millimetres, 0.01);
        assert_eq!(file.limits.position_millimetres.max, 365.0);
        assert_eq!(file.limits.speed_millimetres_per_second, 90.0);
    }

    #[test]
    fn a_key_in_another_unit_is_named_with_the_right_one() {
        for (right, wrong) in [
            ("units_per_degree", "units_per_millimetre"),
            ("speed_degrees_per_second", "speed_millimetres_per_second"),
            ("position_degrees", "position_revolutions"),
        ] {
            let text = RIG.replacen(right, wrong, 1);
            let error = Rig::parse(&text, "rig.toml").unwrap_err();
            let error = without_colours(&error);
            assert!(error.contains("the drive `table` is in degrees"), "{error}");
            assert!(error.contains(&format!("write `{right}`")), "{error}");
        }
    }
}
