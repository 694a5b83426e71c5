//! The `[controller]` table: which law, with which gains. Fields are the law's `Config`, units last.

use std::any::Any;
use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::custom::{self, Custom, Parameters, any};
use crate::load::Factor;
use crate::plant::Sma;
use crate::process_law::{FmuLaw, Library, ProcessLaw, Program};

/// The control law; exactly one of these tables.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Controller {
    /// Sliding mode with an observer on a nominal model.
    pub sliding_mode: Option<SlidingMode>,
    /// Sliding mode as the paper prints it, with errata, Eq. (12)-(14).
    pub sliding_mode_paper: Option<SlidingModePaper>,
    /// PID with anti-windup.
    pub pid: Option<Pid>,
    /// PID for two drives that pull against each other.
    pub pid_pair: Option<PidPair>,
    /// A command profile without feedback.
    pub open_loop: Option<OpenLoop>,
    /// A program in any language.
    pub program: Option<Program>,
    /// A function of a shared library behind `canrig_law.h`.
    pub library: Option<Library>,
    /// An FMU of FMI 2.0 or 3.0 for co-simulation.
    pub fmu: Option<FmuLaw>,
    /// The table of a law from outside, under its own name.
    #[serde(flatten, deserialize_with = "custom::read")]
    #[schemars(skip)]
    pub custom: Option<Custom>,
}

impl Controller {
    /// Returns the names of the laws that have a table.
    pub fn law_names(&self) -> impl Iterator<Item = &str> {
        let custom = self.custom.as_ref().map(|custom| custom.name());
        let laws = self.laws().into_iter();
        let chosen = laws.filter_map(|(name, _, table)| table.map(|_| name));
        chosen.chain(custom)
    }

    /// Returns the name of the law's table.
    pub fn law_name(&self) -> &str {
        self.law_names().next().unwrap_or("none")
    }

    /// Applies a function to the law's parameters.
    ///
    /// # Errors
    /// The parameters belong to another law.
    pub fn with_parameters<P: Parameters, T>(
        &self,
        make: impl FnOnce(&P) -> T,
    ) -> Result<T, toml::de::Error> {
        let tables = self.laws().map(|(_, _, table)| table);
        custom::with_parameters(tables, self.custom.as_ref(), make)
    }

    /// Returns the law if it runs in a separate process.
    pub fn process_law(&self) -> Option<ProcessLaw> {
        let program = self.program.as_ref().map(ProcessLaw::from);
        let library = self.library.as_ref().map(ProcessLaw::from);
        let fmu = self.fmu.as_ref().map(ProcessLaw::from);
        program.or(library).or(fmu)
    }

    /// Checks whether the law is none that ships.
    pub fn is_from_outside(&self) -> bool {
        self.custom.is_some() || self.process_law().is_some()
    }

    /// Turns the file of a library or an FMU, which is in the folder of the scenario, into a path.
    pub(crate) fn place_files(&mut self, scenario: &Path) {
        let library = self.library.iter_mut().map(|law| &mut law.file);
        let fmu = self.fmu.iter_mut().map(|law| &mut law.file);
        for file in library.chain(fmu) {
            let path = scenario.with_file_name(&*file);
            *file = path.to_string_lossy().into_owned();
        }
    }

    /// Converts gains that are by another unit than the loop's.
    pub(crate) fn scale(&mut self, gains: &[Factor]) {
        if gains.is_empty() {
            return;
        }
        let Ok(mut laws) = toml::Value::try_from(&*self) else {
            return;
        };
        for Factor { path, factor, .. } in gains {
            // Behind the name of the section, in which all laws are.
            let mut keys = path.split('.').skip(1);
            let gain = keys.try_fold(&mut laws, |value, key| value.get_mut(key));
            if let Some(gain) = gain
                && let Ok(number) = gain.clone().try_into::<f64>()
            {
                *gain = (number * factor).into();
            }
        }
        if let Ok(scaled) = laws.try_into() {
            *self = scaled;
        }
    }

    /// Returns the laws whose tables the format has, each with its table and the number of drives that it leads; `None` if its
    /// ports tell the number.
    fn laws(&self) -> [(&'static str, Option<usize>, Option<&dyn Any>); 8] {
        [
            ("sliding_mode", Some(1), any(&self.sliding_mode)),
            ("sliding_mode_paper", Some(1), any(&self.sliding_mode_paper)),
            ("pid", Some(1), any(&self.pid)),
            ("pid_pair", Some(2), any(&self.pid_pair)),
            ("open_loop", Some(1), any(&self.open_loop)),
            ("program", None, any(&self.program)),
            ("library", None, any(&self.library)),
            ("fmu", None, any(&self.fmu)),
        ]
    }
}

/// Sliding mode with an observer on a nominal model.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlidingMode {
    /// `λ`, bandwidth in a move (paper: 40).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub bandwidth_radians_per_second: f64,
    /// `φ`, boundary layer (paper: 1.6). If the sliding variable exceeds it in a move, the reference takes less jerk.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub boundary_layer_metres_per_second_squared: f64,
    /// `KSM`, switching gain in a move (paper: 64 = λφ); in a hold it is smaller in proportion to `λ`.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    pub switching_gain_metres_per_second_cubed: f64,
    /// Fastest poles of the reference filter (assumed).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub reference_filter_radians_per_second_max: f64,
    /// Jerk of the reference at the start of a move: the longer the move, the slower the poles of its filter (assumed).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e9))]
    pub reference_launch_jerk_metres_per_second_cubed: f64,
    /// Poles of the reference filter at the end of a move, divided by those at its start (assumed).
    #[schemars(range(min = 1.0, max = 100.0))]
    pub reference_landing_ratio: f64,
    /// Values that differ in a hold.
    pub hold: Hold,
    /// Trust of the observer in sensor and nominal model.
    pub observer: Observer,
    /// A file with a table `[nominal_model]`, relative to the scenario; `canrig identify` writes one. It takes the place of
    /// `nominal_model`.
    pub nominal_model_file: Option<String>,
    /// The plant as the law assumes it.
    pub nominal_model: NominalModel,
}

impl Default for SlidingMode {
    fn default() -> Self {
        Self {
            bandwidth_radians_per_second: 53.0,
            boundary_layer_metres_per_second_squared: 1.6,
            switching_gain_metres_per_second_cubed: 84.8,
            reference_filter_radians_per_second_max: 60.0,
            reference_launch_jerk_metres_per_second_cubed: 430.0,
            reference_landing_ratio: 3.0,
            hold: Hold::default(),
            observer: Observer::default(),
            nominal_model_file: None,
            nominal_model: NominalModel::default(),
        }
    }
}

/// Values for a hold, where the reference rests and the law acts more calmly.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Hold {
    /// `λ`, bandwidth in a hold (assumed).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub bandwidth_radians_per_second: f64,
    /// Standard deviation that the martensite fraction gains in one second beyond the model.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub fraction_drift: f64,
    /// Standard deviation that the unknown heating gains in one second.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub heating_drift_kelvins_per_second: f64,
    /// Duration of the change from move to hold.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub calming_seconds: f64,
    /// Distance from the reference at which the law leaves the hold, in steps of the position sensor.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub error_sensor_steps_max: f64,
}

impl Default for Hold {
    fn default() -> Self {
        Self {
            bandwidth_radians_per_second: 16.0,
            fraction_drift: 0.000_2,
            heating_drift_kelvins_per_second: 7.5,
            calming_seconds: 0.8,
            error_sensor_steps_max: 1.15,
        }
    }
}

/// Sliding mode as the paper prints it, with errata, Eq. (12)-(14).
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlidingModePaper {
    /// `λ`, bandwidth (paper: 40).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub bandwidth_radians_per_second: f64,
    /// `φ`, boundary layer (paper: 1.6).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub boundary_layer_metres_per_second_squared: f64,
    /// `KSM`, switching gain (paper: 64).
    #[schemars(range(min = 0.0, max = 100_000.0))]
    pub switching_gain_metres_per_second_cubed: f64,
    /// Poles of the filter that differentiates the position (assumed).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub derivative_filter_radians_per_second: f64,
    /// Poles of the reference filter (assumed).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub reference_filter_radians_per_second: f64,
    /// Eq. (14) as it is printed, one derivative short and with the switching term outside the bracket, with which the loop does
    /// not settle.
    pub as_printed: bool,
    /// The plant as the law assumes it.
    pub nominal_model: NominalModel,
}

impl Default for SlidingModePaper {
    fn default() -> Self {
        Self {
            bandwidth_radians_per_second: 40.0,
            boundary_layer_metres_per_second_squared: 1.6,
            switching_gain_metres_per_second_cubed: 64.0,
            derivative_filter_radians_per_second: 300.0,
            reference_filter_radians_per_second: 20.0,
            as_printed: false,
            nominal_model: NominalModel::default(),
        }
    }
}

/// PID with anti-windup.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pid {
    /// Proportional gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "proportional_{gain}")]
    pub proportional: f64,
    /// Integral gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "integral_{gain}_second")]
    pub integral: f64,
    /// Derivative gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "derivative_{gain_seconds}")]
    pub derivative: f64,
    /// Share of the set-point in the proportional part: 1 for the plain error, less against overshoot.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub set_point_weight: f64,
    /// Pole of the derivative's filter.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub derivative_filter_radians_per_second: f64,
}

impl Default for Pid {
    /// Least integral of time-weighted absolute error (ITAE) over `scenarios/pid_tuning.toml`, among the gains whose
    /// overshoot stays below 10 % in each of its steps: random search with 3000 draws, then a random descent.
    fn default() -> Self {
        Self {
            proportional: 22.8,
            integral: 37.9,
            derivative: 3.59,
            set_point_weight: 0.77,
            derivative_filter_radians_per_second: 300.0,
        }
    }
}

/// PID for two drives that pull against each other: the output is added to the current of the first one and taken from that of
/// the second. In a loop in degrees the gains are by the degree: `proportional_amperes_per_degree`. All values are assumed.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PidPair {
    /// Proportional gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "proportional_{gain}")]
    pub proportional: f64,
    /// Integral gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "integral_{gain}_second")]
    pub integral: f64,
    /// Derivative gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "derivative_{gain_seconds}")]
    pub derivative: f64,
    /// Pole of the derivative's filter.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub derivative_filter_radians_per_second: f64,
    /// Current of both while the output is 0: how stiff they hold.
    #[schemars(range(min = 0.0, max = 32_767_000.0))]
    #[serde(rename = "co_contraction_{command_unit}")]
    pub co_contraction: f64,
}

impl Default for PidPair {
    fn default() -> Self {
        Self {
            proportional: 0.02,
            integral: 0.04,
            derivative: 0.004,
            derivative_filter_radians_per_second: 100.0,
            co_contraction: 0.5,
        }
    }
}

/// Checks whether the format has the table of a law; tables from outside are registered.
pub fn is_built_in(law: &str) -> bool {
    let laws = Controller::default();
    laws.laws().iter().any(|(name, ..)| *name == law)
}

/// Returns the number of drives that a law leads, by the name of its table; `None` if it is not known, or if the law's ports tell
/// it.
pub fn drives_led_by(law: &str) -> Option<usize> {
    let laws = Controller::default();
    let built_in = laws.laws().into_iter().find(|(name, ..)| *name == law);
    match built_in {
        Some((_, drives, _)) => drives,
        None => custom::drives_led_by(law),
    }
}

/// A command profile without feedback; built like `[reference]`.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpenLoop {
    /// The command jumps to a value and stays.
    #[schemars(length(max = 10_000))]
    pub step: Vec<CurrentStep>,
    /// The command moves linearly from its present value.
    #[schemars(length(max = 10_000))]
    pub ramp: Vec<CurrentRamp>,
    /// A course of the current from a CSV file, such as that of a recording.
    #[schemars(length(max = 10_000))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub table: Vec<CurrentTable>,
}

/// The command jumps to a value and stays.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CurrentStep {
    /// Time of the jump.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// Command after the jump, within the range of the amplifier.
    #[schemars(range(min = -32_767_000.0, max = 32_767_000.0))]
    #[serde(rename = "{command}_{command_unit}")]
    pub current: f64,
}

/// The command moves linearly from its present value.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CurrentRamp {
    /// Start of the ramp.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// End of the ramp.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: f64,
    /// Command at the end, within the range of the amplifier.
    #[schemars(range(min = -32_767_000.0, max = 32_767_000.0))]
    #[serde(rename = "{command}_{command_unit}")]
    pub current: f64,
}

/// Straight lines through the rows of a CSV file: its columns `time_seconds` and that of the current, within the amplifier's range.
/// Other columns and rows without a current are skipped, so `signals.csv` of a run folder serves as it is.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CurrentTable {
    /// Start; the file's times count from here.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// The file, relative to the scenario.
    pub file: String,
    /// The column of the output of the amplifier, as `current_amperes` or `voltage_volts`, if absent; that of the commands in a
    /// `signals.csv` is `target_current_amperes`.
    #[schemars(length(min = 1, max = 200))]
    pub column: Option<String>,
    /// The rows, `(time_seconds, current_amperes)`, put in by the loader.
    #[serde(skip)]
    pub rows: Arc<[(f64, f64)]>,
}

/// Trust of the observer in the sensor and in the nominal model, as their uncertainty.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Observer {
    /// Step of the position sensor (rig: 60 mm in 10 bits).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub sensor_step_millimetres: f64,
    /// Standard deviation that the velocity gains in one second beyond the model.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub velocity_drift_metres_per_second: f64,
    /// Standard deviation that the martensite fraction gains in one second beyond the model, in a move.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub fraction_drift: f64,
    /// Standard deviation that the unknown heating gains in one second, in a move.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub heating_drift_kelvins_per_second: f64,
    /// Standard deviation of the transformation temperatures from the nominal ones.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub temperature_uncertainty_kelvins: f64,
}

impl Default for Observer {
    fn default() -> Self {
        Self {
            sensor_step_millimetres: 60.0 / 1024.0,
            velocity_drift_metres_per_second: 0.005,
            fraction_drift: 0.016,
            heating_drift_kelvins_per_second: 5.5,
            temperature_uncertainty_kelvins: 3.0,
        }
    }
}

/// The plant as a law assumes it. The plant of the emulator differs from it and is hidden from the controller.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct NominalModel {
    /// `m`, mass of the wire (paper: 2e-4).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub mass_kilograms_per_metre: f64,
    /// `cp`, specific heat (paper: 837).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub specific_heat_joules_per_kilogram_kelvin: f64,
    /// `R`, electrical resistance (paper: 32).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub resistance_ohms_per_metre: f64,
    /// `A`, surface (paper: 6.28e-4).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub surface_square_metres_per_metre: f64,
    /// `h`, convection coefficient (paper, identified: 7).
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub convection_watts_per_square_metre_kelvin: f64,
    /// `C`, conduction to the cooling element (paper, identified: 0.255).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub conduction_watts_per_metre_kelvin: f64,
    /// `Tamb`, ambient temperature (paper: 20).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub ambient_celsius: f64,
    /// `Tp`, surface of the cooling element (paper: 15).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub cooling_element_celsius: f64,
    /// `As` (paper, identified: 53).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub austenite_start_celsius: f64,
    /// `Af` (paper, identified: 93).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub austenite_finish_celsius: f64,
    /// `Ms` (paper, identified: 66).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub martensite_start_celsius: f64,
    /// `Mf` (paper, identified: 34).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub martensite_finish_celsius: f64,
    /// `EA`, Young's modulus of austenite (assumed: 75e9).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e12))]
    pub austenite_modulus_pascals: f64,
    /// `d`, wire diameter (paper: 2e-4).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 0.01))]
    pub wire_diameter_metres: f64,
    /// `l_wire`, length of the martensitic wire (paper: 0.15).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub wire_length_metres: f64,
    /// `Δ / l_wire`, recoverable strain (paper: 0.04).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 0.2))]
    pub recoverable_strain: f64,
    /// `r1`, inner pulley (paper: 4.5e-3).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub inner_pulley_radius_metres: f64,
    /// `r2`, outer pulley (paper: 45e-3).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub outer_pulley_radius_metres: f64,
    /// `J`, inertia of the pulley (assumed: 2e-5).
    #[schemars(range(min = 0.0, max = 1.0))]
    pub pulley_inertia_kilogram_square_metres: f64,
    /// `mL`, load (paper: 0.04).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub load_kilograms: f64,
    /// `c`, damping (assumed: 0.5).
    #[schemars(range(min = 0.0, max = 100.0))]
    pub damping_newton_seconds_per_metre: f64,
}

/// The parameters of the paper's actuator.
impl Default for NominalModel {
    fn default() -> Self {
        Self::from(&Sma::default())
    }
}

/// The model with the plant's numbers. Its equations are those of the plant's simpler law of stress and strain.
impl From<&Sma> for NominalModel {
    fn from(plant: &Sma) -> Self {
        let Sma {
            heat,
            phase,
            mechanics,
            ..
        } = plant;
        Self {
            mass_kilograms_per_metre: heat.mass_kilograms_per_metre,
            specific_heat_joules_per_kilogram_kelvin: heat.specific_heat_joules_per_kilogram_kelvin,
            resistance_ohms_per_metre: heat.resistance_ohms_per_metre,
            surface_square_metres_per_metre: heat.surface_square_metres_per_metre,
            convection_watts_per_square_metre_kelvin: heat.convection_watts_per_square_metre_kelvin,
            conduction_watts_per_metre_kelvin: heat.conduction_watts_per_metre_kelvin,
            ambient_celsius: heat.ambient_celsius,
            cooling_element_celsius: heat.cooling_element_celsius,
            austenite_start_celsius: phase.austenite_start_celsius,
            austenite_finish_celsius: phase.austenite_finish_celsius,
            martensite_start_celsius: phase.martensite_start_celsius,
            martensite_finish_celsius: phase.martensite_finish_celsius,
            austenite_modulus_pascals: mechanics.austenite_modulus_pascals,
            wire_diameter_metres: mechanics.wire_diameter_metres,
            wire_length_metres: mechanics.wire_length_metres,
            recoverable_strain: mechanics.recoverable_strain,
            inner_pulley_radius_metres: mechanics.inner_pulley_radius_metres,
            outer_pulley_radius_metres: mechanics.outer_pulley_radius_metres,
            pulley_inertia_kilogram_square_metres: mechanics.pulley_inertia_kilogram_square_metres,
            load_kilograms: mechanics.load_kilograms,
            damping_newton_seconds_per_metre: mechanics.damping_newton_seconds_per_metre,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the parameters of a model as a scenario has them.
    fn parameters(model: &NominalModel) -> toml::Table {
        toml::Table::try_from(model).unwrap()
    }

    #[test]
    fn the_model_of_a_plant_has_the_numbers_of_the_plant() {
        let plant = Sma::default();
        let tables = toml::Table::try_from(&plant).unwrap();
        let parts = ["heat", "phase", "mechanics"].map(|part| &tables[part]);
        for (key, value) in parameters(&NominalModel::from(&plant)) {
            let numbers = parts.iter().filter_map(|part| part.get(&key));
            assert_eq!(Vec::from_iter(numbers), [&value], "{key}");
        }
    }

    #[test]
    fn the_nominal_plant_gives_the_nominal_model() {
        let of_paper = "mass_kilograms_per_metre = 2e-4\nspecific_heat_joules_per_kilogram_kelvin = 837.0\n\
            resistance_ohms_per_metre = 32.0\nsurface_square_metres_per_metre = 6.28e-4\n\
            convection_watts_per_square_metre_kelvin = 7.0\nconduction_watts_per_metre_kelvin = 0.255\n\
            ambient_celsius = 20.0\ncooling_element_celsius = 15.0\naustenite_start_celsius = 53.0\n\
            austenite_finish_celsius = 93.0\nmartensite_start_celsius = 66.0\nmartensite_finish_celsius = 34.0\n\
            austenite_modulus_pascals = 75e9\nwire_diameter_metres = 2e-4\nwire_length_metres = 0.15\n\
            recoverable_strain = 0.04\ninner_pulley_radius_metres = 4.5e-3\nouter_pulley_radius_metres = 45e-3\n\
            pulley_inertia_kilogram_square_metres = 2e-5\nload_kilograms = 0.04\ndamping_newton_seconds_per_metre = 0.5\n";
        let model = parameters(&NominalModel::default());
        assert_eq!(model, of_paper.parse::<toml::Table>().unwrap());
    }
}
