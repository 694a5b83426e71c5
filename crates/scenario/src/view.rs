//! What the controller may know of a loop.

use crate::bus::Bus;
use crate::controller::Controller;
use crate::reference::Reference;
use crate::trial::Trial;
use crate::wiring::Wiring;

/// A loop without the plant's parameters, its disturbances and faults, and its limits: a controller cannot use what it cannot see.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerView {
    /// The bus.
    pub bus: Bus,
    /// The control law.
    pub controller: Controller,
    /// The set-point.
    pub reference: Reference,
    /// How the drive is wired.
    pub wiring: Wiring,
}

/// The tables that the controller's loader takes out of the document before it looks at anything.
pub(crate) const HIDDEN_FROM_CONTROLLER: [&str; 5] =
    ["plant", "disturbance", "fault", "expect", "sweep"];

impl Trial {
    /// What the controller may know of this loop.
    #[must_use]
    pub fn controller_view(&self) -> ControllerView {
        ControllerView {
            bus: self.run.bus.clone(),
            controller: self.controller.clone(),
            reference: self.reference.clone(),
            wiring: self.wiring.clone(),
        }
    }
}
