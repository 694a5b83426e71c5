//! The SMA actuator's parameters: `[plant.NAME.sma]` of a rig file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The shape-memory-alloy actuator.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sma {
    /// Rule by which the phase transformation follows turns of the temperature.
    pub kinetics: Kinetics,
    /// Heat balance of the wire, Eq. (1).
    pub heat: Heat,
    /// Phase transformation, Eq. (2).
    pub phase: Phase,
    /// Wire mechanics and motion, Eq. (3)-(9).
    pub mechanics: Mechanics,
}

/// Rule by which the phase transformation follows turns of the temperature. All are the same in the first heating and in every
/// first cooling.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kinetics {
    /// Eq. (2) from the last turn on; the turns before it are forgotten, so inner loops drift.
    #[default]
    Paper,
    /// Eq. (2), scaled between the last two turns, so inner loops close.
    Nested,
    /// Preisach's model with the first cooling curves of Eq. (2), so inner loops close and are congruent.
    Preisach,
}

impl Kinetics {
    /// Checks whether inner turns are remembered until the temperature passes them.
    pub fn remembers_turns(self) -> bool {
        self != Self::Paper
    }

    /// Returns the temperatures, each with its name, that keep a wire above `Mf` although its memory of turns begins with all
    /// martensite.
    pub fn too_warm(self, heat: &Heat, phase: &Phase) -> impl Iterator<Item = (&'static str, f64)> {
        let (remembers, highest) = (self.remembers_turns(), phase.martensite_finish_celsius);
        let temperatures = [
            ("ambient_celsius", heat.ambient_celsius),
            ("cooling_element_celsius", heat.cooling_element_celsius),
        ];
        temperatures
            .into_iter()
            .filter(move |(_, celsius)| remembers && *celsius > highest)
    }
}

impl Phase {
    /// Returns the pairs of temperatures, each with its name, of which the first is not above the second: Eq. (2) divides by their
    /// differences.
    pub fn out_of_order(&self) -> impl Iterator<Item = [(&'static str, f64); 2]> {
        let austenite_start = ("austenite_start_celsius", self.austenite_start_celsius);
        let austenite_finish = ("austenite_finish_celsius", self.austenite_finish_celsius);
        let martensite_start = ("martensite_start_celsius", self.martensite_start_celsius);
        let martensite_finish = ("martensite_finish_celsius", self.martensite_finish_celsius);
        let pairs = [
            [austenite_finish, austenite_start],
            [martensite_start, martensite_finish],
        ];
        pairs
            .into_iter()
            .filter(|[(_, high), (_, low)]| high <= low)
    }
}

/// Heat balance of the wire, Eq. (1); all per metre of wire.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Heat {
    /// `m`, mass of the wire (paper: 2e-4).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub mass_kilograms_per_metre: f64,
    /// `cp`, specific heat (paper: 837).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub specific_heat_joules_per_kilogram_kelvin: f64,
    /// `L`, latent heat of the transformation: taken up while heating, given off while cooling (paper: left out; the maker of
    /// such wires: 24000).
    #[schemars(range(min = 0.0, max = 1_000_000.0))]
    pub latent_heat_joules_per_kilogram: f64,
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
    #[schemars(range(min = 0.0, max = 100.0))]
    pub conduction_watts_per_metre_kelvin: f64,
    /// `Tamb`, ambient temperature (paper: 20).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub ambient_celsius: f64,
    /// `Tp`, surface of the cooling element (paper: 15).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub cooling_element_celsius: f64,
}

impl Default for Heat {
    fn default() -> Self {
        Self {
            mass_kilograms_per_metre: 2e-4,
            specific_heat_joules_per_kilogram_kelvin: 837.0,
            latent_heat_joules_per_kilogram: 0.0,
            resistance_ohms_per_metre: 32.0,
            surface_square_metres_per_metre: 6.28e-4,
            convection_watts_per_square_metre_kelvin: 7.0,
            conduction_watts_per_metre_kelvin: 0.255,
            ambient_celsius: 20.0,
            cooling_element_celsius: 15.0,
        }
    }
}

/// Phase transformation, Eq. (2).
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Phase {
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
}

impl Default for Phase {
    fn default() -> Self {
        Self {
            austenite_start_celsius: 53.0,
            austenite_finish_celsius: 93.0,
            martensite_start_celsius: 66.0,
            martensite_finish_celsius: 34.0,
        }
    }
}

/// Stress-strain law of the wire.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StressStrain {
    /// Eq. (9): martensite carries nothing.
    #[default]
    AusteniteOnly,
    /// Eq. (3)-(5): elastic, then plastic martensite.
    Full,
}

/// Wire mechanics and motion, Eq. (3)-(9).
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mechanics {
    /// Stress-strain law.
    pub stress_strain: StressStrain,
    /// `EA`, Young's modulus of austenite (assumed: 75e9).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e12))]
    pub austenite_modulus_pascals: f64,
    /// `EM`, Young's modulus of martensite, full law only (assumed: 28e9).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e12))]
    pub martensite_modulus_pascals: f64,
    /// `ε_my`, largest elastic strain of martensite, full law only (assumed: 0.0025).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 0.1))]
    pub martensite_yield_strain: f64,
    /// `d`, wire diameter (paper: 2e-4).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 0.01))]
    pub wire_diameter_metres: f64,
    /// `l_wire`, length of the martensitic wire (paper: 0.15).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub wire_length_metres: f64,
    /// `Δ / l_wire`, recoverable strain (paper: 0.04).
    #[schemars(range(min = 0.0, max = 0.1))]
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
    #[schemars(range(min = 0.0, max = 10.0))]
    pub load_kilograms: f64,
    /// `c`, damping (assumed: 0.5).
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub damping_newton_seconds_per_metre: f64,
}

impl Default for Mechanics {
    fn default() -> Self {
        Self {
            stress_strain: StressStrain::AusteniteOnly,
            austenite_modulus_pascals: 75e9,
            martensite_modulus_pascals: 28e9,
            martensite_yield_strain: 0.0025,
            wire_diameter_metres: 2e-4,
            wire_length_metres: 0.15,
            recoverable_strain: 0.04,
            inner_pulley_radius_metres: 4.5e-3,
            outer_pulley_radius_metres: 45e-3,
            pulley_inertia_kilogram_square_metres: 2e-5,
            load_kilograms: 0.04,
            damping_newton_seconds_per_metre: 0.5,
        }
    }
}
