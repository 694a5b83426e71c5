//! my_plant: a voice coil pushes a mass against a spring. Put your physics in its place.

use plant_emulator::integrator::runge_kutta_4;
use plant_emulator::plant::{self, InvalidPlant, Plant, Signal, follows, not_negative, positive};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Longest integration step.
const STEP_SECONDS_MAX: f64 = 1e-3;

/// What acts on the plant: a current, moving air, an added load.
pub type Inputs = plant::Inputs<()>;

/// The table `[plant.my_plant]` of a scenario. All values are assumed.
#[derive(Clone, Debug, Deserialize, JsonSchema, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Force of the coil.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub coil_newtons_per_ampere: f64,
    /// Mass that is moved.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub mass_kilograms: f64,
    /// Spring that pushes it back.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100_000.0))]
    pub spring_newtons_per_metre: f64,
    /// Damping.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub damping_newton_seconds_per_metre: f64,
    /// Resistance of the coil.
    #[schemars(range(min = 0.0, max = 1_000.0))]
    pub coil_resistance_ohms: f64,
    /// Heat capacity of the coil.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10_000.0))]
    pub coil_capacity_joules_per_kelvin: f64,
    /// Heat that the coil loses to still air.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub cooling_watts_per_kelvin: f64,
    /// Temperature of the air.
    #[schemars(range(min = -50.0, max = 200.0))]
    pub ambient_celsius: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            coil_newtons_per_ampere: 12.0,
            mass_kilograms: 0.1,
            spring_newtons_per_metre: 200.0,
            damping_newton_seconds_per_metre: 8.0,
            coil_resistance_ohms: 4.0,
            coil_capacity_joules_per_kelvin: 20.0,
            cooling_watts_per_kelvin: 0.2,
            ambient_celsius: 20.0,
        }
    }
}

/// The plant: its parameters, and what is integrated.
#[derive(Clone, Debug)]
pub struct MyPlant {
    config: Config,
    position_metres: f64,
    velocity_metres_per_second: f64,
    coil_celsius: f64,
}

impl MyPlant {
    /// `(ẋ, ẍ, dT/dt)`.
    fn derivative(&self, &[position, velocity, celsius]: &[f64; 3], inputs: &Inputs) -> [f64; 3] {
        let config = &self.config;
        let force = config.coil_newtons_per_ampere * inputs.current_amperes
            - config.spring_newtons_per_metre * position
            - config.damping_newton_seconds_per_metre * velocity;
        // A scenario may take load away, but never more than half of the mass.
        let mass = config.mass_kilograms;
        let mass = (mass + inputs.added_load_kilograms).max(0.5 * mass);
        let heat = config.coil_resistance_ohms * inputs.current_amperes * inputs.current_amperes;
        let cooling = config.cooling_watts_per_kelvin * inputs.convection_factor;
        let power = heat - cooling * (celsius - config.ambient_celsius);
        let rate = power / config.coil_capacity_joules_per_kelvin;
        [velocity, force / mass, rate]
    }

    fn advance(&mut self, duration_seconds: f64, inputs: &Inputs) {
        let state = [
            self.position_metres,
            self.velocity_metres_per_second,
            self.coil_celsius,
        ];
        let end = runge_kutta_4(state, duration_seconds, |_, state| {
            self.derivative(state, inputs)
        });
        [
            self.position_metres,
            self.velocity_metres_per_second,
            self.coil_celsius,
        ] = end;
        // The stop at 0 takes all speed away.
        if self.position_metres < 0.0 {
            (self.position_metres, self.velocity_metres_per_second) = (0.0, 0.0);
        }
    }
}

impl Plant for MyPlant {
    const NAME: &'static str = "my_plant";
    type Config = Config;
    type Condition = ();

    /// What the emulated drive sends of the plant at every SYNC: names in recording, report and `[[expect.signal]]`.
    const SIGNALS: &'static [Signal<Self>] = &[
        Signal {
            name: "coil_temperature_celsius",
            unit: "degC",
            comment: "Temperature of the coil.",
            steps_per_unit: 100.0,
            range: [-273.15, 327.67],
            value: |plant| plant.coil_celsius,
        },
        Signal {
            name: "spring_newtons",
            unit: "N",
            comment: "Force of the spring.",
            steps_per_unit: 1000.0,
            range: [0.0, 65.535],
            value: |plant| plant.config.spring_newtons_per_metre * plant.position_metres,
        },
        Signal {
            name: "velocity_metres_per_second",
            unit: "m/s",
            comment: "Velocity of the mass.",
            steps_per_unit: 1000.0,
            range: [-32.768, 32.767],
            value: |plant| plant.velocity_metres_per_second,
        },
    ];

    fn new(config: &Config) -> Result<Self, InvalidPlant> {
        positive("mass_kilograms", config.mass_kilograms)?;
        not_negative(
            "damping_newton_seconds_per_metre",
            config.damping_newton_seconds_per_metre,
        )?;
        let mass = 0.5 * config.mass_kilograms;
        let rate = config.damping_newton_seconds_per_metre / mass
            + (config.spring_newtons_per_metre / mass).sqrt();
        follows("motion", rate, STEP_SECONDS_MAX)?;
        Ok(Self {
            config: config.clone(),
            position_metres: 0.0,
            velocity_metres_per_second: 0.0,
            coil_celsius: config.ambient_celsius,
        })
    }

    fn step(&mut self, duration_seconds: f64, inputs: &Inputs) {
        let steps = (duration_seconds / STEP_SECONDS_MAX).ceil().max(1.0);
        for _ in 0..steps as u64 {
            self.advance(duration_seconds / steps, inputs);
        }
    }

    fn position_metres(&self) -> f64 {
        self.position_metres
    }

    fn temperature_celsius(&self) -> f64 {
        self.coil_celsius
    }
}

// What `fmu --export my_plant` puts into an FMU.
fmu_plants::export!(plant::<MyPlant>);

#[cfg(test)]
mod tests {
    use super::*;

    fn plant(config: &Config) -> MyPlant {
        MyPlant::new(config).expect("the parameters make sense")
    }

    fn current(current_amperes: f64) -> Inputs {
        Inputs {
            current_amperes,
            ..Inputs::default()
        }
    }

    #[test]
    fn the_coil_comes_to_rest_where_the_spring_holds_it() {
        let mut plant = plant(&Config::default());
        plant.step(5.0, &current(0.5));
        let expected = 12.0 * 0.5 / 200.0;
        assert!((plant.position_metres() - expected).abs() < 1e-9);
        plant.step(5.0, &current(0.0));
        assert!(plant.position_metres() < 1e-9);
    }

    #[test]
    fn the_coil_warms_up_to_where_the_air_cools_it() {
        let mut plant = plant(&Config::default());
        plant.step(2000.0, &current(0.5));
        let expected = 20.0 + 4.0 * 0.5 * 0.5 / 0.2;
        assert!((plant.temperature_celsius() - expected).abs() < 1e-3);
    }

    #[test]
    fn many_short_steps_come_to_the_same_as_one_long_one() {
        let (mut short, mut long) = (plant(&Config::default()), plant(&Config::default()));
        for _ in 0..1000 {
            short.step(1e-4, &current(0.4));
        }
        long.step(0.1, &current(0.4));
        assert!((short.position_metres() - long.position_metres()).abs() < 1e-7);
    }

    #[test]
    fn a_plant_that_is_too_fast_is_refused() {
        let config = Config {
            mass_kilograms: 1e-6,
            ..Config::default()
        };
        assert!(MyPlant::new(&config).is_err());
    }
}
