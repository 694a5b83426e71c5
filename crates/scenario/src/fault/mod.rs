//! The `[fault]` table: what goes wrong on purpose.
//!
//! Each kind of fault is an array of tables, `[[fault.sensor.stuck]]`. All may be used together; each draws its random
//! numbers from a stream of its own, so that one more fault leaves the others as they were.

pub mod amplifier;
pub mod bus;
mod lasting;
pub mod node;
pub mod plant;
pub mod sensor;
mod table;
#[cfg(test)]
mod tests;
mod windows;

pub use lasting::{Lasting, any_acts};
pub use table::Faults;
pub use windows::{FaultWindow, Place, Touch};
