//! What acts on the motor, and what is wrong with it.

use crate::plant;

/// What acts on the motor.
pub type Inputs = plant::Inputs<Condition>;

/// What is wrong with pinion and load; by default nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Condition {
    /// The pinion does not turn.
    pub is_jammed: bool,
    /// The load has come off the rack.
    pub is_load_dropped: bool,
}
