//! The `[plant]` table: the truth that the emulator plays. Defaults are the paper's, a data sheet's, or "assumed".

mod dc_motor;
mod fmu;
mod sma;
mod sma_pair;

use std::any::Any;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::left_out::is_zero;
use crate::own::{self, Own, Parameters, defaults};
pub use dc_motor::DcMotor;
pub use fmu::{Fmu, FmuPort};
pub use sma::{Heat, Mechanics, Phase, SMA_FAULTS, StressStrain};
pub use sma_pair::SmaPair;

/// Name of the plant of a scenario without a table of another one: the actuator of the paper.
pub const SMA_ACTUATOR: &str = "sma_actuator";
/// Name of the DC motor, and of its table.
pub(crate) const DC_MOTOR: &str = "dc_motor";
/// Name of the joint with two wires, and of its table.
pub const SMA_PAIR: &str = "sma_pair";
/// Name of a plant from a modelling tool, and of its table.
pub const FMU: &str = "fmu";
/// Plants with a table of their own in the format.
pub(crate) const WITH_TABLE: [&str; 3] = [DC_MOTOR, SMA_PAIR, FMU];

/// Whether the format has the table of a plant; those of others are registered.
#[must_use]
pub fn is_of_format(plant: &str) -> bool {
    plant == SMA_ACTUATOR || WITH_TABLE.contains(&plant)
}

/// The rig: a plant with its sensor and its amplifier. Without a plant's own table, such as `[plant.dc_motor]`, it is the SMA
/// actuator.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Plant {
    /// A DC motor in place of the shape-memory-alloy wire.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dc_motor: Option<DcMotor>,
    /// A joint with two shape-memory-alloy wires, which only a rig file can wire: it has two currents and an angle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sma_pair: Option<SmaPair>,
    /// A plant from a modelling tool, which only a rig file can wire.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fmu: Option<Fmu>,
    /// Heat balance of the wire, Eq. (1).
    pub heat: Heat,
    /// Phase transformation, Eq. (2).
    pub phase: Phase,
    /// Wire mechanics and motion, Eq. (3)-(9).
    pub mechanics: Mechanics,
    /// Position sensor.
    pub sensor: Sensor,
    /// Current amplifier.
    pub amplifier: Amplifier,
    /// The table of a plant from outside, under its own name.
    #[serde(flatten, skip_deserializing)]
    #[schemars(skip)]
    pub own: Option<Own>,
}

impl Plant {
    /// The name of the plant that the table describes.
    #[must_use]
    pub fn name(&self) -> &str {
        match self.model() {
            Model::Own(own) => own.name(),
            Model::DcMotor(_) => DC_MOTOR,
            Model::SmaPair(_) => SMA_PAIR,
            Model::Fmu(_) => FMU,
            Model::Actuator => SMA_ACTUATOR,
        }
    }

    /// The faults of `[[fault.plant.…]]` that mean something to the plant.
    #[must_use]
    pub fn faults(&self) -> &'static [&'static str] {
        match self.model() {
            Model::Own(own) => own::faults_of(own.name()),
            Model::DcMotor(_) => DcMotor::FAULTS,
            Model::SmaPair(_) => SmaPair::FAULTS,
            Model::Fmu(_) => &[],
            Model::Actuator => SMA_FAULTS,
        }
    }

    /// The mass that hangs on the plant, without that of disturbances; a plant from outside knows by itself.
    #[must_use]
    pub fn load_kilograms(&self) -> Option<f64> {
        match self.model() {
            Model::Own(_) | Model::SmaPair(_) | Model::Fmu(_) => None,
            Model::DcMotor(motor) => Some(motor.load_kilograms),
            Model::Actuator => Some(self.mechanics.load_kilograms),
        }
    }

    /// Makes something of the plant's parameters.
    ///
    /// # Errors
    /// They are those of another plant.
    pub fn with_parameters<P: Parameters, T>(
        &self,
        make: impl FnOnce(&P) -> T,
    ) -> Result<T, toml::de::Error> {
        let table: &dyn Any = match self.model() {
            Model::Own(own) => return Ok(make(&own.parameters()?)),
            Model::DcMotor(motor) => motor,
            Model::SmaPair(pair) => pair,
            Model::Fmu(fmu) => fmu,
            Model::Actuator => self,
        };
        match table.downcast_ref() {
            Some(parameters) => Ok(make(parameters)),
            None => Ok(make(&defaults()?)),
        }
    }

    fn model(&self) -> Model<'_> {
        match (&self.own, &self.dc_motor, &self.sma_pair, &self.fmu) {
            (Some(own), _, _, _) => Model::Own(own),
            (None, Some(motor), _, _) => Model::DcMotor(motor),
            (None, None, Some(pair), _) => Model::SmaPair(pair),
            (None, None, None, Some(fmu)) => Model::Fmu(fmu),
            (None, None, None, None) => Model::Actuator,
        }
    }
}

/// The plant that a table describes.
enum Model<'a> {
    Own(&'a Own),
    DcMotor(&'a DcMotor),
    SmaPair(&'a SmaPair),
    Fmu(&'a Fmu),
    Actuator,
}

/// Position sensor: a potentiometer read by an analogue-to-digital converter, or anything else that counts in equal steps.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sensor {
    /// Resolution (paper: 10).
    #[schemars(range(min = 1, max = 24))]
    pub resolution_bits: u32,
    /// Span; the converter clips there (assumed: 60).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub span_millimetres: f64,
    /// Standard deviation of normal noise before conversion (assumed: 0).
    #[schemars(range(min = 0.0, max = 10.0))]
    pub noise_millimetres_rms: f64,
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            resolution_bits: 10,
            span_millimetres: 60.0,
            noise_millimetres_rms: 0.0,
        }
    }
}

/// Current amplifier.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Amplifier {
    /// Smallest current: 0, or below it for an amplifier that drives both ways (paper: 0).
    #[serde(skip_serializing_if = "is_zero")]
    #[schemars(range(min = -1.0, max = 0.0), extend("default" = 0.0))]
    pub current_amperes_min: f64,
    /// Largest current (paper: 1).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub current_amperes_max: f64,
    /// Resolution of the digital-to-analogue converter over the full range; 0 leaves the command's own 1 permille
    /// (paper: 10 bits; default 0, since the frame already rounds to 1 permille).
    #[schemars(range(min = 0, max = 24))]
    pub resolution_bits: u32,
}

impl Default for Amplifier {
    fn default() -> Self {
        Self {
            current_amperes_min: 0.0,
            current_amperes_max: 1.0,
            resolution_bits: 0,
        }
    }
}
