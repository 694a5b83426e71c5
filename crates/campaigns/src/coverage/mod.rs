//! `canrig coverage`: which requirement is tested by which scenario, and what came of it.

mod command;
mod matrix;
mod page;
mod play;

pub use command::{CoverageArgs, coverage};
