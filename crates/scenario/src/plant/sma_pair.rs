//! The parameters of two wires at one joint: `[plant.NAME.sma_pair]` of a rig file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sma::{Heat, Kinetics, Phase};

/// A joint that two shape-memory-alloy wires turn, one each way; the one that is not heated goes slack. Both wires are of the
/// paper's alloy and longer; values that are not marked as the paper's are assumed.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct SmaPair {
    /// Rule by which the phase transformation of each wire follows turns of its temperature.
    pub kinetics: Kinetics,
    /// Heat balance of each wire, Eq. (1).
    pub heat: Heat,
    /// Phase transformation of each wire, Eq. (2).
    pub phase: Phase,
    /// Radius on which both wires lie (assumed: 12).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub pulley_radius_millimetres: f64,
    /// Length of each martensitic wire (assumed: 650).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub wire_length_millimetres: f64,
    /// Diameter of each wire (paper: 0.2).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub wire_diameter_millimetres: f64,
    /// Recoverable strain (paper: 0.04).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 0.1))]
    pub recoverable_strain: f64,
    /// Young's modulus of austenite (assumed: 75e9).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e12))]
    pub austenite_modulus_pascals: f64,
    /// Inertia of the joint with what it moves (assumed: 4e-5).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub inertia_kilogram_square_metres: f64,
    /// Damping of the joint (assumed: 0.01).
    #[schemars(range(min = 0.0, max = 100.0))]
    pub damping_newton_metre_seconds: f64,
    /// Distance of the joint's stops, on both sides, from its middle, where each wire has contracted by half (assumed: 62).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 360.0))]
    pub stop_degrees: f64,
}

impl Default for SmaPair {
    fn default() -> Self {
        Self {
            kinetics: Kinetics::default(),
            heat: Heat::default(),
            phase: Phase::default(),
            pulley_radius_millimetres: 12.0,
            wire_length_millimetres: 650.0,
            wire_diameter_millimetres: 0.2,
            recoverable_strain: 0.04,
            austenite_modulus_pascals: 75e9,
            inertia_kilogram_square_metres: 4e-5,
            damping_newton_metre_seconds: 0.01,
            stop_degrees: 62.0,
        }
    }
}
