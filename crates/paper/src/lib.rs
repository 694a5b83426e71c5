//! The paper that the bench began with: its experiments, and the identification of its plant.
//!
//! [`reproduce`] plays every experiment of Romano and Tannuri as a campaign. In come the shipped scenarios, which are part of the
//! program; out goes a page with each figure redrawn and each number beside the paper's, and whether its target is met.
//! [`identify`] takes recordings of one plant; out goes the plant that explains them best, with what the result is worth.
//!
//! It is the only crate that knows an optimiser (`basin`) and the equations of the SMA actuator from outside; other plants
//! mean nothing to it. It does not know how runs are played, recorded or judged: it takes what a campaign or a run folder
//! holds. Nothing else of the bench builds on it but the command line.
pub mod identify;
pub mod reproduce;
