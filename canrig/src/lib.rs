//! canrig: a hardware-in-the-loop test bench over CAN, and its command line.
//!
//! Comes in: the words of the command line, and the plants and laws that a [`Bench`] from outside registers. Goes out: what
//! the command prints, and its exit code. Each subcommand stands with its arguments and its `run` in one file, here or in
//! the crates `runner`, `campaigns` and `paper`; `cli` only lists them.
//!
//! Here are the tools on a bus (`tools`), what an FMU says of itself (`fmu`), the look at the machine (`doctor`), the new crate of a plant or law (`new`), the
//! completions and manual pages (`manual`), and the node as a process of its own (`host`), which a run starts.
//!
//! What it does not know: how a run is played, recorded, judged and reported.

pub mod bench;
mod cli;
mod doctor;
mod eds;
mod fmu;
mod host;
mod manual;
mod new;
mod schema;
mod tools;

pub use bench::Bench;

/// The command line, for what checks commands that stand in pages.
#[doc(hidden)]
#[must_use]
pub fn command() -> clap::Command {
    <cli::Cli as clap::CommandFactory>::command()
}
