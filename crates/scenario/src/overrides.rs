//! Values that replace those of a scenario file, by their keys.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;
use toml::{Table, Value};

use crate::load::{ALL, CONTROLLER};
use dbc::is_same_gain;

/// Largest number of parts in a key. Longer keys lead nowhere, and many thousand parts are deeper than the stack.
const KEY_PARTS_MAX: usize = 100;

/// A key and its value: `controller.pid.integral_time_seconds=0.2`, `reference.step[0].position_millimetres=20`.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    key: String,
    value: Value,
}

/// Writes it as on a command line.
impl fmt::Display for Override {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}={}", self.key, self.value)
    }
}

/// Reason why a value cannot replace another one.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct OverrideError(String);

fn no_key() -> OverrideError {
    OverrideError(
        "KEY=VALUE is expected, such as reference.step[0].position_millimetres=20".to_owned(),
    )
}

fn nowhere(key: &str) -> OverrideError {
    OverrideError(format!(
        "`{key}` leads nowhere: a key is the dotted path of a value, and reference.step[0] the first element of a list that the scenario has"
    ))
}

fn how_many(count: usize) -> String {
    match count {
        0 => "none".to_owned(),
        1 => "1, number 0".to_owned(),
        _ => format!("{count}, numbers 0 to {}", count - 1),
    }
}

/// Reads the value as TOML; any other text is a string, so that no string needs quotes twice.
impl FromStr for Override {
    type Err = OverrideError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (key, value) = text.split_once('=').ok_or_else(no_key)?;
        let (key, value) = (key.trim(), value.trim());
        if key.is_empty() {
            return Err(no_key());
        }
        Ok(Self {
            key: key.to_owned(),
            value: value.parse().unwrap_or_else(|_| Value::from(value)),
        })
    }
}

/// Returns the text of a scenario with other values. Without any the text stays as it is. A text that is not TOML stays so, too:
/// its loader describes the problem better.
///
/// # Errors
/// A key leads nowhere.
pub fn overridden(text: String, overrides: &[Override]) -> Result<String, OverrideError> {
    if overrides.is_empty() {
        return Ok(text);
    }
    let Ok(mut document) = text.parse::<Table>() else {
        return Ok(text);
    };
    for Override { key, value } in overrides {
        set(&mut document, key, value.clone())?;
    }
    Ok(document.to_string())
}

/// Sets a value by its key. Missing tables are made; elements of lists must exist.
///
/// # Errors
/// A part of the key is no table, or no element of a list.
pub fn set(table: &mut Table, key: &str, value: Value) -> Result<(), OverrideError> {
    if key.split('.').count() > KEY_PARTS_MAX {
        return Err(nowhere(key));
    }
    if let [CONTROLLER, name, law, ..] = Vec::from_iter(key.split('.'))[..]
        && let Some(Value::Table(laws)) = table.get_mut(CONTROLLER)
        && let Some(all) = laws.get(ALL).filter(|all| all.get(law).is_some())
        && !laws.contains_key(name)
    {
        // The law of one loop begins as that of all loops.
        laws.insert(name.to_owned(), all.clone());
    }
    let mut parts = key.split('.');
    let last = parts.next_back().unwrap_or_default();
    let above = parts.try_fold(table, |table, part| {
        place(table, part, key)?
            .as_table_mut()
            .ok_or_else(|| nowhere(key))
    })?;
    // A gain may be by another unit than that of the file.
    if !above.contains_key(last) {
        above.retain(|other, _| !is_same_gain(last, other));
    }
    *place(above, last, key)? = value;
    Ok(())
}

/// Returns the value at a part of a key, such as `step[0]`.
fn place<'a>(table: &'a mut Table, part: &str, key: &str) -> Result<&'a mut Value, OverrideError> {
    let Some((name, index)) = part.split_once('[') else {
        let below = table.entry(part);
        return Ok(below.or_insert_with(|| Value::Table(Table::new())));
    };
    let list = table.get_mut(name).and_then(Value::as_array_mut);
    let index = index.strip_suffix(']').map(str::parse::<usize>);
    let (Some(list), Some(Ok(index))) = (list, index) else {
        return Err(nowhere(key));
    };
    let count = list.len();
    list.get_mut(index).ok_or_else(|| {
        let count = how_many(count);
        OverrideError(format!(
            "`{key}`: there is no {name} {index}; the scenario has {count}"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# a comment\nname = \"a\"\n[[step]]\nat = 1.0\n[plant.x]\n";

    fn with(overrides: &[&str]) -> Result<Table, OverrideError> {
        let overrides: Result<Vec<Override>, _> =
            overrides.iter().map(|text| text.parse()).collect();
        Ok(overridden(TEXT.to_owned(), &overrides?)?.parse().unwrap())
    }

    #[test]
    fn values_take_their_places() {
        let table = with(&["step[0].at=2", "name = b = c", "plant.x.y.z=[1, 2.5]"]).unwrap();
        assert_eq!(table["step"][0]["at"], Value::Integer(2));
        assert_eq!(table["name"], Value::from("b = c"));
        assert_eq!(table["plant"]["x"]["y"]["z"][1], Value::Float(2.5));
        let gains = with(&[
            "pid={gain_amperes_per_metre=1.0, other=2.0}",
            "pid.gain_amperes_per_degree=3.0",
        ]);
        let gains = gains.unwrap()["pid"].to_string();
        assert_eq!(gains, "{ gain_amperes_per_degree = 3.0, other = 2.0 }");
        let laws = with(&[
            "controller={all = {pid = {k = 1.0, t = 2.0}}}",
            "controller.x.pid.k=3.0",
            "controller.y.open.k=3.0",
        ]);
        let laws = laws.unwrap()["controller"].to_string();
        let each = [
            "all = { pid = { k = 1.0, t = 2.0 } }",
            "x = { pid = { k = 3.0, t = 2.0 } }",
            "y = { open = { k = 3.0 } }",
        ];
        assert_eq!(laws, format!("{{ {} }}", each.join(", ")));
        let quoted = with(&["name=\"3\"", "step[0]={at = 4.0}"]).unwrap();
        assert_eq!(quoted["name"], Value::from("3"));
        assert_eq!(quoted["step"][0]["at"], Value::Float(4.0));
        assert_eq!(
            with(&["name=1\n[x]"]).unwrap()["name"],
            Value::from("1\n[x]")
        );
    }

    #[test]
    fn what_leads_nowhere_is_refused() {
        let short = with(&["step[1].at=1"]).unwrap_err();
        let text = "`step[1].at`: there is no step 1; the scenario has 1, number 0";
        assert_eq!(short.to_string(), text);
        for key in ["step[x].at", "step.at", "name.at", "steps[0].at"] {
            let error = with(&[&format!("{key}=1")]).unwrap_err();
            assert_eq!(error, nowhere(key));
        }
        let deep = format!("{}x=1", "a.".repeat(8000));
        let error = with(&[&deep]).unwrap_err();
        assert_eq!(error, nowhere(deep.trim_end_matches("=1")));
        for text in ["name", "=1"] {
            assert_eq!(with(&[text]).unwrap_err(), no_key());
        }
    }

    #[test]
    fn a_text_without_overrides_stays_as_it_is() {
        assert_eq!(overridden(TEXT.to_owned(), &[]).unwrap(), TEXT);
        let broken = "name = ".to_owned();
        let one = ["name=b".parse().unwrap()];
        assert_eq!(overridden(broken.clone(), &one).unwrap(), broken);
    }
}
