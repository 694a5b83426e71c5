//! The controller: control laws with observer and nominal model, and the node that runs them on the bus.

pub mod catalogue;
mod cause;
mod error;
mod explanation;
pub mod law;
mod manager;
pub mod node;
mod node_ids;
pub mod nominal_model;
pub mod observer;
pub mod open_loop;
pub mod pid;
mod plausibility;
pub mod reference_filter;
pub mod sliding_mode;
pub mod sliding_mode_paper;
#[cfg(test)]
mod test_rig;

pub use error::ControllerError;
pub use node::ControllerNode;
