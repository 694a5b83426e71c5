//! Plants of the emulator as models of FMUs.
//!
//! Comes in: a [`Plant`] or a [`PlantWithPorts`], by its parameters' schema and its ports. Goes out: a [`fmu::export::Exported`]
//! model, which steps the plant as the emulator does. Faults are the bench's, so an FMU has none.
//!
//! [`export!`] makes a `cdylib` the library of FMUs: the crate `fmu-library` for the plants that ship, a crate of one's own for its
//! plants.

mod parameters;

use fmu::StartValue;
use fmu::export::{Exported, Model, ModelVariable, Role, Running};
use fmu::unit::of_name;
use plant_emulator::dc_motor::DcMotor;
use plant_emulator::plant::{InvalidPlant, Plant};
use plant_emulator::ports::{CURRENT, PlantWithPorts, Port, PortedPlant, SingleAxis};
use plant_emulator::sma::Actuator;
use plant_emulator::sma::pair::SmaPair;
use scenario::own;

#[doc(hidden)]
pub use fmu;
use parameters::Parameters;

/// Tables of `[plant]` that are the bench's, or another plant's.
const NOT_THE_ACTUATOR_S: [&str; 5] = ["amplifier", "dc_motor", "fmu", "sensor", "sma_pair"];

/// The plants that ship: `sma`, `dc_motor` and `sma_pair`.
#[must_use]
pub fn shipped() -> Vec<Box<dyn Exported>> {
    vec![
        Box::new(Of {
            name: "sma",
            description: "A shape-memory-alloy wire that lifts a load by a pulley, by a paper's model.",
            without: &NOT_THE_ACTUATOR_S,
            ..of_one_axis::<Actuator>()
        }),
        Box::new(Of {
            description: "A DC motor that lifts a load through gearbox, pinion and rack, against a spring.",
            ..of_one_axis::<DcMotor>()
        }),
        Box::new(Of {
            description: "A joint that two shape-memory-alloy wires turn, one each way.",
            ..with_ports::<SmaPair>()
        }),
    ]
}

/// A plant from outside.
#[must_use]
pub fn plant<P: Plant>() -> Box<dyn Exported> {
    Box::new(of_one_axis::<P>())
}

/// A plant with ports from outside.
#[must_use]
pub fn plant_with_ports<P: PlantWithPorts>() -> Box<dyn Exported> {
    Box::new(with_ports::<P>())
}

/// Makes a crate of type `cdylib` the library of its plants' FMUs, which are named as the bench's are:
/// `export!(plant::<Motor>, plant_with_ports::<Heater>)`.
#[macro_export]
macro_rules! export {
    ($($kind:ident::<$plant:ty>),+ $(,)?) => {
        const _: () = {
            fn models() -> Vec<Box<dyn $crate::fmu::export::Exported>> {
                vec![$($crate::$kind::<$plant>()),+]
            }
            $crate::fmu::export!(models);
        };
    };
}

/// A plant as a model.
struct Of<C> {
    name: &'static str,
    description: &'static str,
    /// Tables of its parameters that are left out.
    without: &'static [&'static str],
    /// What is seen of it beside its ports: names, and the inputs whose currents heat what they are the temperatures of.
    heated: &'static [(&'static str, usize)],
    make: fn(&C) -> Result<Box<dyn PortedPlant>, InvalidPlant>,
}

fn of_one_axis<P: Plant>() -> Of<P::Config> {
    Of {
        name: P::NAME,
        description: "",
        without: &[],
        heated: &[("temperature_celsius", CURRENT)],
        make: |config| Ok(Box::new(SingleAxis::new(P::new(config)?))),
    }
}

fn with_ports<P: PlantWithPorts>() -> Of<P::Config> {
    Of {
        name: P::NAME,
        description: "",
        without: &[],
        heated: &[],
        make: |config| Ok(Box::new(P::new(config)?)),
    }
}

impl<C: own::Parameters> Of<C> {
    fn parameters(&self) -> Parameters {
        Parameters::of::<C>(self.without)
    }

    fn made(&self, parameters: &[StartValue]) -> Result<Box<dyn PortedPlant>, String> {
        let config = self.parameters().read::<C>(parameters)?;
        (self.make)(&config).map_err(|error| error.to_string())
    }
}

impl<C: own::Parameters> Exported for Of<C> {
    fn name(&self) -> &str {
        self.name
    }

    /// Its ports are those that it has by its defaults.
    fn model(&self) -> Result<Model, String> {
        let parameters = self.parameters();
        let plant = self.made(&Vec::from_iter(parameters.defaults()))?;
        let inputs = plant.inputs().iter();
        let inputs = inputs.map(|port| of_port(port, Role::Input(port.at_rest)));
        let outputs = plant.outputs().iter();
        let outputs = outputs.map(|port| of_port(port, Role::Output));
        let heated = self.heated.iter().map(|(name, _)| ModelVariable {
            name: (*name).to_owned(),
            description: "Temperature of the part that the current heats.".to_owned(),
            unit: of_name(name).map_or("", |known| known.symbol),
            role: Role::Output,
        });
        let seen = inputs.chain(outputs).chain(heated);
        Ok(Model {
            name: self.name.to_owned(),
            description: self.description.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            variables: seen.chain(parameters.variables()).collect(),
        })
    }

    fn start(&self, parameters: &[StartValue]) -> Result<Box<dyn Running>, String> {
        let plant = self.made(parameters)?;
        let described = self.made(&Vec::from_iter(self.parameters().defaults()))?;
        if !has_the_ports_of(&*plant, &*described) {
            return Err(
                "with these parameters it has other ports than it was exported with".to_owned(),
            );
        }
        Ok(Box::new(Runs {
            heated: self.heated,
            plant,
        }))
    }
}

/// Whether two plants have ports of the same names.
fn has_the_ports_of(one: &dyn PortedPlant, other: &dyn PortedPlant) -> bool {
    let names = |plant: &dyn PortedPlant| {
        let names = |ports: &[Port]| Vec::from_iter(ports.iter().map(|port| port.name.clone()));
        [names(plant.inputs()), names(plant.outputs())]
    };
    names(one) == names(other)
}

fn of_port(port: &Port, role: Role) -> ModelVariable {
    ModelVariable {
        name: port.name.clone(),
        description: port.comment.clone(),
        unit: of_name(&port.name).map_or("", |known| known.symbol),
        role,
    }
}

/// A plant that runs.
struct Runs {
    plant: Box<dyn PortedPlant>,
    heated: &'static [(&'static str, usize)],
}

impl Running for Runs {
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        self.plant.step(duration_seconds, inputs);
    }

    fn outputs(&self) -> Vec<f64> {
        let mut outputs = vec![0.0; self.plant.outputs().len()];
        self.plant.read(&mut outputs);
        let heated = self.heated.iter();
        outputs
            .extend(heated.map(|(_, input)| self.plant.heated_celsius(*input).unwrap_or(f64::NAN)));
        outputs
    }
}

#[cfg(test)]
mod tests;
