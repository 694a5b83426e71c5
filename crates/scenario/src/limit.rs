//! A limit, as scenarios set it.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A two-sided limit; at least one side is given.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
#[schemars(extend("minProperties" = 1))]
pub struct Limit {
    /// Smallest value that passes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Largest value that passes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

impl Limit {
    /// Checks whether a value is within both sides.
    pub fn admits(&self, value: f64) -> bool {
        self.min.is_none_or(|min| value >= min) && self.max.is_none_or(|max| value <= max)
    }

    /// Returns the distance of a value to the nearer side; negative beyond a side.
    pub fn margin(&self, value: f64) -> f64 {
        let (min, max) = self.ends();
        f64::min(value - min, max - value)
    }

    /// Returns both sides; one that is not given is infinite.
    pub fn ends(&self) -> (f64, f64) {
        let min = self.min.unwrap_or(f64::NEG_INFINITY);
        (min, self.max.unwrap_or(f64::INFINITY))
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.min, self.max) {
            (Some(min), Some(max)) => write!(formatter, "{min} to {max}"),
            (Some(min), None) => write!(formatter, "at least {min}"),
            (None, Some(max)) => write!(formatter, "at most {max}"),
            (None, None) => formatter.write_str("anything"),
        }
    }
}

/// Rounds to six decimals: more than any metric is known to, and the same text on every machine.
pub fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_admits_its_ends_and_never_nan() {
        let limit = Limit {
            min: Some(1.0),
            max: Some(2.0),
        };
        assert!(limit.admits(1.0) && limit.admits(2.0));
        assert!(!limit.admits(0.999) && !limit.admits(2.001) && !limit.admits(f64::NAN));
    }
}
