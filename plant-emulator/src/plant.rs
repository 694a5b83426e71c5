//! What every plant is: something that a current moves, behind the drive, its sensor and its amplifier.

use std::fmt;

use scenario::fault::Faults;
use scenario::own::Parameters;

/// Most signals of its own that a plant may have: what fits TPDO2, beside the true position, and TPDO3.
pub const SIGNALS_MAX: usize = 6;

/// A plant: parameters in, a current and disturbances in, a position and signals of its own out.
///
/// The emulator owns the rest: the drive node, sensor, amplifier, I²t protection, their faults, and time.
pub trait Plant: Clone + fmt::Debug + Send + 'static {
    /// Its name, and that of its table in a scenario.
    const NAME: &'static str;

    /// Its parameters: what a scenario's table is read into.
    type Config: Parameters;

    /// What can be wrong with it; by default nothing is. `()` for a plant to which no fault means anything.
    type Condition: Copy + fmt::Debug + Default + PartialEq + Send;

    /// Its own signals, at most [`SIGNALS_MAX`]: no real drive measures them, the emulated one publishes them at every SYNC.
    const SIGNALS: &'static [Signal<Self>];

    /// What more of it a sensor may measure, by a rig file; nobody publishes it.
    const FURTHER: &'static [Signal<Self>] = &[];

    /// The kinds of `[[fault.plant.…]]` that [`Plant::condition`] looks at; others are refused.
    const FAULTS: &'static [&'static str] = &[];

    /// The plant with these parameters, at rest, without current and undisturbed.
    ///
    /// # Errors
    /// The parameters make no physical sense.
    fn new(config: &Self::Config) -> Result<Self, InvalidPlant>;

    /// What is wrong with it at a scenario time.
    fn condition(_faults: &Faults, _time_seconds: f64) -> Self::Condition {
        Self::Condition::default()
    }

    /// Whether a current can flow through it.
    fn conducts(_condition: &Self::Condition) -> bool {
        true
    }

    /// Lets time pass under constant inputs, a millisecond or less in most runs. Many short steps come to the same as one
    /// long one.
    fn step(&mut self, duration_seconds: f64, inputs: &Inputs<Self::Condition>);

    /// What the position sensor sees.
    fn position_metres(&self) -> f64;

    /// The part that the current heats.
    fn temperature_celsius(&self) -> f64;
}

/// What acts on a plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs<C> {
    /// Current that the amplifier puts out.
    pub current_amperes: f64,
    /// Multiplies the convection to the air; 1 in still air.
    pub convection_factor: f64,
    /// Added to the load. For the shipped plants a scenario never takes more than there is.
    pub added_load_kilograms: f64,
    /// What is wrong with the plant.
    pub condition: C,
}

impl<C: Default> Default for Inputs<C> {
    /// No current, still air, the load alone.
    fn default() -> Self {
        Self {
            current_amperes: 0.0,
            convection_factor: 1.0,
            added_load_kilograms: 0.0,
            condition: C::default(),
        }
    }
}

/// A signal of a plant's own: 16 bits on the bus.
#[derive(Debug)]
pub struct Signal<P> {
    /// Its name in DBC and recording; the unit is its end.
    pub name: &'static str,
    /// The unit as the DBC writes it; empty for a number without one.
    pub unit: &'static str,
    /// What it is.
    pub comment: &'static str,
    /// Steps of one unit on the bus: 100 for a resolution of 0.01.
    pub steps_per_unit: f64,
    /// Lowest and highest value; the signal is signed where the lowest is negative.
    pub range: [f64; 2],
    /// Reads it.
    pub value: fn(&P) -> f64,
}

impl<P> Signal<P> {
    /// Whether its 16 bits have a sign.
    #[must_use]
    pub fn is_signed(&self) -> bool {
        self.range[0] < 0.0
    }
}

/// Why a plant cannot be emulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
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
    /// Anything else, in words.
    #[error("{0}")]
    Other(String),
}

impl InvalidPlant {
    /// The parameter that is to blame, where it is one.
    #[must_use]
    pub fn parameter(&self) -> Option<&'static str> {
        match self {
            Self::OutOfRange { name, .. } => Some(name),
            Self::WrongOrder { cold_name, .. } => Some(cold_name),
            Self::TooFast { .. } | Self::Other(_) => None,
        }
    }
}

/// Refuses a parameter that is not above 0.
///
/// # Errors
/// So it is.
pub fn positive(name: &'static str, value: f64) -> Result<(), InvalidPlant> {
    require(name, value, "above 0", |value| value > 0.0)
}

/// Refuses a negative parameter.
///
/// # Errors
/// So it is.
pub fn not_negative(name: &'static str, value: f64) -> Result<(), InvalidPlant> {
    require(name, value, "0 or above", |value| value >= 0.0)
}

/// Refuses a parameter that is no number.
///
/// # Errors
/// So it is.
pub fn finite(name: &'static str, value: f64) -> Result<(), InvalidPlant> {
    require(name, value, "a finite number", |_| true)
}

/// Refuses a parameter that does not meet its requirement.
///
/// # Errors
/// So it is.
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

/// Refuses a part that is faster than one by the integration step.
///
/// # Errors
/// So it is.
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
