//! Laws in a separate process: a program, or canrig's worker that loads a shared library or an FMU.

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::Value;

use crate::plant::{any_values, whole_names};

/// Description of a run for a process that plays a law, which is the content of WELCOME.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct LawSetup {
    /// Names of the values that it reads.
    pub reads: Vec<String>,
    /// Names of its commands.
    pub writes: Vec<String>,
    /// Names of the further values that it writes.
    pub terms: Vec<String>,
    /// Smallest and largest command of each of `writes`, in its unit.
    pub ranges: Vec<[f64; 2]>,
    /// Parameters by name. A law in a library is given the numbers among them.
    pub parameters: BTreeMap<String, Value>,
    /// Variables of an FMU, by the names of the values.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub variables: BTreeMap<String, String>,
    /// Time between two cycles.
    pub period_seconds: f64,
}

/// A law that a program plays, in any language. In each cycle it gets the values that the law reads, and answers with those that
/// it writes.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Program {
    /// The program and its arguments, without a shell. The program is searched on `PATH`; one with a `/` in its name is a file in
    /// the scenario's folder or below it, where the program runs.
    #[schemars(length(min = 1, max = 64), inner(length(min = 1, max = 4096)))]
    pub command: Vec<String>,
    /// Quantities that the law reads: `position_millimetres`, `set_point_millimetres`, and the latter with `_per_second` or
    /// `_per_second_squared`, in any unit of the quantity. A name may begin with that of the loop and a dot.
    #[schemars(length(min = 1, max = 64), inner(length(min = 1, max = 200)))]
    pub reads: Vec<String>,
    /// Commands of the law: `command`, in the unit of what the drive's amplifier gives, and `command_2` or `DRIVE.command` of
    /// each further drive of the loop. The quantity itself, as in `current_amperes` or `voltage_volts`, is converted.
    #[schemars(length(min = 1, max = 8), inner(length(min = 1, max = 200)))]
    pub writes: Vec<String>,
    /// Terms that the law also writes, to be recorded: names that end in their units.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 8), inner(length(min = 1, max = 200)))]
    pub terms: Vec<String>,
    /// Its parameters, which `--set` and `[sweep]` reach.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(schema_with = "any_values")]
    pub parameters: BTreeMap<String, Value>,
}

/// A law that a function of a shared library plays, behind `canrig_law.h`.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Library {
    /// The library, in the scenario's folder or below it.
    #[schemars(length(min = 1, max = 4096))]
    pub file: String,
    /// Quantities that the law reads, as in `[controller.program]`.
    #[schemars(length(min = 1, max = 64), inner(length(min = 1, max = 200)))]
    pub reads: Vec<String>,
    /// Commands of the law, as in `[controller.program]`.
    #[schemars(length(min = 1, max = 8), inner(length(min = 1, max = 200)))]
    pub writes: Vec<String>,
    /// Terms that the law also writes, as in `[controller.program]`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 8), inner(length(min = 1, max = 200)))]
    pub terms: Vec<String>,
    /// Its parameters: numbers.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(length(max = 1000))]
    pub parameters: BTreeMap<String, f64>,
}

/// A law that an FMU plays.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FmuLaw {
    /// The FMU, in the scenario's folder or below it.
    #[schemars(length(min = 1, max = 4096))]
    pub file: String,
    /// Its inputs, each with the quantity that it reads, as in `[controller.program]`: `y = "position_millimetres"`.
    #[schemars(length(min = 1, max = 64))]
    pub reads: BTreeMap<String, String>,
    /// Its outputs that are commands, as in `[controller.program]`: `u = "command"`.
    #[schemars(length(min = 1, max = 8))]
    pub writes: BTreeMap<String, String>,
    /// Its outputs that are also recorded.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(length(max = 8))]
    pub terms: BTreeMap<String, String>,
    /// Start values by the names of its variables, in the FMU's units: numbers, booleans or texts.
    #[serde(
        default,
        deserialize_with = "whole_names",
        skip_serializing_if = "BTreeMap::is_empty"
    )]
    #[schemars(schema_with = "any_values")]
    pub parameters: BTreeMap<String, Value>,
}

/// A law of any kind in a separate process: as its table has it, until the controller gives it a place in its loop.
#[derive(Clone, Debug, PartialEq)]
pub struct ProcessLaw {
    /// Player of the law.
    pub plays: Plays,
    /// Name of its loop among several; empty for an only loop, and before the law has its place.
    pub loop_name: String,
    /// Names, parameters, ranges, and time between two cycles. Before the law has its place, the names are as written and may
    /// begin with that of a loop or a drive, there are no ranges, and the time is 0.
    pub setup: LawSetup,
}

/// Player of a law.
#[derive(Clone, Debug, PartialEq)]
pub enum Plays {
    /// Program with its arguments.
    Command(Vec<String>),
    /// Functions of a shared library.
    Library(String),
    /// An FMU.
    Fmu(String),
}

impl fmt::Display for Plays {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Command(words) => formatter.write_str(&words.join(" ")),
            Self::Library(file) | Self::Fmu(file) => formatter.write_str(file),
        }
    }
}

impl ProcessLaw {
    fn new(
        plays: Plays,
        [reads, writes, terms]: [Vec<String>; 3],
        parameters: BTreeMap<String, Value>,
    ) -> Self {
        Self {
            plays,
            loop_name: String::new(),
            setup: LawSetup {
                reads,
                writes,
                terms,
                parameters,
                ..LawSetup::default()
            },
        }
    }
}

impl From<&Program> for ProcessLaw {
    fn from(law: &Program) -> Self {
        let signals = [&law.reads, &law.writes, &law.terms].map(Vec::clone);
        let plays = Plays::Command(law.command.clone());
        Self::new(plays, signals, law.parameters.clone())
    }
}

impl From<&Library> for ProcessLaw {
    fn from(law: &Library) -> Self {
        let signals = [&law.reads, &law.writes, &law.terms].map(Vec::clone);
        let given = law.parameters.iter();
        let parameters = given.map(|(name, value)| (name.clone(), (*value).into()));
        Self::new(
            Plays::Library(law.file.clone()),
            signals,
            parameters.collect(),
        )
    }
}

impl From<&FmuLaw> for ProcessLaw {
    fn from(law: &FmuLaw) -> Self {
        let ports = [&law.reads, &law.writes, &law.terms];
        let signals = ports.map(|ports| ports.values().cloned().collect());
        let plays = Plays::Fmu(law.file.clone());
        let mut fmu = Self::new(plays, signals, law.parameters.clone());
        let pairs = ports.into_iter().flatten();
        let variables = pairs.map(|(variable, signal)| (signal.clone(), variable.clone()));
        fmu.setup.variables = variables.collect();
        fmu
    }
}
