//! Condition of the motor.

use crate::plant::Faults;

/// Condition of pinion and load; sound by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Condition {
    /// Whether the pinion is blocked.
    pub(super) is_jammed: bool,
    /// Whether the load has come off the rack.
    pub(super) is_load_dropped: bool,
}

impl Condition {
    /// Returns the condition at a scenario time.
    pub(super) fn at(faults: &Faults, time_seconds: f64) -> Self {
        Self {
            is_jammed: faults.any_acts("jammed_pulley", time_seconds),
            is_load_dropped: faults.any_acts("dropped_load", time_seconds),
        }
    }
}
