//! Temperatures of the motor: winding and housing, the two bodies in its data sheet.

use scenario::plant::DcMotor;

use crate::integrator::runge_kutta_4;
use crate::plant::Inputs;

/// Temperature coefficient of copper, 1/K.
const COPPER_PER_KELVIN: f64 = 0.003_93;
/// Temperature of the winding's resistance in the data sheet.
const REFERENCE_CELSIUS: f64 = 25.0;

/// The heat balance and its state.
#[derive(Clone, Debug)]
pub(super) struct Heat {
    /// Resistance of the winding at 25 °C, `R25`, Ω.
    resistance: f64,
    /// Conductance from winding to housing, `1 / Rth2`, W/K.
    winding_conductance: f64,
    /// Conductance from housing to still air, `1 / Rth1`, W/K.
    housing_conductance: f64,
    /// Heat capacity of the winding, `τw / Rth2`, J/K.
    winding_capacity: f64,
    /// Heat capacity of the housing, `τs / Rth1`, J/K.
    housing_capacity: f64,
    ambient_celsius: f64,
    pub(super) winding_celsius: f64,
    pub(super) housing_celsius: f64,
}

impl Heat {
    /// Makes a motor as warm as the air.
    pub(super) fn new(config: &DcMotor) -> Self {
        Self {
            resistance: config.winding_resistance_ohms,
            winding_conductance: 1.0 / config.winding_to_housing_kelvins_per_watt,
            housing_conductance: 1.0 / config.housing_to_ambient_kelvins_per_watt,
            winding_capacity: config.winding_time_constant_seconds
                / config.winding_to_housing_kelvins_per_watt,
            housing_capacity: config.motor_time_constant_seconds
                / config.housing_to_ambient_kelvins_per_watt,
            ambient_celsius: config.ambient_celsius,
            winding_celsius: config.ambient_celsius,
            housing_celsius: config.ambient_celsius,
        }
    }

    /// Takes one step of both balances.
    pub(super) fn step(&mut self, duration_seconds: f64, inputs: &Inputs) {
        let state = [self.winding_celsius, self.housing_celsius];
        [self.winding_celsius, self.housing_celsius] =
            runge_kutta_4(state, duration_seconds, |_, state| {
                self.rates(state, inputs)
            });
    }

    /// Returns `Cw dTw/dt = R(Tw) i² − (Tw − Ts) / Rth2` and `Cs dTs/dt = (Tw − Ts) / Rth2 − f (Ts − Tamb) / Rth1`, in
    /// K/s.
    fn rates(&self, &[winding, housing]: &[f64; 2], inputs: &Inputs) -> [f64; 2] {
        let resistance =
            self.resistance * (1.0 + COPPER_PER_KELVIN * (winding - REFERENCE_CELSIUS));
        let heating = resistance * inputs.current_amperes * inputs.current_amperes;
        let to_housing = self.winding_conductance * (winding - housing);
        let to_air =
            inputs.convection_factor * self.housing_conductance * (housing - self.ambient_celsius);
        [
            (heating - to_housing) / self.winding_capacity,
            (to_housing - to_air) / self.housing_capacity,
        ]
    }

    /// Returns an upper bound of the balances' rates, at the strongest fan that the bus can command.
    pub(super) fn fastest_rate_per_second(&self) -> f64 {
        let housing = self.winding_conductance
            + crate::plants::sma::CONVECTION_FACTOR_MAX * self.housing_conductance;
        (self.winding_conductance / self.winding_capacity).max(housing / self.housing_capacity)
    }
}
