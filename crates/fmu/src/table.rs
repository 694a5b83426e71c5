//! `[plant.NAME.fmu]` of a rig file: fits its table to an FMU.

use dbc::{Port, Ports, symbol_of};
use scenario::plant::{Fmu, FmuPort};
use toml::Value;

use crate::description::{Causality, CoSimulation, Description, Kind, Variable};
use crate::error::Fault;
use crate::instance::{Configuration, PortVariable, StartValue};
use crate::unit::{Conversion, Known, unit_by_base, unit_by_symbol, unit_in_name};

/// A table that fits an FMU: the configuration of the worker, and the ports.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wiring {
    /// Configuration of the worker.
    pub configuration: Configuration,
    /// Ports of the plant or the law, in the order of the configuration's inputs and outputs. The range of a port is infinite if
    /// neither the table nor the FMU has a limit.
    pub ports: Ports,
}

/// Error of a table that does not fit an FMU.
#[derive(Debug)]
pub struct Misfit {
    /// Key in the table, as in `ports.position_metres.variable`.
    pub place: String,
    /// The error.
    pub fault: Fault,
}

impl Misfit {
    fn at(place: impl Into<String>) -> impl FnOnce(Fault) -> Self {
        let place = place.into();
        |fault| Self { place, fault }
    }
}

/// Fits a table to an FMU; `name` is that of the plant. The FMU is not loaded.
///
/// # Errors
/// A variable is missing, is unsuitable for its use in the table, or has a unit that the port's name contradicts.
pub fn wiring(table: &Fmu, name: &str, description: &Description) -> Result<Wiring, Misfit> {
    let co_simulation = description.served().map_err(Misfit::at("file"))?;
    let start = table.start.iter().map(|(name, value)| {
        let variable = description.variable(name);
        let start = variable.and_then(|variable| start_value(variable, value));
        let start = start.map_err(Misfit::at(format!("start.{name}")))?;
        Ok((name.clone(), start))
    });
    let mut wiring = Wiring::default();
    wiring.configuration.name = name.to_owned();
    wiring.configuration.start = start.collect::<Result<_, Misfit>>()?;
    for (name, port) in &table.ports {
        let place = format!("ports.{name}");
        let at_variable = || Misfit::at(format!("{place}.variable"));
        let variable = description
            .variable(&port.variable)
            .map_err(at_variable())?;
        check_port(variable).map_err(at_variable())?;
        let mut inputs = wiring.configuration.inputs.iter();
        if inputs.any(|other| other.variable.name == variable.name) {
            let reason = "is two ports already, and can be set by one";
            return Err(at_variable()(Fault::variable(&variable.name, reason)));
        }
        let (mut port, behind) =
            wired(name, port, variable, description).map_err(Misfit::at(place.as_str()))?;
        if variable.is_input() {
            let mut start = wiring.configuration.start.iter();
            let given = start.find(|(name, _)| *name == variable.name);
            if let Some((_, StartValue::Number(number))) = given {
                port.at_rest = behind.conversion.of(*number);
            }
            wiring.ports.inputs.push(port);
            wiring.configuration.inputs.push(behind);
        } else {
            wiring.ports.outputs.push(port);
            wiring.configuration.outputs.push(behind);
        }
    }
    record(table, description, &mut wiring)?;
    let (wanted, step_key) = match table.step_milliseconds {
        Some(step) => (Some(step / 1e3), "step_milliseconds"),
        None => (None, "file"),
    };
    let step_seconds = fixed_step(wanted, co_simulation, description);
    wiring.configuration.step_seconds = step_seconds.map_err(Misfit::at(step_key))?;
    Ok(wiring)
}

/// Checks whether a port can carry a variable.
fn check_port(variable: &Variable) -> Result<(), Fault> {
    let reason = if variable.is_array {
        "is an array, which cannot be a port"
    } else if !variable.kind.is_number() {
        "is not a number, so it cannot be a port"
    } else {
        return Ok(());
    };
    Err(Fault::variable(&variable.name, reason))
}

/// Returns the start value of a variable that accepts it.
fn start_value(variable: &Variable, value: &Value) -> Result<StartValue, Fault> {
    let fault = |reason: String| Err(Fault::variable(&variable.name, reason));
    let kind = variable.kind;
    let is_quantity = kind.is_number() && kind != Kind::Boolean;
    if matches!(
        value,
        Value::Array(_) | Value::Table(_) | Value::Datetime(_)
    ) {
        return fault("cannot start with that: write a number, a truth or a text".to_owned());
    }
    if !variable.takes_start() {
        let is = variable.causality.name();
        return fault(format!("is {is}, which takes no start value"));
    }
    let number = match value {
        Value::String(text) if kind == Kind::String && text.contains('\0') => {
            return fault("cannot be a text with a NUL in it".to_owned());
        }
        Value::String(text) if kind == Kind::String => return Ok(StartValue::Text(text.clone())),
        Value::Boolean(truth) if kind == Kind::Boolean => f64::from(u8::from(*truth)),
        Value::Float(number) if is_quantity => *number,
        Value::Integer(number) if is_quantity => *number as f64,
        _ => {
            let wanted = match kind {
                Kind::String => "a text",
                Kind::Boolean => "true or false",
                _ => "a number",
            };
            return fault(format!("takes {wanted} as its start value"));
        }
    };
    let lowest = variable.min.unwrap_or(f64::NEG_INFINITY);
    let highest = variable.max.unwrap_or(f64::INFINITY);
    if !number.is_finite() || number < lowest || number > highest {
        return fault(format!(
            "cannot start with {number}, it must be from {lowest} to {highest}"
        ));
    }
    if let Some([lowest, highest]) = variable.kind.whole_range()
        && (number.fract() != 0.0 || number < lowest || number > highest)
    {
        return fault(format!(
            "cannot start with {number}, it must be a whole number from {lowest} to {highest}"
        ));
    }
    Ok(StartValue::Number(number))
}

/// Returns the only length of a step, if the FMU or the configuration has one.
fn fixed_step(
    wanted: Option<f64>,
    co_simulation: &CoSimulation,
    description: &Description,
) -> Result<Option<f64>, Fault> {
    match wanted {
        Some(step) if step > 0.0 && step.is_finite() => return Ok(wanted),
        Some(step) => {
            let reason = format!("its step is {step} s, it must be above 0");
            return Err(Fault::Invalid(reason));
        }
        None if co_simulation.takes_any_step => return Ok(None),
        None => {}
    }
    let said = co_simulation
        .fixed_step_seconds
        .or(description.step_seconds);
    let reason =
        "it takes steps of one length only and does not say which; write step_milliseconds";
    said.map(Some)
        .ok_or_else(|| Fault::Invalid(reason.to_owned()))
}

/// Makes ports of the additional recorded variables.
fn record(table: &Fmu, description: &Description, wiring: &mut Wiring) -> Result<(), Misfit> {
    let mut taken = Vec::from_iter(table.ports.keys().cloned());
    for (place, name) in table.record.iter().enumerate() {
        let at_place = || Misfit::at(format!("record.{place}"));
        let variable = description.variable(name).map_err(at_place())?;
        let refused = |reason: &str| Err(at_place()(Fault::variable(name, reason)));
        if !variable.is_port_shaped() {
            return refused("is not a single number, so it cannot be recorded");
        }
        let name = unique(&mut taken, variable, description);
        let port = FmuPort {
            variable: variable.name.clone(),
            ..FmuPort::default()
        };
        let (port, behind) = wired(&name, &port, variable, description).map_err(at_place())?;
        if !port.range.iter().all(|limit| limit.is_finite()) {
            return refused(
                "has no lowest and highest value in the FMU, which its frame needs; make it one of the ports, with a range",
            );
        }
        wiring.ports.outputs.push(port);
        wiring.configuration.outputs.push(behind);
    }
    Ok(())
}

/// Returns a table for an FMU, to be edited: its inputs and outputs as ports, its parameters as start values, with
/// comments.
pub fn proposed(name: &str, file: &str, description: &Description) -> String {
    let mut text = format!("[plant.{name}.fmu]\nfile = {}\n", quoted(file));
    let of = |wanted: fn(&Variable) -> bool| {
        description
            .variables
            .iter()
            .filter(move |variable| wanted(variable))
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

/// Wires a port of a table to its variable. The port has the FMU's description, and the unit from which values are converted.
fn wired(
    name: &str,
    port: &FmuPort,
    variable: &Variable,
    description: &Description,
) -> Result<(Port, PortVariable), Fault> {
    let conversion = match (port.factor, port.offset) {
        (None, None) => unit_conversion(name, variable, description)?,
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
    let start = variable.start.as_deref().map(str::trim);
    let start = match start {
        Some("true") => 1.0,
        start => start.and_then(|start| start.parse().ok()).unwrap_or(0.0),
    };
    let range = port_range(name, port, variable, conversion)?;
    let words = Vec::from_iter(variable.description.split_whitespace());
    let mut port = Port::output(name, range)
        .resting_at(conversion.of(start))
        .with_comment(&words.join(" "));
    if let Some(Known { word, symbol, .. }) = unit_in_name(name)
        && port.unit != *word
        && *word != "factor"
    {
        let known = symbol_of(word);
        port = port.with_unit(word, if known == *word { symbol } else { known });
    }
    // The port has the description. It would fill the message to the worker.
    let behind = PortVariable {
        variable: Variable {
            description: String::new(),
            ..variable.clone()
        },
        conversion,
    };
    Ok((port, behind))
}

/// Returns the range from the table, else from the FMU.
fn port_range(
    name: &str,
    port: &FmuPort,
    variable: &Variable,
    conversion: Conversion,
) -> Result<[f64; 2], Fault> {
    if let Some(range) = &port.range {
        return match range[..] {
            [lowest, highest] if lowest < highest && (highest - lowest).is_finite() => {
                Ok([lowest, highest])
            }
            _ => {
                let reason = format!(
                    "cannot be the port `{name}` with this range: write the lowest value, then a higher one"
                );
                Err(Fault::variable(&variable.name, reason))
            }
        };
    }
    let [lowest, highest] = match variable.kind {
        Kind::Boolean => [0.0, 1.0],
        _ => [f64::NEG_INFINITY, f64::INFINITY],
    };
    let range = [
        variable.min.unwrap_or(lowest),
        variable.max.unwrap_or(highest),
    ];
    let [lowest, highest] = range.map(|value| conversion.of(value));
    if conversion.factor < 0.0 {
        Ok([highest, lowest])
    } else {
        Ok([lowest, highest])
    }
}

/// Returns the conversion by the units. A variable without a unit has that of the port.
fn unit_conversion(
    name: &str,
    variable: &Variable,
    description: &Description,
) -> Result<Conversion, Fault> {
    let (Some(known), Some(unit)) = (unit_in_name(name), &variable.unit) else {
        return Ok(Conversion::NONE);
    };
    let base = description.base_unit(variable);
    let conversion = base.and_then(|base| base.to(&known.base));
    conversion.ok_or_else(|| {
        let word = known.word;
        Fault::variable(
            &variable.name,
            format!(
                "is in {unit}, and the port `{name}` would be in {word}; let the name end in its unit, or write factor and offset"
            ),
        )
    })
}

/// Returns a text as a string of TOML.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// Returns a text as a key of TOML.
fn key(text: &str) -> String {
    let is_bare = |byte: u8| byte.is_ascii_alphanumeric() || b"_-".contains(&byte);
    if !text.is_empty() && text.bytes().all(is_bare) {
        text.to_owned()
    } else {
        quoted(text)
    }
}

/// Returns a start value as TOML.
fn start_text(variable: &Variable, start: &str) -> String {
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

/// Returns unit and description, as a comment at the end of a line.
fn comment(variable: &Variable) -> String {
    let unit = variable.unit.as_deref().unwrap_or("no unit");
    let description = Vec::from_iter(variable.description.split_whitespace()).join(" ");
    let text = format!("{unit}: {description}");
    let shown = text.trim_end_matches(": ").chars();
    let clean = String::from_iter(shown.filter(|character| !character.is_control()));
    format!("  # {clean}\n")
}

/// Returns a new name for a port: the variable's, in small letters, with its unit written out.
fn unique(taken: &mut Vec<String>, variable: &Variable, description: &Description) -> String {
    let unit = variable.unit.as_deref();
    let by_symbol = unit.and_then(unit_by_symbol);
    let base = || description.base_unit(variable);
    let known = by_symbol.or_else(|| base().as_ref().and_then(unit_by_base));
    let word = known
        .map(|known| known.word)
        .filter(|word| *word != "factor");
    let mut stem = snake(&variable.name);
    if let Some(word) = word {
        let without = stem.strip_suffix(word).map(str::to_owned);
        stem = without.unwrap_or(stem);
    }
    let stem = stem.trim_end_matches('_');
    let name = |number: usize| {
        let number = if number > 1 {
            number.to_string()
        } else {
            String::new()
        };
        let parts = [stem, &number, word.unwrap_or_default()]
            .into_iter()
            .filter(|part| !part.is_empty());
        Vec::from_iter(parts).join("_")
    };
    let free = (1..)
        .map(name)
        .find(|name| !taken.contains(name))
        .unwrap_or_default();
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
    if snake.starts_with(|first: char| first.is_ascii_lowercase()) {
        snake
    } else {
        format!("port_{snake}")
    }
}

#[cfg(test)]
mod tests;
