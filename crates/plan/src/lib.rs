//! The plan of a run, and the meaning of its bus.
//!
//! Input: a scenario with its rig and the EDS of real drives, the nodes that are external, and the plants and laws of the bench
//! as a [`catalogue::Catalogue`]. Output: a [`Plan`] with the [`dbc::Database`] that gives each frame its meaning, the signals by
//! all their names, the data sheets of the nodes, and the meaning of a CAN driver's error frames.
//!
//! The crate does not know how a run is played, recorded or judged, nor the code of plants and laws: the crates that play them
//! hand in their names and signals. It opens no bus and starts no process.

pub mod bus_budget;
pub mod catalogue;
pub mod data_sheet;
pub mod loaded_drive;
pub mod named_nodes;
mod plan;
mod ports;
pub mod presence;
pub mod resolve;
mod signal_names;
mod swept_fmu;

pub use data_sheet::FILE_BYTES_MAX;
pub use plan::{ControlLoop, Plan, each_once, listed, loop_prefix, message_of};
pub use scenario::Shared;
