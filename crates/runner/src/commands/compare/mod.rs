//! `canrig compare`: where two runs diverge.
//!
//! A value differs by its distance from the range of the other run's values a little before and after. So a value that
//! only comes a moment earlier or later does not differ.

mod command;
mod comparison;
mod difference;
mod page;
mod shared;
mod tolerance;

pub use command::{CompareArgs, compare};
