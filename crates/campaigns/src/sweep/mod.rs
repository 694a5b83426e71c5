//! `canrig sweep` and `canrig merge`: many runs of one scenario, one row each.
//!
//! A [`sweep_cases::SweepCases`] defines the cases of a sweep. Each is available at once and by itself, so any machine may play
//! any of them. `store` has the rows of the completed cases on the disk, which is all that a restart or a merge needs. `tables`
//! and `summary` are made from the store at the end, and `part` puts it all together.

pub(crate) mod cases;
pub mod command;
mod drivers;
pub(crate) mod estimate;
pub(crate) mod finish;
pub mod merge;
mod page;
pub(crate) mod part;
pub mod row;
pub(crate) mod shard;
pub(crate) mod store;
mod summary;
pub mod sweep_cases;
mod tables;
pub(crate) mod uncopied;

pub(crate) use shard::Shard;
