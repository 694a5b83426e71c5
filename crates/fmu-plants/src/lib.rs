//! Plants of the emulator as models of FMUs.
//!
//! The input is a [`Plant`], with the schema of its parameters and its ports. The output is a [`fmu::export::Exported`]
//! model, which steps the plant as the emulator does. Faults belong to the bench, so an FMU has none.
//!
//! [`export!`] makes a `cdylib` the library of FMUs: the crate `fmu-library` for the plants that ship, a custom crate
//! for its plants.

mod parameters;

use std::marker::PhantomData;

use fmu::StartValue;
use fmu::export::{Exported, Model, ModelVariable, Role, Running};
use fmu::unit::unit_in_name;
use plant_emulator::plant::{Plant, Port, Ports};
use plant_emulator::plants::dc_motor::DcMotor;
use plant_emulator::plants::sma::Actuator;
use plant_emulator::plants::sma::pair::SmaPair;

#[doc(hidden)]
pub use fmu;
use parameters::Parameters;

/// Returns the plants that ship: `sma`, `dc_motor` and `sma_pair`.
pub fn shipped() -> Vec<Box<dyn Exported>> {
    vec![
        Box::new(Of::<Actuator> {
            name: "sma",
            description: "A shape-memory-alloy wire that lifts a load by a pulley, by a paper's model.",
            ..Of::new()
        }),
        Box::new(Of::<DcMotor> {
            description: "A DC motor that lifts a load through gearbox, pinion and rack, against a spring.",
            ..Of::new()
        }),
        Box::new(Of::<SmaPair> {
            description: "A joint that two shape-memory-alloy wires turn, one each way.",
            ..Of::new()
        }),
    ]
}

/// Returns the model of a custom plant.
pub fn plant<P: Plant>() -> Box<dyn Exported> {
    Box::new(Of::<P>::new())
}

/// Makes a crate of type `cdylib` the library of its plants' FMUs: `export!(Motor, Heater)`.
#[macro_export]
macro_rules! export {
    ($($plant:ty),+ $(,)?) => {
        const _: () = {
            fn models() -> Vec<Box<dyn $crate::fmu::export::Exported>> {
                vec![$($crate::plant::<$plant>()),+]
            }
            $crate::fmu::export!(models);
        };
    };
}

/// A plant as a model.
struct Of<P> {
    name: &'static str,
    description: &'static str,
    plant: PhantomData<fn() -> P>,
}

impl<P: Plant> Of<P> {
    fn new() -> Self {
        Self {
            name: P::name(),
            description: "",
            plant: PhantomData,
        }
    }

    fn parameters() -> Parameters {
        Parameters::of::<P::Config>()
    }

    fn made(parameters: &[StartValue]) -> Result<P, String> {
        let config = Self::parameters().read::<P::Config>(parameters)?;
        P::new(&config).map_err(|error| error.to_string())
    }

    /// Returns the ports by the defaults of all parameters.
    fn ports() -> Result<Ports, String> {
        let defaults = Vec::from_iter(Self::parameters().defaults());
        Ok(Self::made(&defaults)?.ports())
    }
}

impl<P: Plant> Exported for Of<P> {
    fn name(&self) -> &str {
        self.name
    }

    fn model(&self) -> Result<Model, String> {
        let Ports { inputs, outputs } = Self::ports()?;
        let parameters = Self::parameters();
        let seen = outputs.iter().map(|port| variable(port, Role::Output));
        let acting = inputs
            .iter()
            .map(|port| variable(port, Role::Input(port.at_rest)));
        Ok(Model {
            name: self.name.to_owned(),
            description: self.description.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            variables: acting.chain(seen).chain(parameters.variables()).collect(),
        })
    }

    fn start(&self, parameters: &[StartValue]) -> Result<Box<dyn Running>, String> {
        let plant = Self::made(parameters)?;
        if !have_the_same_names(&plant.ports(), &Self::ports()?) {
            return Err(
                "with these parameters it has other ports than it was exported with".to_owned(),
            );
        }
        Ok(Box::new(Runs {
            outputs: plant.ports().outputs.len(),
            plant,
        }))
    }
}

fn have_the_same_names(one: &Ports, other: &Ports) -> bool {
    let names = |ports: &Ports| {
        let names = |ports: &[Port]| Vec::from_iter(ports.iter().map(|port| port.name.clone()));
        [names(&ports.inputs), names(&ports.outputs)]
    };
    names(one) == names(other)
}

fn variable(port: &Port, role: Role) -> ModelVariable {
    ModelVariable {
        name: port.name.clone(),
        description: port.comment.clone(),
        unit: unit_in_name(&port.name).map_or("", |known| known.symbol),
        role,
    }
}

/// An instance of a plant, and the number of its outputs.
struct Runs<P> {
    plant: P,
    outputs: usize,
}

impl<P: Plant> Running for Runs<P> {
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        self.plant.step(duration_seconds, inputs);
    }

    fn outputs(&self) -> Vec<f64> {
        let mut outputs = vec![0.0; self.outputs];
        self.plant.read(&mut outputs);
        outputs
    }
}

#[cfg(test)]
mod tests;
