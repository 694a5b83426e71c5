//! The controller: control laws with observer and nominal model, and the node that runs them on the bus.
//!
//! Inputs are the part of a scenario that a controller may know (`ControllerView`), a rig file with its drive's EDS if
//! the drive is not the emulated one, and the frames of the drive. The output is a [`ControllerNode`]. It finds the
//! drive, configures it by SDO, leads it by a law's current commands in RPDO1, publishes the law's terms in its own
//! TPDOs, and stops the drive after a failure.
//!
//! [`law`] defines the interface of laws, [`laws`] has those that ship, and [`catalogue`] finds these and custom ones.
//!
//! The controller does not know the true plant (its model is nominal), the disturbances, faults and limits of the
//! scenario, or the world in which it runs. It does not use the platform.
#![warn(missing_docs)]

pub mod catalogue;
mod cause;
mod error;
pub mod law;
pub mod laws;
mod manager;
pub mod mode;
pub mod node;
pub mod nominal_model;
pub mod observer;
mod plausibility;
pub mod process_law;
pub mod reference_filter;
mod terms;
#[cfg(test)]
mod test_rig;
mod turns;

pub use error::ControllerError;
pub use node::{ControllerNode, Leader, controller_node, controller_node_of_loops};
