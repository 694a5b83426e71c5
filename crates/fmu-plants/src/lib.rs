//! Plants of the emulator as models of FMUs.
//!
//! Comes in: a [`Plant`], by its parameters' schema, its position, its temperature and its own signals. Goes out: a
//! [`fmu::export::Exported`] model, which steps the plant as the emulator does. Faults are the bench's, so an FMU has none.
//!
//! [`export!`] makes a `cdylib` the library of FMUs: the crate `fmu-library` for the plants that ship, a crate of one's own for its
//! plants.

mod parameters;

use std::marker::PhantomData;

use fmu::StartValue;
use fmu::export::{Exported, Model, ModelVariable, Role, Running};
use fmu::unit::of_name;
use plant_emulator::dc_motor::DcMotor;
use plant_emulator::plant::{Inputs, Plant};
use plant_emulator::sma::Actuator;

#[doc(hidden)]
pub use fmu;
use parameters::Parameters;

/// What acts on every plant: name, what it is, and its value until it is set.
const INPUTS: [(&str, &str, f64); 3] = [
    (
        "current_amperes",
        "Current that the amplifier puts out.",
        0.0,
    ),
    (
        "convection_factor",
        "Multiplies the convection to the air; 1 in still air.",
        1.0,
    ),
    ("added_load_kilograms", "Added to the load.", 0.0),
];

/// Tables of `[plant]` that are the bench's, or another plant's.
const NOT_THE_ACTUATOR_S: [&str; 5] = ["amplifier", "dc_motor", "fmu", "sensor", "sma_pair"];

/// The plants that ship: `sma` and `dc_motor`.
#[must_use]
pub fn shipped() -> Vec<Box<dyn Exported>> {
    vec![
        Box::new(Of::<Actuator> {
            name: "sma",
            description: "A shape-memory-alloy wire that lifts a load by a pulley, by a paper's model.",
            without: &NOT_THE_ACTUATOR_S,
            plant: PhantomData,
        }),
        Box::new(Of::<DcMotor> {
            name: DcMotor::NAME,
            description: "A DC motor that lifts a load through gearbox, pinion and rack, against a spring.",
            without: &[],
            plant: PhantomData,
        }),
    ]
}

/// A plant from outside.
#[must_use]
pub fn own<P: Plant>() -> Box<dyn Exported> {
    Box::new(Of::<P> {
        name: P::NAME,
        description: "",
        without: &[],
        plant: PhantomData,
    })
}

/// Makes a crate of type `cdylib` the library of its plants' FMUs.
#[macro_export]
macro_rules! export {
    ($($plant:ty),+) => {
        const _: () = {
            fn models() -> Vec<Box<dyn $crate::fmu::export::Exported>> {
                vec![$($crate::own::<$plant>()),+]
            }
            $crate::fmu::export!(models);
        };
    };
}

/// A plant as a model.
struct Of<P> {
    name: &'static str,
    description: &'static str,
    /// Tables of its parameters that are left out.
    without: &'static [&'static str],
    plant: PhantomData<fn() -> P>,
}

/// A plant that runs.
struct Runs<P>(P);

impl<P: Plant> Of<P> {
    fn parameters(&self) -> Parameters {
        Parameters::of::<P::Config>(self.without)
    }
}

impl<P: Plant> Exported for Of<P> {
    fn model(&self) -> Model {
        let variable = |name: &str, description: &str, role| ModelVariable {
            name: name.to_owned(),
            description: description.to_owned(),
            unit: of_name(name).map_or("", |known| known.symbol),
            role,
        };
        let mut variables = Vec::from_iter(
            INPUTS
                .map(|(name, description, start)| variable(name, description, Role::Input(start))),
        );
        for (name, description) in [
            ("position_metres", "What the position sensor sees."),
            (
                "temperature_celsius",
                "Temperature of the part that the current heats.",
            ),
        ] {
            variables.push(variable(name, description, Role::Output));
        }
        for signal in P::SIGNALS {
            variables.push(variable(signal.name, signal.comment, Role::Output));
        }
        variables.extend(self.parameters().variables());
        Model {
            name: self.name.to_owned(),
            description: self.description.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            variables,
        }
    }

    fn start(&self, parameters: &[StartValue]) -> Result<Box<dyn Running>, String> {
        let config = self.parameters().read::<P::Config>(parameters)?;
        let plant = P::new(&config).map_err(|error| error.to_string())?;
        Ok(Box::new(Runs(plant)))
    }
}

impl<P: Plant> Running for Runs<P> {
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        if let [current_amperes, convection_factor, added_load_kilograms] = *inputs {
            let inputs = Inputs {
                current_amperes,
                convection_factor,
                added_load_kilograms,
                ..Inputs::default()
            };
            self.0.step(duration_seconds, &inputs);
        }
    }

    fn outputs(&self) -> Vec<f64> {
        let own = P::SIGNALS.iter().map(|signal| (signal.value)(&self.0));
        [self.0.position_metres(), self.0.temperature_celsius()]
            .into_iter()
            .chain(own)
            .collect()
    }
}

#[cfg(test)]
mod tests;
