//! The DC motor's parameters: `[plant.dc_motor]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A DC motor lifts a load through gearbox, pinion and rack, against a spring. The motor is a maxon RE 25, 118743
/// (12 V, 10 W, graphite brushes); its values are the data sheet's, all others are assumed.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct DcMotor {
    /// `kM`, torque constant (data sheet: 23.5e-3).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub torque_constant_newton_metres_per_ampere: f64,
    /// `JR`, inertia of the rotor (data sheet: 10.8e-7).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub rotor_inertia_kilogram_square_metres: f64,
    /// `MC`, Coulomb friction of the motor (assumed: 4e-4, of the 6.18e-4 that the data sheet's no-load current of
    /// 26.3 mA makes at 4850 rpm).
    #[schemars(range(min = 0.0, max = 10.0))]
    pub coulomb_friction_newton_metres: f64,
    /// `b`, viscous friction of the motor (assumed: 4.3e-7, the rest of the no-load torque).
    #[schemars(range(min = 0.0, max = 1.0))]
    pub viscous_friction_newton_metre_seconds: f64,
    /// `n`, revolutions of the motor for one of the pinion (assumed: 13.8, a planetary gearhead of two stages).
    #[schemars(range(min = 1.0, max = 10_000.0))]
    pub gear_ratio: f64,
    /// `JG`, inertia of the gearbox, seen by the motor (assumed: 8e-8).
    #[schemars(range(min = 0.0, max = 1.0))]
    pub gear_inertia_kilogram_square_metres: f64,
    /// `MG`, Coulomb friction of the gearbox, at the pinion (assumed: 0.02).
    #[schemars(range(min = 0.0, max = 100.0))]
    pub gear_friction_newton_metres: f64,
    /// `r`, pitch radius of the pinion (assumed: 0.01).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1.0))]
    pub pinion_radius_metres: f64,
    /// `xmax`, travel of the rack from its lower stop to its upper one (assumed: 0.06, as the paper's actuator).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub travel_metres: f64,
    /// `k`, stiffness of the spring; it is relaxed where the rack rests on its lower stop (assumed: 300).
    #[schemars(range(min = 0.0, max = 1e6))]
    pub spring_newtons_per_metre: f64,
    /// `mL`, load with rack (assumed: 0.2).
    #[schemars(range(min = 0.0, max = 100.0))]
    pub load_kilograms: f64,
    /// `R25`, resistance of the winding at 25 °C (data sheet: 2.18).
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub winding_resistance_ohms: f64,
    /// `Rth2`, from winding to housing (data sheet: 3.1).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub winding_to_housing_kelvins_per_watt: f64,
    /// `Rth1`, from housing to ambient in still air; a fan divides it (data sheet: 14).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub housing_to_ambient_kelvins_per_watt: f64,
    /// `τw`, thermal time constant of the winding (data sheet: 12).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100_000.0))]
    pub winding_time_constant_seconds: f64,
    /// `τs`, thermal time constant of the motor (data sheet: 612).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100_000.0))]
    pub motor_time_constant_seconds: f64,
    /// `Tamb`, ambient temperature (data sheet: 25).
    #[schemars(range(min = -50.0, max = 200.0))]
    pub ambient_celsius: f64,
}

impl Default for DcMotor {
    fn default() -> Self {
        Self {
            torque_constant_newton_metres_per_ampere: 23.5e-3,
            rotor_inertia_kilogram_square_metres: 10.8e-7,
            coulomb_friction_newton_metres: 4e-4,
            viscous_friction_newton_metre_seconds: 4.3e-7,
            gear_ratio: 13.8,
            gear_inertia_kilogram_square_metres: 8e-8,
            gear_friction_newton_metres: 0.02,
            pinion_radius_metres: 0.01,
            travel_metres: 0.06,
            spring_newtons_per_metre: 300.0,
            load_kilograms: 0.2,
            winding_resistance_ohms: 2.18,
            winding_to_housing_kelvins_per_watt: 3.1,
            housing_to_ambient_kelvins_per_watt: 14.0,
            winding_time_constant_seconds: 12.0,
            motor_time_constant_seconds: 612.0,
            ambient_celsius: 25.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::Trial;

    fn parsed(more: &str) -> Result<Trial, crate::ScenarioError> {
        let head = "schema = 1\nrig = \"dc_motor\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n";
        let text = format!("{head}{more}");
        Trial::parse(&text, "t.toml", |_| unreachable!("no table"))
    }

    #[test]
    fn a_fault_of_a_wire_is_refused() {
        let error = parsed("[[fault.plant.broken_wire]]\nfrom_seconds = 1.0\n").unwrap_err();
        let error = format!("{:?}", miette::Report::new(error));
        assert!(error.contains("the plant"), "{error}");
    }

    #[test]
    fn the_motor_s_load_is_the_one_that_disturbances_take_away() {
        let load = "[[disturbance.load]]\nat_seconds = 1.0\nadded_grams = ";
        assert!(parsed(&format!("{load}-199.0\n")).is_ok());
        assert!(parsed(&format!("{load}-200.0\n")).is_err());
    }
}
