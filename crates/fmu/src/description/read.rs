//! Conversion from XML to a description, by the schemas of FMI 2.0 and 3.0.

use std::collections::{BTreeMap, BTreeSet};

use roxmltree::Document;

use super::attributes::Attributes;
use super::variable::keyword;
use super::{Causality, CoSimulation, Description, Initial, Kind, Variability, Variable, Version};
use crate::error::Fault;
use crate::unit::{BASE_UNITS, Base};

/// Elements of the declared types, with unit and limits for the variables that refer to them.
type Types<'a, 'input> = BTreeMap<&'a str, Attributes<'a, 'input>>;

pub(super) fn description(document: &Document<'_>) -> Result<Description, Fault> {
    let root = Attributes(document.root_element());
    if root.0.tag_name().name() != "fmiModelDescription" {
        return Err(root.fault("the document is no <fmiModelDescription>"));
    }
    let version = version(&root)?;
    let token = root.required(version.token_attribute())?;
    let experiment = root.child("DefaultExperiment");
    let experiment_number =
        |name| experiment.map_or(Ok(None), |experiment| experiment.number(name));
    let others = [
        ("ModelExchange", "model exchange"),
        ("ScheduledExecution", "scheduled execution"),
    ]
    .into_iter();
    let types = types(&root, version)?;
    Ok(Description {
        version,
        model_name: root.name("modelName")?,
        description: root.owned("description"),
        tool: root.owned("generationTool"),
        model_version: root.owned("version"),
        token: token.to_owned(),
        co_simulation: root.child("CoSimulation").map(co_simulation).transpose()?,
        other_interfaces: others
            .filter(|(element, _)| root.child(element).is_some())
            .map(|(_, name)| name)
            .collect(),
        step_seconds: experiment_number("stepSize")?.filter(|step| *step > 0.0),
        tolerance: experiment_number("tolerance")?.filter(|tolerance| *tolerance > 0.0),
        units: units(&root)?,
        variables: variables(&root, version, &types)?,
    })
}

fn version(root: &Attributes<'_, '_>) -> Result<Version, Fault> {
    let text = root.required("fmiVersion")?;
    match text.split('.').next() {
        Some("2") => Ok(Version::Two),
        Some("3") => Ok(Version::Three),
        _ => Err(root.fault(format!(
            "it is of FMI {text}; 2.0 and 3.0 are served, so export it for one of these"
        ))),
    }
}

fn co_simulation(element: Attributes<'_, '_>) -> Result<CoSimulation, Fault> {
    let model_identifier = element.required("modelIdentifier")?;
    // The name becomes the name of a file.
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
    if !model_identifier.bytes().all(is_name) {
        return Err(element.fault(format!(
            "the modelIdentifier `{model_identifier}` is not a name in C"
        )));
    }
    let fixed_step = element.number("fixedInternalStepSize")?;
    Ok(CoSimulation {
        model_identifier: model_identifier.to_owned(),
        takes_any_step: element.is_true("canHandleVariableCommunicationStepSize")?,
        fixed_step_seconds: fixed_step.filter(|step| *step > 0.0),
        has_event_mode: element.is_true("hasEventMode")?,
        needs_execution_tool: element.is_true("needsExecutionTool")?,
    })
}

fn units(root: &Attributes<'_, '_>) -> Result<BTreeMap<String, Option<Base>>, Fault> {
    let Some(definitions) = root.child("UnitDefinitions") else {
        return Ok(BTreeMap::new());
    };
    let unit = |unit: Attributes<'_, '_>| {
        let name = unit.required("name")?.to_owned();
        Ok((name, unit.child("BaseUnit").map(base).transpose()?))
    };
    definitions.children("Unit").map(unit).collect()
}

fn base(element: Attributes<'_, '_>) -> Result<Base, Fault> {
    let mut exponents = [0; 8];
    for (exponent, name) in exponents.iter_mut().zip(BASE_UNITS) {
        if let Some(text) = element.text(name) {
            *exponent = text
                .trim()
                .parse()
                .map_err(|_| element.fault(format!("the exponent `{name}` is `{text}`")))?;
        }
    }
    let factor = element.number("factor")?.unwrap_or(1.0);
    if factor == 0.0 {
        return Err(element.fault("the factor of a unit is 0"));
    }
    Ok(Base {
        exponents,
        factor,
        offset: element.number("offset")?.unwrap_or(0.0),
    })
}

fn types<'a, 'input>(
    root: &Attributes<'a, 'input>,
    version: Version,
) -> Result<Types<'a, 'input>, Fault> {
    let mut types = Types::new();
    for declaration in root
        .child("TypeDefinitions")
        .iter()
        .flat_map(Attributes::elements)
    {
        let name = declaration.required("name")?;
        let value = match version {
            Version::Two => declaration.elements().next(),
            Version::Three => Some(declaration),
        };
        types.extend(value.map(|value| (name, value)));
    }
    Ok(types)
}

fn variables(
    root: &Attributes<'_, '_>,
    version: Version,
    types: &Types<'_, '_>,
) -> Result<Vec<Variable>, Fault> {
    let Some(all) = root.child("ModelVariables") else {
        return Ok(Vec::new());
    };
    let mut variables = Vec::new();
    let mut names = BTreeSet::new();
    for element in all.elements() {
        let name = element.name("name")?;
        if !names.insert(name.clone()) {
            return Err(element.fault(format!("there are two variables `{name}`")));
        }
        let value = match version {
            Version::Two => element
                .elements()
                .find(|value| Kind::of_fmi_2(value.0.tag_name().name()).is_some())
                .ok_or_else(|| element.fault("a variable has no type"))?,
            Version::Three => element,
        };
        variables.push(variable(name, &element, &value, version, types)?);
    }
    Ok(variables)
}

/// Reads a variable. In FMI 3.0 `element` and `value` are the same element.
fn variable(
    name: String,
    element: &Attributes<'_, '_>,
    value: &Attributes<'_, '_>,
    version: Version,
    types: &Types<'_, '_>,
) -> Result<Variable, Fault> {
    let tag = value.0.tag_name().name();
    let kind = match version {
        Version::Two => Kind::of_fmi_2(tag),
        Version::Three => keyword(tag),
    };
    let kind =
        kind.ok_or_else(|| element.fault(format!("<{tag}> is not a variable of FMI 3.0")))?;
    let reference = element.required("valueReference")?.trim();
    let reference = reference.parse().map_err(|_| {
        element.fault(format!(
            "`{name}` has the valueReference `{reference}`, no number of 32 bits"
        ))
    })?;
    let causality = element.word("causality")?.unwrap_or(Causality::Local);
    let variability = element
        .word("variability")?
        .unwrap_or_else(|| default_variability(causality, kind, version));
    let initial = element.word("initial")?;
    let declared = value.text("declaredType").and_then(|name| types.get(name));
    let limit = |name: &str| match (value.number(name)?, declared) {
        (None, Some(declared)) => declared.number(name),
        (number, _) => Ok(number),
    };
    let start = value.text("start");
    // Texts of FMI 3.0 are in separate elements.
    let start = start.or_else(|| value.child("Start").and_then(|start| start.text("value")));
    let units = [Some(value), declared].into_iter().flatten();
    let mut units = units.filter_map(|value| value.text("unit").filter(|unit| !unit.is_empty()));
    Ok(Variable {
        name,
        reference,
        description: element.owned("description"),
        kind,
        is_array: version == Version::Three && element.child("Dimension").is_some(),
        causality,
        variability,
        initial: initial.or_else(|| default_initial(causality, variability)),
        start: start.map(str::to_owned),
        unit: units.next().map(str::to_owned),
        min: limit("min")?,
        max: limit("max")?,
    })
}

/// Returns the default by FMI 3.0, 2.4.7.4; FMI 2.0 has `continuous` for all.
fn default_variability(causality: Causality, kind: Kind, version: Version) -> Variability {
    let is_parameter = matches!(
        causality,
        Causality::Parameter | Causality::CalculatedParameter | Causality::StructuralParameter
    );
    match version {
        Version::Three if is_parameter => Variability::Fixed,
        Version::Three if !kind.is_float() => Variability::Discrete,
        _ => Variability::Continuous,
    }
}

/// Returns the default by FMI 2.0, 2.2.7 and FMI 3.0, 2.4.7.5.
fn default_initial(causality: Causality, variability: Variability) -> Option<Initial> {
    match causality {
        Causality::Parameter | Causality::StructuralParameter => Some(Initial::Exact),
        Causality::CalculatedParameter => Some(Initial::Calculated),
        Causality::Output | Causality::Local => match variability {
            Variability::Constant => Some(Initial::Exact),
            _ => Some(Initial::Calculated),
        },
        Causality::Input | Causality::Independent => None,
    }
}
