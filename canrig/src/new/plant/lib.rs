//! my_plant: a block that a current heats and a fan cools. Put your physics in its place.

use plant_emulator::integrator::runge_kutta_4;
use plant_emulator::plant::{InvalidPlant, Plant, Port, Ports, follows, positive};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Longest integration step.
const STEP_SECONDS_MAX: f64 = 1e-2;

/// Indices of the inputs.
const HEATER_CURRENT: usize = 0;
const CONVECTION_FACTOR: usize = 1;

/// The table `[plant.NAME.my_plant]` of a rig file. All values are assumed.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Resistance of the heater.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub heater_ohms: f64,
    /// Heat capacity of the block.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub block_joules_per_kelvin: f64,
    /// Heat that goes from the block to its housing.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub block_watts_per_kelvin: f64,
    /// Heat capacity of the housing.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub housing_joules_per_kelvin: f64,
    /// Heat that the housing loses to still air.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub housing_watts_per_kelvin: f64,
    /// Temperature of the air.
    #[schemars(range(min = -50.0, max = 200.0))]
    pub ambient_celsius: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            heater_ohms: 40.0,
            block_joules_per_kelvin: 2.0,
            block_watts_per_kelvin: 0.5,
            housing_joules_per_kelvin: 10.0,
            housing_watts_per_kelvin: 0.5,
            ambient_celsius: 20.0,
        }
    }
}

/// The plant: its parameters, and its state.
#[derive(Clone, Debug)]
pub struct MyPlant {
    config: Config,
    block_celsius: f64,
    housing_celsius: f64,
    /// Heating power during the latest step.
    heater_watts: f64,
}

impl MyPlant {
    /// Returns `[dT/dt of the block, dT/dt of the housing]`.
    fn derivative(&self, &[block, housing]: &[f64; 2], factor: f64) -> [f64; 2] {
        let config = &self.config;
        let across = config.block_watts_per_kelvin * (block - housing);
        let lost = config.housing_watts_per_kelvin * factor * (housing - config.ambient_celsius);
        [
            (self.heater_watts - across) / config.block_joules_per_kelvin,
            (across - lost) / config.housing_joules_per_kelvin,
        ]
    }
}

impl Plant for MyPlant {
    type Config = Config;

    fn name() -> &'static str {
        "my_plant"
    }

    fn new(config: &Config) -> Result<Self, InvalidPlant> {
        positive("block_joules_per_kelvin", config.block_joules_per_kelvin)?;
        let rate = config.block_watts_per_kelvin / config.block_joules_per_kelvin;
        follows("heat", rate, STEP_SECONDS_MAX)?;
        Ok(Self {
            config: config.clone(),
            block_celsius: config.ambient_celsius,
            housing_celsius: config.ambient_celsius,
            heater_watts: 0.0,
        })
    }

    /// The suffix of a name is its unit, a comment the title of its plot.
    fn ports(&self) -> Ports {
        Ports {
            inputs: vec![
                Port::input("heater_current_amperes", [0.0, 1.0]),
                Port::input("convection_factor", [0.0, 30.0]).resting_at(1.0),
            ],
            outputs: vec![
                Port::output("block_celsius", [-50.0, 250.0])
                    .with_comment("Temperature of the block."),
                Port::output("housing_celsius", [-50.0, 250.0])
                    .with_comment("Temperature of the housing."),
                Port::output("heater_watts", [0.0, 100.0]).with_comment("Heat of the current."),
            ],
        }
    }

    /// Values come in the order of the inputs. They are constant during the step.
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        let current = inputs[HEATER_CURRENT];
        self.heater_watts = self.config.heater_ohms * current * current;
        let factor = inputs[CONVECTION_FACTOR];
        let steps = (duration_seconds / STEP_SECONDS_MAX).ceil().max(1.0);
        for _ in 0..steps as u64 {
            let state = [self.block_celsius, self.housing_celsius];
            let step_seconds = duration_seconds / steps;
            [self.block_celsius, self.housing_celsius] =
                runge_kutta_4(state, step_seconds, |_, state| {
                    self.derivative(state, factor)
                });
        }
    }

    /// Values go in the order of the outputs.
    fn read(&self, outputs: &mut [f64]) {
        outputs.copy_from_slice(&[self.block_celsius, self.housing_celsius, self.heater_watts]);
    }

    /// Temperature of the part that the current at an input heats.
    fn heated_celsius(&self, _input: usize) -> Option<f64> {
        Some(self.block_celsius)
    }
}

// The plant in the FMU that `fmu --export my_plant` writes.
fmu_plants::export!(MyPlant);

#[cfg(test)]
mod tests {
    use super::*;

    fn plant() -> MyPlant {
        MyPlant::new(&Config::default()).expect("the parameters make sense")
    }

    fn read(plant: &MyPlant) -> [f64; 3] {
        let mut outputs = [0.0; 3];
        plant.read(&mut outputs);
        outputs
    }

    #[test]
    fn the_block_warms_up_to_where_the_air_cools_it() {
        let mut plant = plant();
        plant.step(2000.0, &[0.5, 1.0]);
        let [block, housing, watts] = read(&plant);
        assert!((watts - 10.0).abs() < 1e-9);
        assert!((housing - 40.0).abs() < 1e-3 && (block - 60.0).abs() < 1e-3);
    }

    #[test]
    fn many_short_steps_come_to_the_same_as_one_long_one() {
        let (mut short, mut long) = (plant(), plant());
        for _ in 0..1000 {
            short.step(1e-3, &[0.4, 2.0]);
        }
        long.step(1.0, &[0.4, 2.0]);
        for (short, long) in read(&short).into_iter().zip(read(&long)) {
            assert!((short - long).abs() < 1e-6);
        }
    }

    #[test]
    fn a_plant_that_is_too_fast_is_refused() {
        let config = Config {
            block_joules_per_kelvin: 1e-6,
            ..Config::default()
        };
        assert!(MyPlant::new(&config).is_err());
    }
}
