//! canrig: a hardware-in-the-loop test bench over CAN.
//!
//! A scenario file is played in one of several worlds (`world`), what was on the bus is recorded (`capture`,
//! `recording`), decoded (`timeline`, `events`), judged (`judge`, `verdict`) and reported (`report`, `run_folder`); a `viewer` may look on through a `tap`. `tools` are for people who debug nodes.

pub mod bench;
pub mod bus_model;
pub mod campaign;
pub mod capture;
pub mod cli;
pub mod commands;
pub mod console;
pub mod coordinator;
pub mod distribution;
pub mod disturbance_node;
pub mod doctor;
pub mod error_frames;
pub mod events;
pub mod exit;
pub mod external;
pub mod frames;
pub mod gauge;
pub mod harmonic;
pub mod identify;
pub mod judge;
mod losses;
pub mod manual;
pub mod new;
pub mod nodes;
pub mod preflight;
pub mod recording;
pub mod recordings;
pub mod report;
pub mod reproduce;
pub mod rig;
pub mod run;
pub mod run_folder;
pub mod signal_names;
pub mod signals;
pub mod supervisor;
pub mod sweep;
pub mod tap;
pub mod timeline;
pub mod timing;
pub mod tools;
pub mod torture;
pub mod traces;
pub mod truth;
pub mod verdict;
pub mod viewer;
pub mod world;

pub use bench::Bench;

/// Longest file that a user names besides scenarios and recordings.
const FILE_BYTES_MAX: u64 = 1 << 20;
