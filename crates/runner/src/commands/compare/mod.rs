//! `canrig compare`: finds where two runs diverge.

mod command;
mod page;

pub use command::{CompareArgs, compare};
