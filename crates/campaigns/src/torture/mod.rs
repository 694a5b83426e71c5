//! `canrig torture`: random mixes of faults, invariants that hold whatever goes wrong, and the smallest scenario that breaks
//! one.

pub(crate) mod cases;
pub mod command;
mod draw;
mod invariants;
mod shrink;
