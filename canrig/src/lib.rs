//! canrig: a hardware-in-the-loop test bench over CAN, and its command line.
//!
//! Inputs are the arguments of the command line, and the plants and laws that a [`Bench`] from outside registers.
//! Outputs are the printed text and the exit code. Each subcommand has one file with its arguments and its `run`, here
//! or in the crates `runner`, `campaigns` and `paper`; `cli` only lists them.
//!
//! This crate has the tools on a bus (`tools`), the description of an FMU (`fmu`), the check of the machine (`doctor`),
//! the new crate of a plant or law (`new`), the completions and manual pages (`manual`), and the node as a process of
//! its own (`host`), which a run or a hand starts.
//!
//! The crate does not know how a run is played, recorded, judged and reported.

pub mod bench;
mod cli;
mod demo;
mod doctor;
mod eds;
mod fmu;
mod host;
mod manual;
mod new;
mod schema;
mod tools;

pub use bench::Bench;
pub use host::by_hand;

/// Returns the command line, for checks of the commands in the book.
#[doc(hidden)]
pub fn command() -> clap::Command {
    <cli::Cli as clap::CommandFactory>::command()
}
