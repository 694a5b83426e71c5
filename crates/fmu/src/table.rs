//! `[plant.NAME.fmu]` of a rig file: which FMU, its start values, and its variables as ports.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::description::{Causality, Description, Variable};
use crate::error::Fault;
use crate::instance::{Setup, StartValue};
use crate::unit::{Conversion, of_base, of_name, of_symbol};

/// A plant from a modelling tool, as an FMU of FMI 2.0 or 3.0 for co-simulation.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PlantTable {
    /// The FMU, from the folder of this file.
    pub file: String,
    /// Start values by the names of its variables, in the FMU's units; numbers, truths or texts.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, serde_json::Value>")]
    pub start: BTreeMap<String, toml::Value>,
    /// Its variables as ports, by names that end in a unit.
    pub ports: BTreeMap<String, PortTable>,
    /// The length of its steps, where it is to be another than what the drive's cycle makes, or the FMU takes no other.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub step_milliseconds: Option<f64>,
}

/// One variable as a port.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PortTable {
    /// The variable's name in the FMU.
    pub variable: String,
    /// The port is the variable times this, plus the offset. Without both, the units of variable and port say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factor: Option<f64>,
    /// Added to the variable times the factor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset: Option<f64>,
}

/// A port of an FMU.
#[derive(Clone, Debug, PartialEq)]
pub struct Port {
    /// Its name.
    pub name: String,
    /// Its unit, as the end of the name says; empty for none.
    pub unit: &'static str,
    /// The variable.
    pub variable: String,
    /// From the variable to the port.
    pub conversion: Conversion,
    /// Lowest and highest value at the port, where the FMU says them.
    pub range: [Option<f64>; 2],
}

/// A table that fits an FMU: what the worker needs, and what the ports are.
#[derive(Clone, Debug, PartialEq)]
pub struct Wiring {
    /// For the worker.
    pub setup: Setup,
    /// Ports that are set, in the order of the setup's inputs.
    pub inputs: Vec<Port>,
    /// Ports that are read, in the order of the setup's outputs.
    pub outputs: Vec<Port>,
}

impl PlantTable {
    /// What the table makes of the FMU; `name` is that of the plant. Nothing is loaded.
    ///
    /// # Errors
    /// A variable is missing, cannot be what the table makes of it, or is in a unit that the port's name contradicts.
    pub fn wiring(&self, name: &str, description: &Description) -> Result<Wiring, Fault> {
        let start = self.start.iter().map(|(variable, value)| {
            let value = match value {
                toml::Value::Float(number) => StartValue::Number(*number),
                #[expect(clippy::cast_precision_loss, reason = "a table's number")]
                toml::Value::Integer(number) => StartValue::Number(*number as f64),
                toml::Value::Boolean(truth) => StartValue::Truth(*truth),
                toml::Value::String(text) => StartValue::Text(text.clone()),
                _ => {
                    let reason = "cannot start with that: write a number, a truth or a text";
                    return Err(Fault::variable(variable, reason));
                }
            };
            Ok((variable.clone(), value))
        });
        let mut wiring = Wiring {
            setup: Setup {
                name: name.to_owned(),
                start: start.collect::<Result<_, Fault>>()?,
                step_seconds: self.step_milliseconds.map(|step| step / 1e3),
                ..Setup::default()
            },
            inputs: Vec::new(),
            outputs: Vec::new(),
        };
        for (name, port) in &self.ports {
            let variable = description.variable(&port.variable)?;
            let is_input = variable.is_input();
            let port = port_of(name, port, variable, description)?;
            let (names, ports) = match is_input {
                true => (&mut wiring.setup.inputs, &mut wiring.inputs),
                false => (&mut wiring.setup.outputs, &mut wiring.outputs),
            };
            names.push(variable.name.clone());
            ports.push(port);
        }
        wiring.setup.check(description)?;
        Ok(wiring)
    }

    /// A table for an FMU, to be edited: its inputs and outputs as ports, its parameters as start values, with comments.
    #[must_use]
    pub fn proposed(name: &str, file: &str, description: &Description) -> String {
        let mut text = format!("[plant.{name}.fmu]\nfile = {}\n", quoted(file));
        let of = |wanted: fn(&Variable) -> bool| {
            (description.variables.iter()).filter(move |variable| wanted(variable))
        };
        let parameters = of(|variable| {
            variable.causality == Causality::Parameter
                && variable.takes_start()
                && variable.start.is_some()
        });
        let mut parameters = parameters.peekable();
        if parameters.peek().is_some() {
            text += &format!("\n[plant.{name}.fmu.start]\n");
        }
        for variable in parameters {
            let start = variable.start.as_deref().unwrap_or_default();
            text += &format!("{} = {}", key(&variable.name), start_text(variable, start));
            text += &comment(variable);
        }
        text += &format!("\n[plant.{name}.fmu.ports]\n");
        let ports = of(|variable| {
            let is_end = matches!(variable.causality, Causality::Input | Causality::Output);
            is_end && variable.is_port_shaped()
        });
        let mut taken = Vec::new();
        for variable in ports {
            let port = unique(&mut taken, variable, description);
            text += &format!("{port} = {{ variable = {} }}", quoted(&variable.name));
            text += &comment(variable);
        }
        text
    }
}

fn port_of(
    name: &str,
    port: &PortTable,
    variable: &Variable,
    description: &Description,
) -> Result<Port, Fault> {
    let known = of_name(name);
    let conversion = match (port.factor, port.offset) {
        (None, None) => conversion_of(name, variable, description)?,
        (factor, offset) => Conversion {
            factor: factor.unwrap_or(1.0),
            offset: offset.unwrap_or(0.0),
        },
    };
    let is_sane = conversion.factor.is_finite() && conversion.factor != 0.0;
    if !is_sane || !conversion.offset.is_finite() {
        let reason = format!("cannot be the port `{name}` with this factor and offset");
        return Err(Fault::variable(&variable.name, reason));
    }
    let mut range =
        [variable.min, variable.max].map(|limit| limit.map(|value| conversion.of(value)));
    if conversion.factor < 0.0 {
        range.swap(0, 1);
    }
    Ok(Port {
        name: name.to_owned(),
        unit: known.map_or("", |known| known.symbol),
        variable: variable.name.clone(),
        conversion,
        range,
    })
}

/// By the units; a variable without one is in the port's.
fn conversion_of(
    name: &str,
    variable: &Variable,
    description: &Description,
) -> Result<Conversion, Fault> {
    let (Some(known), Some(unit)) = (of_name(name), &variable.unit) else {
        return Ok(Conversion::NONE);
    };
    let base = description.base_of(variable);
    let conversion = base.and_then(|base| base.to(&known.base));
    conversion.ok_or_else(|| {
        let words = known.words;
        Fault::variable(
            &variable.name,
            format!(
                "is in {unit}, and the port `{name}` would be in {words}; let the name end in its unit, or write factor and offset"
            ),
        )
    })
}

/// A TOML text.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A TOML key.
fn key(text: &str) -> String {
    let is_bare = |byte: u8| byte.is_ascii_alphanumeric() || b"_-".contains(&byte);
    match !text.is_empty() && text.bytes().all(is_bare) {
        true => text.to_owned(),
        false => quoted(text),
    }
}

/// A start value as TOML has it.
fn start_text(variable: &Variable, start: &str) -> String {
    use crate::description::Kind;
    match variable.kind {
        Kind::String => quoted(start),
        Kind::Boolean => matches!(start.trim(), "true" | "1").to_string(),
        kind => match start.trim().parse::<f64>() {
            Ok(number) if number.is_finite() && kind.is_float() => {
                toml::Value::Float(number).to_string()
            }
            Ok(number) if number.is_finite() => format!("{number}"),
            _ => "0.0".to_owned(),
        },
    }
}

/// Unit and description at the end of a line.
fn comment(variable: &Variable) -> String {
    let unit = variable.unit.as_deref().unwrap_or("no unit");
    let words = Vec::from_iter(variable.description.split_whitespace()).join(" ");
    let text = format!("{unit}: {words}");
    let text = text.trim_end_matches(": ");
    let clean = String::from_iter(text.chars().filter(|character| !character.is_control()));
    format!("  # {clean}\n")
}

/// A name for a port: the variable's, in small letters, with its unit in words.
fn unique(taken: &mut Vec<String>, variable: &Variable, description: &Description) -> String {
    let unit = variable.unit.as_deref();
    let by_symbol = unit.and_then(of_symbol);
    let base = || description.base_of(variable);
    let known = by_symbol.or_else(|| base().as_ref().and_then(of_base));
    let words = known
        .map(|known| known.words)
        .filter(|words| *words != "factor");
    let mut stem = snake(&variable.name);
    if let Some(words) = words {
        let without = stem.strip_suffix(words).map(str::to_owned);
        stem = without.unwrap_or(stem);
    }
    let stem = stem.trim_end_matches('_');
    let name = |number: usize| {
        let number = if number > 1 {
            number.to_string()
        } else {
            String::new()
        };
        let parts = [stem, &number, words.unwrap_or_default()];
        let parts = parts.into_iter().filter(|part| !part.is_empty());
        Vec::from_iter(parts).join("_")
    };
    let free = (1..).map(name).find(|name| !taken.contains(name));
    let free = free.unwrap_or_default();
    taken.push(free.clone());
    free
}

fn snake(name: &str) -> String {
    let mut snake = String::new();
    let mut was_small = false;
    for character in name.chars() {
        let is_word = character.is_ascii_alphanumeric();
        let begins_word = !is_word || (character.is_ascii_uppercase() && was_small);
        if begins_word && !snake.is_empty() && !snake.ends_with('_') {
            snake.push('_');
        }
        if is_word {
            snake.push(character.to_ascii_lowercase());
        }
        was_small = character.is_ascii_lowercase() || character.is_ascii_digit();
    }
    match snake.starts_with(|first: char| first.is_ascii_lowercase()) {
        true => snake,
        false => format!("port_{snake}"),
    }
}

#[cfg(test)]
mod tests;
