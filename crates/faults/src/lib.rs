//! Deliberate faults, as far as several crates need them.
//!
//! Input: the `[fault]` table of a scenario, a seed, a node and the frames for it. Output: the same node as a [`Faulty`] one,
//! which fails as `[fault.node]` says, in every world alike; the random numbers of one fault as a [`Stream`], which no other
//! fault disturbs.
//!
//! It knows no buses, plants and sensors. Sensor, amplifier and plant fail in the plant emulator, and the bus fails in the bus
//! model.

mod faulty;
mod plan;
mod stream;

pub use faulty::Faulty;
pub use plan::{FaultPlan, PlannedFault};
pub use stream::Stream;
