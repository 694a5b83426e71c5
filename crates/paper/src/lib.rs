//! The paper that the bench began with: its experiments, and the identification of its plant.
//!
//! [`reproduce`] plays every experiment of Romano and Tannuri as a campaign. Its inputs are the shipped scenarios,
//! which are part of the program. Its output is a page with each figure redrawn, and each number with the paper's value
//! and target. [`identify`] takes recordings of one plant. Its output is the plant that explains them best, with its
//! statistics.
//!
//! No other crate knows an optimiser (`basin`), or the equations of the SMA actuator from outside; this crate does not
//! know other plants. It does not know how runs are played, recorded or judged: it takes the results of a campaign or a
//! run folder. Only the command line depends on it.
pub mod identify;
pub mod reproduce;
