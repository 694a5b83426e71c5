//! The part of a loop that the controller may know.

use crate::bus::Bus;
use crate::controller::Controller;
use crate::reference::Reference;
use crate::trial::Trial;
use crate::wiring::Wiring;

/// A loop without the plant's parameters, its disturbances and faults, and its limits: a controller cannot use values that it
/// cannot see.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerView {
    /// Bus and its cycle.
    pub bus: Bus,
    /// Control law.
    pub controller: Controller,
    /// Set-point.
    pub reference: Reference,
    /// Wiring of the drive.
    pub wiring: Wiring,
}

impl Trial {
    /// Returns the part of this loop that the controller may know.
    pub fn controller_view(&self) -> ControllerView {
        ControllerView {
            bus: self.run.bus.clone(),
            controller: self.controller.clone(),
            reference: self.reference.clone(),
            wiring: self.wiring.clone(),
        }
    }
}
