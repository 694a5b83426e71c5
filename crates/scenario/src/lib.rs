//! Scenario files: what to try and what passes.
//!
//! [`Scenario`] is everything; the controller gets a [`ControllerView`] that cannot see `[plant]`.

mod bus;
mod check;
pub mod controller;
mod curve;
pub mod disturbance;
mod document;
mod error;
pub mod events;
pub mod expect;
pub mod fault;
mod left_out;
mod limit;
mod load;
mod nearest;
mod null;
pub mod own;
pub mod plant;
pub mod profile;
pub mod reference;
pub mod registration;
pub mod rig;
mod scenario;
pub mod schema;
mod structure;
pub mod sweep;
mod table;
#[cfg(test)]
mod tests;
pub mod timing;
mod view;
mod window;

pub use bus::Bus;
pub use error::{Problem, ScenarioError};
pub use load::{Objection, read_text};
pub use nearest::nearest;
pub use scenario::Scenario;
pub use view::ControllerView;
