//! A recording in the formats of other programs.
//!
//! In come the frames of a run or its timeline. Out go the bytes of a file that other programs open: ASC, BLF and tables for
//! frames, MDF and MCAP for both, Parquet for signals, a table for events. [`parquet`] also writes the tables of sweeps.
//!
//! It does not know the verdict, nor what a scenario is; it reads names and units from the timeline. It writes no file of a run
//! folder: nothing here runs unless somebody asks for it.
pub mod asc;
pub mod blf;
pub mod events;
pub mod frames;
pub mod mcap;
pub mod mf4;
pub mod parquet;
