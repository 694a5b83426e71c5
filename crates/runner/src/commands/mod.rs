//! The commands that play scenarios, and the one that only checks them.

pub mod check;
pub mod run;
pub mod simulate;
