//! `modelDescription.xml`, the description of an FMU. Reading it runs no code of the FMU.

mod attributes;
mod read;
mod variable;

use std::collections::BTreeMap;

use crate::error::Fault;
use crate::unit::{Base, unit_by_symbol};
pub use variable::{Causality, Initial, Kind, Variability, Variable};

/// Largest size of a description. Models of a hundred thousand variables have some 20 MB.
pub const BYTES_MAX: u64 = 32 << 20;
/// Largest number of elements, attributes and texts together.
const NODES_MAX: u32 = 4_000_000;

/// Names of this machine in FMI 2.0 and FMI 3.0.
#[cfg(target_arch = "x86_64")]
const PLATFORMS: [&str; 2] = ["linux64", "x86_64-linux"];
/// Names of this machine. FMI 2.0 has none, so both are that of FMI 3.0.
#[cfg(target_arch = "aarch64")]
const PLATFORMS: [&str; 2] = ["aarch64-linux", "aarch64-linux"];

/// Version of FMI.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Version {
    /// FMI 2.0.
    Two,
    /// FMI 3.0.
    Three,
}

impl Version {
    /// Returns the version number.
    pub fn name(self) -> &'static str {
        match self {
            Self::Two => "2.0",
            Self::Three => "3.0",
        }
    }

    /// Returns the attribute of the token in a description.
    pub(crate) fn token_attribute(self) -> &'static str {
        match self {
            Self::Two => "guid",
            Self::Three => "instantiationToken",
        }
    }

    /// Returns the folder below `binaries` with this machine's libraries.
    pub fn platform(self) -> &'static str {
        match self {
            Self::Two => PLATFORMS[0],
            Self::Three => PLATFORMS[1],
        }
    }
}

/// The description of an FMU.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// Version of FMI.
    pub version: Version,
    /// Name of the model.
    pub model_name: String,
    /// Description of the model.
    pub description: String,
    /// Name of the tool that made it.
    pub tool: String,
    /// Version of the model.
    pub model_version: String,
    /// Token for the library, which compares it with its own description.
    pub token: String,
    /// Interface for co-simulation; `None` if the FMU has other interfaces only.
    pub co_simulation: Option<CoSimulation>,
    /// Interfaces other than co-simulation, by their names in FMI.
    pub other_interfaces: Vec<&'static str>,
    /// Recommended step.
    pub step_seconds: Option<f64>,
    /// Recommended tolerance.
    pub tolerance: Option<f64>,
    /// Units in terms of the base units; `None` for a unit without a definition.
    pub units: BTreeMap<String, Option<Base>>,
    /// Variables, in their order.
    pub variables: Vec<Variable>,
}

/// The description of co-simulation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoSimulation {
    /// Name of the library.
    pub model_identifier: String,
    /// Whether steps may have any length.
    pub takes_any_step: bool,
    /// The only length of a step, if it is fixed.
    pub fixed_step_seconds: Option<f64>,
    /// Whether the FMU has events and asks for their handling.
    pub has_event_mode: bool,
    /// Whether the FMU needs an installed program.
    pub needs_execution_tool: bool,
}

impl Description {
    /// Reads a description.
    ///
    /// # Errors
    /// The text is too long, no XML, or no description of FMI 2.0 or 3.0.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        if u64::try_from(text.len()).is_ok_and(|length| length > BYTES_MAX) {
            return Err(Fault::xml(format!("it has more than {BYTES_MAX} bytes")));
        }
        let options = roxmltree::ParsingOptions {
            // A document's own entities can expand a small file to a large one.
            allow_dtd: false,
            nodes_limit: NODES_MAX,
            ..roxmltree::ParsingOptions::default()
        };
        let document =
            roxmltree::Document::parse_with_options(text, options).map_err(Fault::xml)?;
        read::description(&document)
    }

    /// Returns the interface for co-simulation.
    ///
    /// # Errors
    /// The FMU has none.
    pub fn served(&self) -> Result<&CoSimulation, Fault> {
        self.co_simulation.as_ref().ok_or_else(|| {
            let has = self.other_interfaces.join(" and ");
            Fault::Invalid(format!(
                "it has no co-simulation, only {has}; export it for co-simulation"
            ))
        })
    }

    /// Finds a variable by its name.
    ///
    /// # Errors
    /// There is none; the error names the most similar one.
    pub fn variable(&self, name: &str) -> Result<&Variable, Fault> {
        if let Some(variable) = self.variables.iter().find(|variable| variable.name == name) {
            return Ok(variable);
        }
        let similarity = |variable: &&Variable| strsim::jaro_winkler(&variable.name, name);
        let nearest = self
            .variables
            .iter()
            .map(|variable| (similarity(&variable), variable))
            .max_by(|(one, _), (other, _)| one.total_cmp(other));
        let hint = match nearest {
            Some((similarity, variable)) if similarity > 0.8 => {
                format!("; did you mean `{}`?", variable.name)
            }
            _ => "; `canrig fmu FILE` lists those that there are".to_owned(),
        };
        Err(Fault::variable(name, format!("is not in the FMU{hint}")))
    }

    /// Returns a variable's unit in terms of the base units, by the FMU's definition, else by the symbol of the unit.
    pub fn base_unit(&self, variable: &Variable) -> Option<Base> {
        let unit = variable.unit.as_deref()?;
        let defined = self.units.get(unit).copied().flatten();
        defined.or_else(|| unit_by_symbol(unit).map(|known| known.base))
    }

    /// Returns the features that the FMU needs and that are not supported, as texts.
    pub fn not_served(&self) -> Vec<String> {
        let mut needs = Vec::new();
        if let Err(fault) = self.served() {
            needs.push(fault.to_string());
        }
        if let Some(co_simulation) = &self.co_simulation
            && co_simulation.needs_execution_tool
        {
            let tool = match self.tool.as_str() {
                "" => "the tool that made it",
                tool => tool,
            };
            needs.push(format!(
                "it may need {tool} on this machine (needsExecutionTool)"
            ));
        }
        let count = |what: &str, is_it: &dyn Fn(&Variable) -> bool| {
            let mut found = self.variables.iter().filter(|variable| is_it(variable));
            let first = found.next()?;
            let more = match found.count() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            Some(format!("{what}: `{}`{more}", first.name))
        };
        let is_input = |variable: &Variable| variable.causality == Causality::Input;
        let found = [
            count("arrays are no ports", &|variable| variable.is_array),
            count("clocks are not ticked", &|variable| {
                variable.kind == Kind::Clock
            }),
            count("binary inputs are not set", &|variable| {
                variable.kind == Kind::Binary && is_input(variable)
            }),
            count("texts are no ports", &|variable| {
                variable.kind == Kind::String && is_input(variable)
            }),
            count("structural parameters keep their values", &|variable| {
                variable.causality == Causality::StructuralParameter
            }),
        ];
        needs.extend(found.into_iter().flatten());
        needs
    }
}

#[cfg(test)]
mod tests;
