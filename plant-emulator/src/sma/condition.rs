//! What acts on the actuator, and what is wrong with it.

use crate::plant;

/// What acts on the actuator.
pub type Inputs = plant::Inputs<Condition>;

/// What is wrong with wire and mechanics; by default nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// Multiplies `R`.
    pub resistance_factor: f64,
    /// Multiplies `Δ`.
    pub recoverable_strain_factor: f64,
    /// The wire carries nothing.
    pub is_wire_broken: bool,
    /// The load stays where it is.
    pub is_pulley_jammed: bool,
    /// No load hangs on the pulley.
    pub is_load_dropped: bool,
}

impl Default for Condition {
    fn default() -> Self {
        Self {
            resistance_factor: 1.0,
            recoverable_strain_factor: 1.0,
            is_wire_broken: false,
            is_pulley_jammed: false,
            is_load_dropped: false,
        }
    }
}

impl Inputs {
    /// The current that would heat a sound wire as much.
    pub(super) fn heating_amperes(&self) -> f64 {
        let factor = self.condition.resistance_factor;
        if factor == 1.0 {
            self.current_amperes
        } else {
            self.current_amperes * libm::sqrt(factor)
        }
    }

    /// What is added to the load, or takes all of it away.
    pub(super) fn added_load_kilograms(&self) -> f64 {
        if self.condition.is_load_dropped {
            f64::NEG_INFINITY
        } else {
            self.added_load_kilograms
        }
    }
}
