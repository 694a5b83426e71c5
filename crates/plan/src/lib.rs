//! What is played, and what then is known of the bus.
//!
//! Comes in: a scenario with its rig and the EDS of real drives, the nodes that are external, and the plants and laws of
//! the bench as a [`catalogue::Catalogue`]. Goes out: a [`Plan`] with the [`dbc::Database`] that says what each frame
//! means, the signals by all their names, the data sheets of the nodes, and what an error frame of a CAN driver says.
//!
//! What it does not know: how a run is played, recorded or judged, and the code of plants and laws: whoever plays them hands
//! in their names and signals. It opens no bus and starts nothing.

pub mod bus_budget;
pub mod catalogue;
pub mod data_sheet;
pub mod error_frames;
pub mod external;
pub mod loaded_drive;
pub mod named_nodes;
mod plan;
mod ports;
pub mod presence;
mod signal_names;
mod swept_fmu;

pub use data_sheet::FILE_BYTES_MAX;
pub use plan::{ControlLoop, Plan, Shared, check_rig, listed, prefix_of};
