//! The `[controller]` table: which law, with which gains. Fields are the law's `Config`, units last.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The control law; exactly one of these tables.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Controller {
    /// Sliding mode with an observer on a nominal model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sliding_mode: Option<SlidingMode>,
    /// Sliding mode as the paper prints it, with errata, Eq. (12)-(14).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sliding_mode_paper: Option<SlidingModePaper>,
    /// PID with anti-windup.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pid: Option<Pid>,
    /// A current profile without feedback.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub open_loop: Option<OpenLoop>,
}

/// Sliding mode with an observer on a nominal model.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlidingMode {
    /// `λ` (paper: 40).
    pub bandwidth_radians_per_second: f64,
    /// `φ` (paper: 1.6).
    pub boundary_layer_metres_per_second_squared: f64,
    /// `KSM` (paper: 64 = λφ).
    pub switching_gain_metres_per_second_cubed: f64,
    /// Poles of the observer.
    pub observer_radians_per_second: f64,
    /// Poles of the reference filter.
    pub reference_filter_radians_per_second: f64,
}

impl Default for SlidingMode {
    fn default() -> Self {
        Self {
            bandwidth_radians_per_second: 40.0,
            boundary_layer_metres_per_second_squared: 1.6,
            switching_gain_metres_per_second_cubed: 64.0,
            observer_radians_per_second: 135.0,
            reference_filter_radians_per_second: 28.0,
        }
    }
}

/// Sliding mode as the paper prints it, with errata, Eq. (12)-(14).
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlidingModePaper {
    /// `λ` (paper: 40).
    pub bandwidth_radians_per_second: f64,
    /// `φ` (paper: 1.6).
    pub boundary_layer_metres_per_second_squared: f64,
    /// `KSM` (paper: 64).
    pub switching_gain_metres_per_second_cubed: f64,
    /// Poles of the filter that differentiates the position (assumed).
    pub derivative_filter_radians_per_second: f64,
    /// Poles of the reference filter (assumed).
    pub reference_filter_radians_per_second: f64,
}

impl Default for SlidingModePaper {
    fn default() -> Self {
        Self {
            bandwidth_radians_per_second: 40.0,
            boundary_layer_metres_per_second_squared: 1.6,
            switching_gain_metres_per_second_cubed: 64.0,
            derivative_filter_radians_per_second: 100.0,
            reference_filter_radians_per_second: 20.0,
        }
    }
}

/// PID with anti-windup; the output is a current.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pid {
    /// Proportional gain.
    pub proportional_amperes_per_metre: f64,
    /// Integral gain.
    pub integral_amperes_per_metre_second: f64,
    /// Derivative gain.
    pub derivative_ampere_seconds_per_metre: f64,
    /// Pole of the derivative's filter.
    pub derivative_filter_radians_per_second: f64,
}

impl Default for Pid {
    fn default() -> Self {
        Self {
            proportional_amperes_per_metre: 20.0,
            integral_amperes_per_metre_second: 20.0,
            derivative_ampere_seconds_per_metre: 0.5,
            derivative_filter_radians_per_second: 100.0,
        }
    }
}

/// A current profile without feedback; built like `[reference]`.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpenLoop {
    /// Current jumps to a value and stays.
    pub step: Vec<CurrentStep>,
    /// Current moves linearly from its present value.
    pub ramp: Vec<CurrentRamp>,
}

/// Current jumps to a value and stays.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CurrentStep {
    /// When.
    pub at_seconds: f64,
    /// To which value.
    pub current_amperes: f64,
}

/// Current moves linearly from its present value.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CurrentRamp {
    /// Start.
    pub from_seconds: f64,
    /// End.
    pub until_seconds: f64,
    /// Value at the end.
    pub current_amperes: f64,
}
