//! canrig: a hardware-in-the-loop test bench over CAN.
//!
//! A scenario file is played in one of several worlds (`world`), what was on the bus is recorded (`capture`,
//! `recording`), decoded (`timeline`, `events`), judged (`judge`, `verdict`) and reported (`report`, `run_folder`). `tools` are for people who debug nodes.

pub mod bus_model;
pub mod capture;
pub mod cli;
pub mod commands;
pub mod console;
pub mod coordinator;
pub mod disturbance_node;
pub mod doctor;
pub mod events;
pub mod exit;
pub mod identify;
pub mod judge;
pub mod manual;
pub mod nodes;
pub mod recording;
pub mod recordings;
pub mod report;
pub mod run;
pub mod run_folder;
pub mod scenario_clock;
pub mod signals;
pub mod timeline;
pub mod timing;
pub mod tools;
pub mod verdict;
pub mod world;

use std::process::ExitCode;

use clap::Parser;

use crate::cli::Cli;
use crate::exit::Exit;

/// The program. A panic ends in exit code 70 and a message, after everything on the stack was cleaned up.
#[must_use]
pub fn main() -> ExitCode {
    std::panic::set_hook(Box::new(console::report_panic));
    let exit = std::panic::catch_unwind(|| match Cli::try_parse() {
        Ok(cli) => commands::execute(cli),
        Err(error) => {
            // The texts for --help and --version come as errors too.
            let _ = error.print();
            if error.use_stderr() {
                Exit::Usage
            } else {
                Exit::Pass
            }
        }
    });
    exit.unwrap_or(Exit::Internal).into()
}
