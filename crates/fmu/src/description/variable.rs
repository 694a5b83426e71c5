//! One variable of an FMU.

use serde::de::value::{Error, StrDeserializer};
use serde::{Deserialize, Serialize};

/// Returns the value of this name in FMI; `None` if there is none.
pub(super) fn keyword<'a, T: Deserialize<'a>>(text: &'a str) -> Option<T> {
    T::deserialize(StrDeserializer::<Error>::new(text)).ok()
}

/// The type of a variable's values.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[expect(missing_docs, reason = "FMI's own names")]
pub enum Kind {
    Float32,
    Float64,
    Int8,
    UInt8,
    Int16,
    UInt16,
    Int32,
    UInt32,
    Int64,
    UInt64,
    Boolean,
    Enumeration,
    String,
    Binary,
    Clock,
}

impl Kind {
    /// Returns the kind of an element of FMI 2.0; `Real` and `Integer` are numbers of 64 and 32 bits.
    pub(super) fn of_fmi_2(element: &str) -> Option<Self> {
        match element {
            "Real" => Some(Self::Float64),
            "Integer" => Some(Self::Int32),
            "Boolean" | "String" | "Enumeration" => keyword(element),
            _ => None,
        }
    }

    /// Returns whether the values are floating-point numbers.
    pub fn is_float(self) -> bool {
        matches!(self, Self::Float32 | Self::Float64)
    }

    /// Returns whether a port can carry the values, as numbers.
    pub fn is_number(self) -> bool {
        !matches!(self, Self::String | Self::Binary | Self::Clock)
    }

    /// Returns the smallest and the largest value of an integer type.
    pub(crate) fn whole_range(self) -> Option<[f64; 2]> {
        Some(match self {
            Self::Int8 => [f64::from(i8::MIN), f64::from(i8::MAX)],
            Self::UInt8 => [0.0, f64::from(u8::MAX)],
            Self::Int16 => [f64::from(i16::MIN), f64::from(i16::MAX)],
            Self::UInt16 => [0.0, f64::from(u16::MAX)],
            Self::Int32 => [f64::from(i32::MIN), f64::from(i32::MAX)],
            Self::UInt32 => [0.0, f64::from(u32::MAX)],
            // Range in which a 64-bit float represents integers exactly.
            Self::Int64 | Self::Enumeration => [-WHOLE_MAX, WHOLE_MAX],
            Self::UInt64 => [0.0, WHOLE_MAX],
            Self::Boolean => [0.0, 1.0],
            _ => return None,
        })
    }
}

/// 2^53.
const WHOLE_MAX: f64 = 9_007_199_254_740_992.0;

/// Role of a variable.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
#[expect(missing_docs, reason = "FMI's own names")]
pub enum Causality {
    Parameter,
    CalculatedParameter,
    StructuralParameter,
    Input,
    Output,
    Local,
    Independent,
}

impl Causality {
    /// Returns a text that follows the word "is".
    pub fn name(self) -> &'static str {
        match self {
            Self::Parameter => "a parameter",
            Self::CalculatedParameter => "a calculated parameter",
            Self::StructuralParameter => "a structural parameter",
            Self::Input => "an input",
            Self::Output => "an output",
            Self::Local => "a local variable",
            Self::Independent => "the independent variable",
        }
    }
}

/// Times at which a variable may change.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
#[expect(missing_docs, reason = "FMI's own names")]
pub enum Variability {
    Constant,
    Fixed,
    Tunable,
    Discrete,
    Continuous,
}

/// Source of a variable's first value.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
#[expect(missing_docs, reason = "FMI's own names")]
pub enum Initial {
    Exact,
    Approx,
    Calculated,
}

/// A variable.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Variable {
    /// Name of the variable.
    pub name: String,
    /// Number of the variable in calls to the library.
    pub reference: u32,
    /// Description of the variable.
    pub description: String,
    /// Type of the values.
    pub kind: Kind,
    /// Whether the variable has more than one value.
    pub is_array: bool,
    /// Role of the variable.
    pub causality: Causality,
    /// Times at which the variable may change.
    pub variability: Variability,
    /// Source of the first value.
    pub initial: Option<Initial>,
    /// Start value, as written.
    pub start: Option<String>,
    /// Symbol of the unit in the FMU.
    pub unit: Option<String>,
    /// Lowest value.
    pub min: Option<f64>,
    /// Highest value.
    pub max: Option<f64>,
}

impl Variable {
    /// Returns whether a start value can be set.
    pub fn takes_start(&self) -> bool {
        let is_set_before = matches!(self.initial, Some(Initial::Exact | Initial::Approx));
        let is_served = !self.is_array && !matches!(self.kind, Kind::Binary | Kind::Clock);
        is_served
            && self.variability != Variability::Constant
            && match self.causality {
                Causality::Parameter | Causality::Input => true,
                Causality::StructuralParameter | Causality::Independent => false,
                _ => is_set_before,
            }
    }

    /// Returns whether the variable can be set at each step.
    pub fn is_input(&self) -> bool {
        self.is_port_shaped()
            && (self.causality == Causality::Input
                || (self.causality == Causality::Parameter
                    && self.variability == Variability::Tunable))
    }

    /// Returns whether the variable is an input that an FMU with events takes in event mode only.
    pub(crate) fn is_discrete_input(&self) -> bool {
        self.causality == Causality::Input && self.variability == Variability::Discrete
    }

    /// Returns whether the value is a single number.
    pub fn is_port_shaped(&self) -> bool {
        self.kind.is_number() && !self.is_array
    }
}
