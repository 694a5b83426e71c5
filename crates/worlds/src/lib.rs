//! The worlds that a scenario is played in: one process, processes in virtual time, real time, real hardware. The nodes are
//! the same in each; only what moves frames and time differs.
//!
//! Comes in: a [`plan::Plan`], the bus to use, and a [`recording::capture::Capture`] that is given every frame. Goes
//! out: a [`Played`], or a [`WorldError`] that says why there is none. [`lockstep`] moves the nodes through virtual time by
//! the coordinator and its model of the bus; [`real_time`] starts the nodes as processes and listens; [`preflight`] checks a
//! drive that is not the emulator before current may flow in it.
//!
//! What it does not know: what is judged, what a run folder holds besides the recording, and who reads it. It prints nothing:
//! what happens meanwhile is reported to the caller.

mod after_end;
mod agenda;
mod blame;
mod bus_choice;
pub mod bus_connection;
mod bus_model;
mod bus_place;
pub mod catalogue;
mod child;
mod coordinator;
pub mod disturbance_node;
mod error;
mod fmu_plant;
pub mod fmu_worker;
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
mod silence;
mod stalls;
mod supervisor;

pub use bus_choice::{BusChoice, RunBus, choose_bus};
pub use bus_place::{BusPlace, Vigil};
pub use error::WorldError;
pub use played::{End, Played};
