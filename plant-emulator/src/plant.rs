//! The trait of all plants, and the ports of a plant of one axis.

use std::any::Any;
use std::{fmt, io};

pub use scenario::fault::Faults;
use scenario::own::Parameters;
pub use scenario::port::{Port, Ports};

/// A plant: parameters in, and from then on values at named ports.
///
/// Values come and go in the order of the ports, and a rig file wires drives and io nodes to them. The emulator owns the rest: the
/// drive nodes, sensors, amplifiers, I²t protection, their faults, and when time passes. A plant of one axis has the ports of
/// [`one_axis`].
pub trait Plant: Any + fmt::Debug + Send {
    /// Its parameters: what a scenario's table is read into.
    type Config: Parameters
    where
        Self: Sized;

    /// Its name, and that of its table in a scenario or a rig file.
    fn name() -> &'static str
    where
        Self: Sized;

    /// The kinds of `[[fault.plant.…]]` that its conditions look at; others are refused.
    #[must_use]
    fn faults() -> &'static [&'static str]
    where
        Self: Sized,
    {
        &[]
    }

    /// The plant with these parameters, at rest, without current and undisturbed.
    ///
    /// # Errors
    /// The parameters make no physical sense.
    fn new(config: &Self::Config) -> Result<Self, InvalidPlant>
    where
        Self: Sized;

    /// The ports of the plant with these parameters, for a plant that takes more than memory to make.
    ///
    /// # Errors
    /// As [`Plant::new`].
    fn ports_by(config: &Self::Config) -> Result<Ports, InvalidPlant>
    where
        Self: Sized,
    {
        Ok(Self::new(config)?.ports())
    }

    /// Inputs that act on it and outputs that are seen of it. They depend on the parameters alone.
    fn ports(&self) -> Ports;

    /// Lets time pass under constant inputs, a millisecond or less in most runs. Many short steps come to the same as one long one.
    /// Allocates nothing.
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]);

    /// Writes the outputs. Allocates nothing.
    fn read(&self, outputs: &mut [f64]);

    /// The temperature of the part that a current at an input heats; `None` where it is not known.
    fn heated_celsius(&self, _input: usize) -> Option<f64> {
        None
    }

    /// Whether a current can flow through an input.
    fn conducts(&self, _input: usize) -> bool {
        true
    }

    /// Whether the faults at a scenario time change the condition of the part behind an input.
    fn is_condition_new(&self, _input: usize, _faults: &Faults, _time_seconds: f64) -> bool {
        false
    }

    /// Takes over the condition that the faults at a scenario time give the part behind an input.
    fn set_condition(&mut self, _input: usize, _faults: &Faults, _time_seconds: f64) {}

    /// Why it cannot go on, such as a model that ended by itself; `None` while it can. The emulator finds outputs that are not finite.
    fn failure(&self) -> Option<&str> {
        None
    }
}

/// Place of the current among the inputs of [`one_axis`].
pub const CURRENT: usize = 0;

/// Range of the current, in A.
const CURRENT_RANGE: [f64; 2] = [-1.0, 1.0];
/// Ranges of the 16-bit outputs of the module with fan and load.
const CONVECTION_RANGE: [f64; 2] = [0.0, 32.767];
const LOAD_RANGE: [f64; 2] = [-3.276_8, 3.276_7];
/// The travel of the rig that ships.
const TRAVEL_METRES: [f64; 2] = [0.0, 0.06];

/// The ports of a plant of one axis: [`Inputs`] act on it, and its position and these further outputs are seen of it.
#[must_use]
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
    /// Current that the amplifier puts out.
    pub current_amperes: f64,
    /// Multiplies the convection to the air; 1 in still air.
    pub convection_factor: f64,
    /// Added to the load. For the shipped plants a scenario never takes more than there is.
    pub added_load_kilograms: f64,
}

impl Inputs {
    /// From values in the order of [`one_axis`].
    #[must_use]
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

    /// Values in the order of [`one_axis`].
    #[must_use]
    pub fn values(&self) -> [f64; 3] {
        [
            self.current_amperes,
            self.convection_factor,
            self.added_load_kilograms,
        ]
    }
}

impl Default for Inputs {
    /// No current, still air, the load alone.
    fn default() -> Self {
        Self {
            current_amperes: 0.0,
            convection_factor: 1.0,
            added_load_kilograms: 0.0,
        }
    }
}

/// Why a plant cannot be emulated.
#[derive(Debug, thiserror::Error)]
pub enum InvalidPlant {
    /// A parameter outside its range.
    #[error("{name} is {value}, it must be {requirement}")]
    OutOfRange {
        /// The parameter, as the scenario names it.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        requirement: &'static str,
    },
    /// Two temperatures in the wrong order.
    #[error("{cold_name} is {cold} °C, it must be below {hot_name} of {hot} °C")]
    WrongOrder {
        /// The lower temperature's name.
        cold_name: &'static str,
        /// Its value.
        cold: f64,
        /// The higher temperature's name.
        hot_name: &'static str,
        /// Its value.
        hot: f64,
    },
    /// The motion or the heat changes faster than the integrator follows.
    #[error(
        "{part} changes at up to {rate_per_second:.0} 1/s, the integrator follows {limit_per_second:.0} 1/s at most"
    )]
    TooFast {
        /// `heat` or `motion`.
        part: &'static str,
        /// Its fastest rate.
        rate_per_second: f64,
        /// The limit: one by the step size.
        limit_per_second: f64,
    },
    /// The machine does not let it be made now.
    #[error("{what}: {source}")]
    Machine {
        /// The thing that it refuses.
        what: String,
        /// Why.
        source: io::Error,
    },
    /// Anything else, in words.
    #[error("{0}")]
    Other(String),
}

impl InvalidPlant {
    /// The parameter that is to blame, if it is one.
    #[must_use]
    pub fn parameter(&self) -> Option<&'static str> {
        match self {
            Self::OutOfRange { name, .. } => Some(name),
            Self::WrongOrder { cold_name, .. } => Some(cold_name),
            Self::TooFast { .. } | Self::Machine { .. } | Self::Other(_) => None,
        }
    }
}

/// Refuses a parameter that is not above 0.
///
/// # Errors
/// It is not.
pub fn positive(name: &'static str, value: f64) -> Result<(), InvalidPlant> {
    require(name, value, "above 0", |value| value > 0.0)
}

/// Refuses a negative parameter.
///
/// # Errors
/// It is negative.
pub fn not_negative(name: &'static str, value: f64) -> Result<(), InvalidPlant> {
    require(name, value, "0 or above", |value| value >= 0.0)
}

/// Refuses a parameter that is not finite.
///
/// # Errors
/// It is not.
pub fn finite(name: &'static str, value: f64) -> Result<(), InvalidPlant> {
    require(name, value, "a finite number", |_| true)
}

/// Refuses a parameter that does not meet its requirement.
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
        Err(InvalidPlant::OutOfRange {
            name,
            value,
            requirement,
        })
    }
}

/// Refuses a part that changes faster than once per integration step.
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
        Err(InvalidPlant::TooFast {
            part,
            rate_per_second,
            limit_per_second,
        })
    }
}
