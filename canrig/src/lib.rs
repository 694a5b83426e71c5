//! canrig: a hardware-in-the-loop test bench over CAN, and its command line.

pub mod bench;
mod cli;
mod doctor;
mod host;
mod manual;
mod new;
mod schema;
mod tools;

pub use bench::Bench;
