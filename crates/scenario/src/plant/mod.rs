//! The plants that a drive moves, and what the amplifier of a drive sets in its data sheet. Defaults come from the paper or a data sheet, or are
//! marked "assumed".

mod dc_motor;
mod fmu;
mod sma;
mod sma_pair;

use std::any::Any;
use std::path::Path;

use canopen::object_dictionary::Preset;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::custom::{self, Custom, Parameters, any};
use crate::rig::nodes::Amplifier;
pub use dc_motor::DcMotor;
pub use fmu::{Fmu, FmuPort};
pub(crate) use fmu::{any_values, whole_names};
pub use sma::{Heat, Kinetics, Mechanics, Phase, Sma, StressStrain};
pub use sma_pair::SmaPair;

/// Name of the actuator of the paper.
pub const SMA_ACTUATOR: &str = "sma_actuator";
/// Name of its table.
const SMA: &str = "sma";
/// Faults of `[[fault.plant.…]]` that have a meaning for the actuator, for the DC motor, and for the joint or one of its wires.
const SMA_FAULTS: &[&str] = &["ageing", "broken_wire", "jammed_pulley", "dropped_load"];
const MOTOR_FAULTS: &[&str] = &["jammed_pulley", "dropped_load"];
const PAIR_FAULTS: &[&str] = &["ageing", "broken_wire", "jammed_pulley"];
/// Name of the DC motor, and of its table.
pub(crate) const DC_MOTOR: &str = "dc_motor";
/// Name of the joint with two wires, and of its table.
pub const SMA_PAIR: &str = "sma_pair";
/// Name of a plant from a modelling tool, and of its table.
pub const FMU: &str = "fmu";
/// Checks whether the format has the table of a plant; tables from outside are registered.
pub fn is_built_in(plant: &str) -> bool {
    [SMA_ACTUATOR, SMA, DC_MOTOR, SMA_PAIR, FMU].contains(&plant)
}

/// A plant: exactly one model with its parameters.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(default)]
#[schemars(deny_unknown_fields, extend("minProperties" = 1, "maxProperties" = 1))]
pub struct PlantModel {
    /// The shape-memory-alloy actuator of the paper.
    pub sma: Option<Sma>,
    /// A DC motor with gearbox, which lifts a load against a spring.
    pub dc_motor: Option<DcMotor>,
    /// A joint that two shape-memory-alloy wires turn, one each way.
    pub sma_pair: Option<SmaPair>,
    /// A plant from a modelling tool: an FMU of FMI 2.0 or 3.0 for co-simulation.
    pub fmu: Option<Fmu>,
    /// The table of a model from outside, under its own name.
    #[serde(flatten, deserialize_with = "custom::read")]
    #[schemars(skip)]
    pub custom: Option<Custom>,
}

impl PlantModel {
    /// Replaces its files, which are in the folder of the rig file, by paths.
    pub(crate) fn beside(&self, rig: &Path) -> Self {
        let mut model = self.clone();
        if let Some(fmu) = &mut model.fmu {
            let file = rig.with_file_name(&fmu.file);
            fmu.file = file.to_string_lossy().into_owned();
        }
        model
    }

    /// Makes the actuator with these parameters.
    pub fn from_sma(sma: Sma) -> Self {
        let sma = Some(sma);
        Self {
            sma,
            ..Self::default()
        }
    }

    /// Returns the parameters of the actuator; `None` for another model.
    pub fn actuator(&self) -> Option<Sma> {
        let is_actuator = self.custom.is_none() && self.table().0 == SMA_ACTUATOR;
        is_actuator.then(|| self.sma.clone().unwrap_or_default())
    }

    /// Returns the key of its table in a rig file.
    pub(crate) fn key(&self) -> &str {
        match self.name() {
            SMA_ACTUATOR => SMA,
            name => name,
        }
    }

    /// Returns the name of the plant; the actuator's if there is no table.
    pub fn name(&self) -> &str {
        let custom = self.custom.as_ref();
        custom.map_or_else(|| self.table().0, Custom::name)
    }

    /// Returns the faults of `[[fault.plant.…]]` that have a meaning for the plant.
    pub fn faults(&self) -> &'static [&'static str] {
        match &self.custom {
            Some(custom) => custom::plant_faults(custom.name()),
            None => self.table().1,
        }
    }

    /// Returns the mass that hangs on the plant, without that of disturbances; `None` for a plant that knows it by itself.
    pub fn load_kilograms(&self) -> Option<f64> {
        match &self.dc_motor {
            Some(motor) => Some(motor.load_kilograms),
            None => Some(self.actuator()?.mechanics.load_kilograms),
        }
    }

    /// Applies a function to the plant's parameters.
    ///
    /// # Errors
    /// The parameters belong to another plant.
    pub fn with_parameters<P: Parameters, T>(
        &self,
        make: impl FnOnce(&P) -> T,
    ) -> Result<T, toml::de::Error> {
        let (.., parameters) = self.table();
        custom::with_parameters([parameters], self.custom.as_ref(), make)
    }

    /// Returns the table of the format that is given; the actuator's if there is none.
    fn table(&self) -> Table<'_> {
        let tables: [Table<'_>; 3] = [
            (DC_MOTOR, MOTOR_FAULTS, any(&self.dc_motor)),
            (SMA_PAIR, PAIR_FAULTS, any(&self.sma_pair)),
            (FMU, &[], any(&self.fmu)),
        ];
        let mut others = tables.into_iter();
        let given = others.find(|(.., parameters)| parameters.is_some());
        given.unwrap_or((SMA_ACTUATOR, SMA_FAULTS, any(&self.sma)))
    }
}

/// Name of a model that the format has, faults that have a meaning for the plant, and parameters, if they are given.
type Table<'a> = (&'static str, &'static [&'static str], Option<&'a dyn Any>);

/// Commanded torque of a drive (CiA 402-2), which its amplifier gives.
pub const TARGET_TORQUE: u16 = 0x6071;
/// Largest commanded torque.
pub const MAX_TORQUE: u16 = 0x6072;
/// Largest current.
pub const MAX_CURRENT: u16 = 0x6073;
const MOTOR_RATED_CURRENT: u16 = 0x6075;
/// I²t protection.
pub const THERMAL_PROTECTION: u16 = 0x2110;

impl Amplifier {
    /// Returns the values that the amplifier sets in the data sheet of its drive.
    pub(crate) fn presets(&self) -> [Preset; 6] {
        let thousandths = |value: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the schema limits it to what 32 bits hold"
            )]
            let value = libm::round(value * 1e3) as i64;
            value
        };
        // Commands reach the rated current at least, so that clipping by the amplifier shows.
        let rated = self.rated();
        let most = thousandths((self.range().largest() / rated).max(1.0));
        let within = |index, value, low| Preset {
            limits: Some([low, most]),
            ..Preset::new(index, 0, value)
        };
        let [continuous, peak] = self
            .i2t
            .map_or([0.0; 2], |i2t| [i2t.continuous, i2t.peak_square_seconds]);
        [
            within(TARGET_TORQUE, 0, -most),
            within(MAX_TORQUE, most, 0),
            within(MAX_CURRENT, most, 0),
            Preset::new(MOTOR_RATED_CURRENT, 0, thousandths(rated)),
            Preset::new(THERMAL_PROTECTION, 1, thousandths(continuous)),
            Preset::new(THERMAL_PROTECTION, 2, thousandths(peak)),
        ]
    }
}

/// I²t protection: it limits the time for which more than the continuous current may flow.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct I2t {
    /// Current that may flow for ever, in amperes (0x2110:01).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000_000.0))]
    pub continuous: f64,
    /// Largest `∫ (i² − continuous²) dt`, in A² s (0x2110:02); beyond it the drive faults with 0x2350.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 4_000_000.0))]
    pub peak_square_seconds: f64,
}
