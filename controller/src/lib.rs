//! The controller: control laws with observer and nominal model, and the node that runs them on the bus.
//!
//! Comes in: what a controller may know of a scenario (`ControllerView`), a rig file with its drive's EDS if the drive is not
//! the emulated one, and the frames of the drive. Goes out: a [`ControllerNode`], which finds the drive, configures it by
//! SDO, leads it by a law's current commands in RPDO1, publishes the law's terms in its own TPDOs, and stops the drive when
//! something is wrong.
//!
//! [`law`] says what a law is, [`laws`] has those that ship, [`catalogue`] finds them and those that a bench from outside brings.
//!
//! It does not know: the true plant (its model is nominal), disturbances, faults and limits of the scenario, and in which
//! world it runs. The platform is named in `main.rs` only.
#![warn(missing_docs)]

pub mod catalogue;
mod cause;
mod error;
mod filtered_position;
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
mod wired_law;

pub use error::ControllerError;
pub use node::ControllerNode;
