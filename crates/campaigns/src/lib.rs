//! Many runs: sweeps of a scenario over values, torture by random mixes of faults, and which requirements all of them test.
//!
//! The input is a scenario, with a `[sweep]` table or a seed. Each run is played in virtual time, in memory, several at a time
//! ([`campaign::Campaign`]). Only a row or a broken invariant is kept of it, so a million runs need no more memory than a few.
//! The output is the tables, the page and the failing scenarios of a sweep, or the smallest scenario that breaks an invariant.
//!
//! A campaign that was stopped continues from where it ended, and its parts may be played on several machines: `engine` gives
//! them to Slurm, HyperQueue or Kubernetes, and submits lost ones again. This crate does not know how a run is played or judged,
//! nor how the formats of its tables are written: `worlds`, `judge` and `report` do. It knows no bus but the modelled one, and no
//! real time. All output goes through the console of `runner`.
pub mod campaign;
pub mod coverage;
pub mod distribution;
pub mod engine;
pub mod sweep;
pub mod torture;
