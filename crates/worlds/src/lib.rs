//! Worlds in which a scenario is played: one process, processes in virtual time, real time, real hardware. The nodes are the same
//! in each; only the code that moves frames and time differs.
//!
//! Input: a [`plan::Plan`], the bus to use, and a [`recording::capture::Capture`] that is given every frame. Output: a
//! [`Played`], or a [`WorldError`] with the reason why there is none. [`lockstep`] moves the nodes through virtual time by the
//! coordinator and its model of the bus; [`real_time`] starts the nodes as processes and listens; [`preflight`] checks a drive
//! that is not the emulator before current may flow in it.
//!
//! It knows no verdict, no file of a run folder other than the recording, and no reader. It prints nothing: events during a run
//! are reported to the caller.

mod after_end;
mod agenda;
pub mod bench_node;
mod blame;
mod bus_choice;
pub mod bus_connection;
mod bus_model;
mod bus_place;
pub mod catalogue;
mod child;
mod coordinator;
mod error;
mod fmu_plant;
pub mod fmu_worker;
pub mod guest;
pub mod law_process;
pub mod law_worker;
mod listeners;
pub mod lockstep;
pub mod names;
pub mod nodes;
mod part;
mod played;
pub mod preflight;
mod process_faults;
pub mod processes;
pub mod programs;
pub mod real_time;
mod second_master;
mod senders;
mod silence;
mod stalls;
mod supervisor;

pub use bus_choice::{BusChoice, RunBus, choose_bus, parse_bus};
pub use bus_place::{Vigil, claim};
pub use error::WorldError;
pub use played::{End, Played};
