//! The plant emulator: the actuator of the paper behind the bus interface of a real drive.
//!
//! [`sma`] is the physics, one file per part of the model.

pub mod amplifier;
mod integrator;
pub mod sensor;
pub mod sma;
pub mod thermal_protection;
