//! `canrig coverage`: the scenarios that test each requirement, and their outcomes.

mod command;
mod matrix;
mod page;
mod play;

pub use command::{CoverageArgs, coverage};
