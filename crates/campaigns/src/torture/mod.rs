//! `canrig torture`: random mixes of faults, invariants that hold whatever goes wrong, and the smallest scenario that breaks
//! one.

pub mod command;
mod draw;
mod invariants;
mod shrink;

pub use invariants::{Violation, violation};
pub use shrink::Case;
