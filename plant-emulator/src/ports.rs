//! A plant with ports: what the emulator steps, whatever its shape.
//!
//! A plant that was made of its parameters says which quantities act on it and which are seen of it. Drives and io nodes are wired
//! to them by a rig file; what they are wired to is a place in a list from then on, so a cycle looks nothing up.

use std::any::Any;
use std::fmt;

use scenario::fault::Faults;
use scenario::own::Parameters;
pub use scenario::port::{Direction, Port, Ports};

use crate::plant::{Inputs, InvalidPlant, Plant, Signal};

/// What a plant is to the emulator: values by the places of its ports, and time.
///
/// The emulator owns the rest: the drive nodes, sensors, amplifiers, I²t protection, their faults, and when time passes.
pub trait PortedPlant: Any + fmt::Debug + Send {
    /// What acts on it. The list never changes.
    fn inputs(&self) -> &[Port];

    /// What is seen of it. The list never changes.
    fn outputs(&self) -> &[Port];

    /// Lets time pass under constant inputs, which are as many as [`PortedPlant::inputs`] and in their order, a millisecond or less
    /// in most runs. Many short steps come to the same as one long one. Allocates nothing.
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]);

    /// Writes what is seen, as many values as [`PortedPlant::outputs`] and in their order. Allocates nothing.
    fn read(&self, outputs: &mut [f64]);

    /// The temperature of the part that a current at an input heats; none where nobody knows.
    fn heated_celsius(&self, _input: usize) -> Option<f64> {
        None
    }

    /// Whether a current can flow through an input.
    fn conducts(&self, _input: usize) -> bool {
        true
    }

    /// Whether what is wrong with the part behind an input at a scenario time is not what is wrong with it now.
    fn is_condition_new(&self, _input: usize, _faults: &Faults, _time_seconds: f64) -> bool {
        false
    }

    /// From now on that is wrong with the part behind an input which is so at a scenario time.
    fn set_condition(&mut self, _input: usize, _faults: &Faults, _time_seconds: f64) {}

    /// Why it cannot go on, such as a model that ended by itself; none while it can. Numbers that are none are found by the
    /// emulator.
    fn failure(&self) -> Option<&str> {
        None
    }
}

/// A plant with ports that a bench can choose by its name.
pub trait PlantWithPorts: PortedPlant + Sized {
    /// Its name, and that of its table in a rig file and a scenario.
    const NAME: &'static str;

    /// Its parameters: what the table is read into.
    type Config: Parameters;

    /// The kinds of `[[fault.plant.…]]` that its conditions look at; others are refused.
    const FAULTS: &'static [&'static str] = &[];

    /// The plant with these parameters, at rest and undisturbed.
    ///
    /// # Errors
    /// The parameters make no physical sense.
    fn new(config: &Self::Config) -> Result<Self, InvalidPlant>;
}

/// Places of the inputs of a plant of one axis.
pub const CURRENT: usize = 0;
const CONVECTION_FACTOR: usize = 1;
const ADDED_LOAD: usize = 2;

/// What the amplifier of a plant of one axis may put out.
const CURRENT_RANGE: [f64; 2] = [-1.0, 1.0];
/// What the module's outputs of 16 bits can say.
const CONVECTION_RANGE: [f64; 2] = [0.0, 32.767];
const LOAD_RANGE: [f64; 2] = [-3.276_8, 3.276_7];
/// The travel of the rig that ships.
const TRAVEL_METRES: [f64; 2] = [0.0, 0.06];

/// A plant of one axis as one with ports: a current, moving air and an added load act on it; a position and its own signals are
/// seen of it.
#[derive(Clone, Debug)]
pub struct SingleAxis<P: Plant> {
    plant: P,
    condition: P::Condition,
    ports: Ports,
}

impl<P: Plant> SingleAxis<P> {
    /// The plant with its ports, with nothing wrong.
    #[must_use]
    pub fn new(plant: P) -> Self {
        Self {
            plant,
            condition: P::Condition::default(),
            ports: ports_of::<P>(),
        }
    }

    /// The plant itself.
    #[must_use]
    pub fn plant(&self) -> &P {
        &self.plant
    }
}

/// The ports of a plant of one axis.
#[must_use]
pub fn ports_of<P: Plant>() -> Ports {
    let position =
        Port::output("position_metres", TRAVEL_METRES).with_comment("Position of the load.");
    let signals = P::SIGNALS.iter().map(port_of);
    let further = P::FURTHER.iter().map(|signal| Port {
        // A port without a range is not published.
        range: [f64::NEG_INFINITY, f64::INFINITY],
        ..port_of(signal)
    });
    Ports {
        inputs: vec![
            Port::input("current_amperes", CURRENT_RANGE)
                .with_comment("Current that the amplifier puts out."),
            Port::input("convection_factor", CONVECTION_RANGE)
                .resting_at(1.0)
                .with_comment("Multiplies the convection to the air."),
            Port::input("added_load_kilograms", LOAD_RANGE).with_comment("Added to the load."),
        ],
        outputs: [position]
            .into_iter()
            .chain(signals)
            .chain(further)
            .collect(),
    }
}

/// A signal of a plant's own as a port.
fn port_of<P>(signal: &Signal<P>) -> Port {
    let port = Port::output(signal.name, signal.range)
        .in_steps(signal.steps_per_unit)
        .with_comment(signal.comment);
    let unit = port.unit.clone();
    port.with_unit(&unit, signal.unit)
}

impl<P: Plant> PortedPlant for SingleAxis<P> {
    fn inputs(&self) -> &[Port] {
        &self.ports.inputs
    }

    fn outputs(&self) -> &[Port] {
        &self.ports.outputs
    }

    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        let inputs = Inputs {
            current_amperes: inputs[CURRENT],
            convection_factor: inputs[CONVECTION_FACTOR],
            added_load_kilograms: inputs[ADDED_LOAD],
            condition: self.condition,
        };
        self.plant.step(duration_seconds, &inputs);
    }

    fn read(&self, outputs: &mut [f64]) {
        let Some((position, signals)) = outputs.split_first_mut() else {
            return;
        };
        *position = self.plant.position_metres();
        for (value, signal) in signals.iter_mut().zip(P::SIGNALS.iter().chain(P::FURTHER)) {
            *value = (signal.value)(&self.plant);
        }
    }

    fn heated_celsius(&self, _input: usize) -> Option<f64> {
        Some(self.plant.temperature_celsius())
    }

    fn conducts(&self, _input: usize) -> bool {
        P::conducts(&self.condition)
    }

    fn is_condition_new(&self, _input: usize, faults: &Faults, time_seconds: f64) -> bool {
        P::condition(faults, time_seconds) != self.condition
    }

    fn set_condition(&mut self, _input: usize, faults: &Faults, time_seconds: f64) {
        self.condition = P::condition(faults, time_seconds);
    }
}

/// What a drive holds while another drive of the same plant has the plant in hand.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NoPlant;

impl PortedPlant for NoPlant {
    fn inputs(&self) -> &[Port] {
        &[]
    }

    fn outputs(&self) -> &[Port] {
        &[]
    }

    fn step(&mut self, _duration_seconds: f64, _inputs: &[f64]) {}

    fn read(&self, _outputs: &mut [f64]) {}
}
