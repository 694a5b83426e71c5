//! The integration tests, from pure to process level; one binary. Those on the kernel's CAN bus are in `vcan/`.
#![expect(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "tests fail by panicking, and wait for processes"
)]

mod allocation;
mod attribution;
mod book;
mod book_commands;
mod bought_sheets;
mod checks;
mod command_line;
mod core;
mod counterfactual;
#[path = "../crates/platform/tests/support/counting_allocator.rs"]
mod counting_allocator;
mod coverage;
mod data_sheets;
mod demo;
mod drawn;
mod external;
mod faults;
mod fmu_workers;
mod fmus;
mod hostile_input;
mod identify;
mod kinetics;
mod knowledge;
mod laws;
mod lockstep;
mod long_runs;
mod messages;
mod misbehaving_at_seats;
mod missed;
mod mutator;
mod net;
mod preflight;
mod processes;
mod programs;
mod readme;
mod real_time;
mod recipes;
mod replay;
mod report;
mod reports;
mod reproduce;
mod rigs;
mod rooms;
mod run_folders;
mod schemas;
mod second_master;
mod support;
mod sweep;
mod tools;
#[cfg(feature = "rerun")]
mod viewer;
mod waiting;
mod watch;

#[global_allocator]
static ALLOCATOR: counting_allocator::CountingAllocator = counting_allocator::CountingAllocator;
