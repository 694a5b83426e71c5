//! `canrig sweep` and `canrig merge`: many runs of one scenario, one row each.
//!
//! A [`sweep_cases::SweepCases`] says what each case of a sweep is: any of them, at once and by itself, so that it does not matter which machine plays
//! which. `store` has the rows of the cases that are done, on the disk, which is all that a restart or a merge needs. `tables` and `summary` are made of the store when all is done, and `command` puts it together.

pub mod cases;
pub mod command;
pub mod drivers;
pub(crate) mod estimate;
pub(crate) mod finish;
pub mod merge;
mod page;
pub(crate) mod part;
pub mod row;
pub(crate) mod shard;
pub(crate) mod store;
pub mod summary;
pub mod sweep_cases;
mod tables;
mod uncopied;

pub use shard::Shard;
