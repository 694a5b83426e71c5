//! The `modelDescription.xml` of a model.

use std::collections::BTreeSet;

use super::{Model, ModelVariable, Role};
use crate::description::Version;
use crate::unit::{BASE_UNITS, unit_by_symbol};

pub(super) fn xml(model: &Model, version: Version) -> String {
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fmiModelDescription");
    for (name, value) in [
        ("fmiVersion", version.name()),
        ("modelName", &model.name),
        (version.token_attribute(), &model.token()),
        ("description", &model.description),
        ("version", &model.version),
        (
            "generationTool",
            concat!("canrig ", env!("CARGO_PKG_VERSION")),
        ),
        ("variableNamingConvention", "structured"),
    ] {
        xml += &attribute(name, value);
    }
    if version == Version::Two {
        xml += &attribute("numberOfEventIndicators", "0");
    }
    xml += ">\n  <CoSimulation";
    xml += &attribute("modelIdentifier", &model.name);
    xml += &attribute("canHandleVariableCommunicationStepSize", "true");
    xml += "/>\n";
    xml += &units(model);
    xml += "  <DefaultExperiment startTime=\"0\" stepSize=\"0.001\"/>\n  <ModelVariables>\n";
    xml += &variables(model, version);
    xml += "  </ModelVariables>\n  <ModelStructure>\n";
    xml += &structure(model, version);
    xml + "  </ModelStructure>\n</fmiModelDescription>\n"
}

fn attribute(name: &str, value: &str) -> String {
    let mut escaped = String::new();
    for character in value.chars() {
        match character {
            '<' => escaped += "&lt;",
            '&' => escaped += "&amp;",
            '"' => escaped += "&quot;",
            character if character.is_control() => escaped.push(' '),
            character => escaped.push(character),
        }
    }
    format!(" {name}=\"{escaped}\"")
}

fn units(model: &Model) -> String {
    let symbols = model.variables.iter().map(|variable| variable.unit);
    let symbols = BTreeSet::from_iter(symbols.chain(["s"]));
    let mut xml = String::from("  <UnitDefinitions>\n");
    for known in symbols
        .into_iter()
        .filter(|symbol| !symbol.is_empty())
        .filter_map(unit_by_symbol)
    {
        xml += &format!("    <Unit{}><BaseUnit", attribute("name", known.symbol));
        for (name, exponent) in BASE_UNITS.into_iter().zip(known.base.exponents) {
            if exponent != 0 {
                xml += &attribute(name, &exponent.to_string());
            }
        }
        for (name, value, none) in [
            ("factor", known.base.factor, 1.0),
            ("offset", known.base.offset, 0.0),
        ] {
            if value != none {
                xml += &attribute(name, &value.to_string());
            }
        }
        xml += "/></Unit>\n";
    }
    xml + "  </UnitDefinitions>\n"
}

/// Returns causality and variability.
fn kind(role: &Role) -> String {
    let [causality, variability] = match role {
        Role::Input(_) => ["input", "continuous"],
        Role::Number { .. } | Role::Word { .. } => ["parameter", "fixed"],
        Role::Output => ["output", "continuous"],
    };
    attribute("causality", causality) + &attribute("variability", variability)
}

/// Returns unit, limits and start value of a number.
fn value(variable: &ModelVariable) -> String {
    let mut xml = String::new();
    if !variable.unit.is_empty() {
        xml += &attribute("unit", variable.unit);
    }
    let (start, limits) = match &variable.role {
        Role::Input(start) => (Some(*start), [None, None]),
        Role::Number { start, min, max } => (Some(*start), [*min, *max]),
        Role::Word { .. } | Role::Output => (None, [None, None]),
    };
    for (name, value) in [("min", limits[0]), ("max", limits[1]), ("start", start)] {
        if let Some(value) = value {
            xml += &attribute(name, &value.to_string());
        }
    }
    xml
}

/// Returns the variables with their value references, which begin at 1; that of `time` is 0.
fn numbered(model: &Model) -> impl Iterator<Item = (usize, &ModelVariable)> {
    (1..).zip(&model.variables)
}

fn named(reference: usize, variable: &ModelVariable) -> String {
    attribute("name", &variable.name)
        + &attribute("valueReference", &reference.to_string())
        + &attribute("description", &variable.description)
        + &kind(&variable.role)
}

fn variables(model: &Model, version: Version) -> String {
    let number = |named: &str, value: &str| match version {
        Version::Two => format!("    <ScalarVariable{named}><Real{value}/></ScalarVariable>\n"),
        Version::Three => format!("    <Float64{named}{value}/>\n"),
    };
    let text = |named: &str, start: &str| match version {
        Version::Two => {
            let start = attribute("start", start);
            format!("    <ScalarVariable{named}><String{start}/></ScalarVariable>\n")
        }
        Version::Three => {
            let start = attribute("value", start);
            format!("    <String{named}><Start{start}/></String>\n")
        }
    };
    let time =
        " name=\"time\" valueReference=\"0\" causality=\"independent\" variability=\"continuous\"";
    let mut xml = number(time, " unit=\"s\"");
    for (reference, variable) in numbered(model) {
        let named = named(reference, variable);
        xml += &match &variable.role {
            Role::Word { start } => text(&named, start),
            _ => number(&named, &value(variable)),
        };
    }
    xml
}

/// Returns the list of outputs, which are computed at the start too.
fn structure(model: &Model, version: Version) -> String {
    let outputs = numbered(model).filter(|(_, variable)| variable.role == Role::Output);
    let outputs = Vec::from_iter(outputs.map(|(reference, _)| reference));
    let all = |element: &str, number: &dyn Fn(usize) -> String| {
        let lines = outputs
            .iter()
            .map(|reference| format!("    <{element}{}/>\n", number(*reference)));
        String::from_iter(lines)
    };
    match version {
        Version::Two => {
            // The index counts from 1, which is `time`.
            let index = |reference: usize| attribute("index", &(reference + 1).to_string());
            let unknowns = all("Unknown", &index);
            format!(
                "    <Outputs>\n{unknowns}    </Outputs>\n    <InitialUnknowns>\n{unknowns}    </InitialUnknowns>\n"
            )
        }
        Version::Three => {
            let reference = |reference: usize| attribute("valueReference", &reference.to_string());
            all("Output", &reference) + &all("InitialUnknown", &reference)
        }
    }
}
