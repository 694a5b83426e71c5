//! Several plants as one.

use std::ops::Range;

use crate::plant::{Faults, InvalidPlant, Plant, Ports};

/// Plants with ports `PLANT.PORT`, in the order of the plants. They act on each other through nodes only.
#[derive(Debug)]
struct Assembly(Vec<Part>);

#[derive(Debug)]
struct Part {
    name: String,
    plant: Box<dyn Plant>,
    /// Indices of its ports in the assembly.
    inputs: Range<usize>,
    outputs: Range<usize>,
}

/// Joins plants to one. A single plant is returned itself.
pub(crate) fn of(mut plants: Vec<(String, Box<dyn Plant>)>) -> Box<dyn Plant> {
    if let [_] = plants.as_slice()
        && let Some((_, only)) = plants.pop()
    {
        return only;
    }
    let (mut inputs, mut outputs) = (0, 0);
    let parts = plants.into_iter().map(|(name, plant)| {
        let ports = plant.ports();
        let [first_input, first_output] = [inputs, outputs];
        inputs += ports.inputs.len();
        outputs += ports.outputs.len();
        Part {
            name,
            plant,
            inputs: first_input..inputs,
            outputs: first_output..outputs,
        }
    });
    Box::new(Assembly(parts.collect()))
}

impl Assembly {
    /// Returns the plant of an input, and the index of the input there.
    fn at(&self, input: usize) -> Option<(&dyn Plant, usize)> {
        let part = self.0.iter().find(|part| part.inputs.contains(&input))?;
        Some((&*part.plant, input - part.inputs.start))
    }
}

impl Plant for Assembly {
    type Config = ();

    fn name() -> &'static str {
        "assembly"
    }

    fn new((): &()) -> Result<Self, InvalidPlant> {
        Ok(Self(Vec::new()))
    }

    fn ports(&self) -> Ports {
        let parts = self.0.iter();
        Ports::joined(parts.map(|part| (part.name.as_str(), part.plant.ports())))
    }

    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        for part in &mut self.0 {
            let inputs = &inputs[part.inputs.clone()];
            part.plant.step(duration_seconds, inputs);
        }
    }

    fn read(&self, outputs: &mut [f64]) {
        for part in &self.0 {
            part.plant.read(&mut outputs[part.outputs.clone()]);
        }
    }

    fn heated_celsius(&self, input: usize) -> Option<f64> {
        let (plant, input) = self.at(input)?;
        plant.heated_celsius(input)
    }

    fn conducts(&self, input: usize) -> bool {
        self.at(input)
            .is_none_or(|(plant, input)| plant.conducts(input))
    }

    fn is_condition_new(&self, input: usize, faults: &Faults, time_seconds: f64) -> bool {
        self.at(input)
            .is_some_and(|(plant, input)| plant.is_condition_new(input, faults, time_seconds))
    }

    fn set_condition(&mut self, input: usize, faults: &Faults, time_seconds: f64) {
        let mut parts = self.0.iter_mut();
        if let Some(part) = parts.find(|part| part.inputs.contains(&input)) {
            let input = input - part.inputs.start;
            part.plant.set_condition(input, faults, time_seconds);
        }
    }

    fn failure(&self) -> Option<&str> {
        self.0.iter().find_map(|part| part.plant.failure())
    }
}
