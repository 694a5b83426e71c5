//! The plant emulator: the actuator of the paper behind the bus interface of a real drive.
//!
//! [`sma`] is the physics, one file per part of the model.

mod integrator;
pub mod sma;
