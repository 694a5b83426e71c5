//! The trait of all plants, and the ports of a plant of one axis.

use std::any::Any;
use std::{fmt, io};

pub use dbc::{Port, Ports};
use scenario::custom::Parameters;
pub use scenario::custom::WrongParameter;
pub use scenario::fault::Faults;

/// A plant. It is made from parameters, and then exchanges values at named ports.
///
/// Values are in the order of the ports; a rig file wires drives and io nodes to them. The emulator does everything
/// else: the drive nodes, sensors, amplifiers, I²t protection, their faults, and the passing of time. A plant of one
/// axis has the ports of [`one_axis`].
pub trait Plant: Any + fmt::Debug + Send {
    /// Parameters of the plant, read from the scenario's table.
    type Config: Parameters
    where
        Self: Sized;

    /// Returns the name of the plant and of its table in a scenario or a rig file.
    fn name() -> &'static str
    where
        Self: Sized;

    /// Returns the kinds of `[[fault.plant.…]]` that its condition supports; others are refused. For a plant whose table the
    /// scenario format has, the format lists them, and this is not asked.
    fn faults() -> &'static [&'static str]
    where
        Self: Sized,
    {
        &[]
    }

    /// Makes the plant with these parameters, at rest, without current and undisturbed.
    ///
    /// # Errors
    /// The parameters make no physical sense.
    fn new(config: &Self::Config) -> Result<Self, InvalidPlant>
    where
        Self: Sized;

    /// Returns the ports of the plant with these parameters. A plant that needs more than memory to be made implements
    /// it.
    ///
    /// # Errors
    /// As [`Plant::new`].
    fn ports_by(config: &Self::Config) -> Result<Ports, InvalidPlant>
    where
        Self: Sized,
    {
        Ok(Self::new(config)?.ports())
    }

    /// Returns the inputs and outputs. They depend on the parameters alone.
    fn ports(&self) -> Ports;

    /// Advances the time under constant inputs, by a millisecond or less in most runs. Many short steps give the same
    /// result as one long step. Does not allocate.
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]);

    /// Writes the outputs. Does not allocate.
    fn read(&self, outputs: &mut [f64]);

    /// Returns the temperature of the part that a current at an input heats; `None` if it is unknown.
    fn heated_celsius(&self, _input: usize) -> Option<f64> {
        None
    }

    /// Returns whether a current can flow through an input.
    fn conducts(&self, _input: usize) -> bool {
        true
    }

    /// Sets the condition of the part at an input by the faults at a scenario time. In a scenario with faults the emulator
    /// calls it after each event, with the plant at that time.
    fn set_condition(&mut self, _input: usize, _faults: &Faults, _time_seconds: f64) {}

    /// Returns the reason why it cannot continue, such as a model that ended by itself; `None` while it can. The
    /// emulator itself detects outputs that are not finite.
    fn failure(&self) -> Option<&str> {
        None
    }
}

/// Index of the current among the inputs of [`one_axis`].
pub const CURRENT: usize = 0;

/// Range of the current, in A.
const CURRENT_RANGE: [f64; 2] = [-1.0, 1.0];
/// Ranges of the 16-bit outputs of the module with fan and load.
const CONVECTION_RANGE: [f64; 2] = [0.0, 32.767];
const LOAD_RANGE: [f64; 2] = [-3.276_8, 3.276_7];
/// Travel of the rig that ships.
const TRAVEL_METRES: [f64; 2] = [0.0, 0.06];

/// Returns the ports of a plant of one axis: [`Inputs`], its position, and these further outputs.
pub fn one_axis(further: impl IntoIterator<Item = Port>) -> Ports {
    let position =
        Port::output("position_metres", TRAVEL_METRES).with_comment("Position of the load.");
    Ports {
        inputs: vec![
            Port::input("current_amperes", CURRENT_RANGE)
                .with_comment("Current that the amplifier puts out."),
            Port::input("convection_factor", CONVECTION_RANGE)
                .resting_at(1.0)
                .with_comment("Multiplies the convection to the air."),
            Port::input("added_load_kilograms", LOAD_RANGE).with_comment("Added to the load."),
        ],
        outputs: [position].into_iter().chain(further).collect(),
    }
}

/// Inputs of a plant of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// Output of the amplifier.
    pub current_amperes: f64,
    /// Factor of the convection to the air; 1 in still air.
    pub convection_factor: f64,
    /// Mass that is added to the load. For the shipped plants a scenario never removes more than there is.
    pub added_load_kilograms: f64,
}

impl Inputs {
    /// Makes the inputs from values in the order of [`one_axis`].
    #[inline]
    pub fn of(inputs: &[f64]) -> Self {
        let [current_amperes, convection_factor, added_load_kilograms] =
            inputs.try_into().unwrap_or_default();
        Self {
            current_amperes,
            convection_factor,
            added_load_kilograms,
        }
    }
}

impl Default for Inputs {
    /// Returns no current, still air, the load alone.
    fn default() -> Self {
        Self {
            current_amperes: 0.0,
            convection_factor: 1.0,
            added_load_kilograms: 0.0,
        }
    }
}

/// Reason why a plant cannot be emulated.
#[derive(Debug, thiserror::Error)]
pub enum InvalidPlant {
    /// A parameter makes no physical sense.
    #[error(transparent)]
    Parameter(#[from] WrongParameter),
    /// The machine cannot make it now.
    #[error("{what}: {source}")]
    Machine {
        /// Name of the missing resource.
        what: String,
        /// Error of the system.
        source: io::Error,
    },
    /// Another reason, as text.
    #[error("{0}")]
    Other(String),
}

impl InvalidPlant {
    /// Returns the parameter that is the cause, if it is one.
    pub fn parameter(&self) -> Option<&str> {
        match self {
            Self::Parameter(wrong) => Some(&wrong.name),
            Self::Machine { .. } | Self::Other(_) => None,
        }
    }
}

/// Checks that a parameter is above 0.
///
/// # Errors
/// It is not.
pub fn positive(name: &'static str, value: f64) -> Result<(), InvalidPlant> {
    require(name, value, "above 0", |value| value > 0.0)
}

/// Checks that a parameter meets its requirement.
///
/// # Errors
/// It does not.
pub fn require(
    name: &'static str,
    value: f64,
    requirement: &'static str,
    is_met: impl Fn(f64) -> bool,
) -> Result<(), InvalidPlant> {
    if value.is_finite() && is_met(value) {
        Ok(())
    } else {
        let name = name.to_owned();
        let what = format!("{value}, it must be {requirement}");
        Err(WrongParameter { name, what }.into())
    }
}

/// Checks that a part does not change faster than once per integration step.
///
/// # Errors
/// It does.
pub fn follows(
    part: &'static str,
    rate_per_second: f64,
    step_seconds_max: f64,
) -> Result<(), InvalidPlant> {
    let limit_per_second = 1.0 / step_seconds_max;
    if rate_per_second <= limit_per_second {
        Ok(())
    } else {
        Err(InvalidPlant::Other(format!(
            "{part} changes at up to {rate_per_second:.0} 1/s, the integrator follows {limit_per_second:.0} 1/s at most"
        )))
    }
}
