//! Faults on purpose, as far as several rooms need them.
//!
//! [`Faulty`] wraps a node and lets it fail as the scenario's `[fault.node]` says, in every world. [`Stream`] is the
//! random numbers of one fault. Sensor, amplifier and plant fail in the plant emulator, the bus in the bus model.

mod faulty;
mod plan;
mod stream;

pub use faulty::Faulty;
pub use plan::{Kind, Plan, Planned};
pub use stream::Stream;
