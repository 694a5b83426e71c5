//! What is played, and what then is known of the bus.
//!
//! Comes in: a scenario file, a rig file with the EDS of its drive, the nodes that are external, and the plants and laws of
//! the bench as a [`catalogue::Catalogue`]. Goes out: a [`plan::Plan`] with the [`dbc::Database`] that says what each frame
//! means, the signals by all their names, the data sheets of the nodes, and what an error frame of a CAN driver says.
//!
//! What it does not know: how a run is played, recorded or judged, and the code of plants and laws: whoever plays them hands
//! in their names and signals. It opens no bus and starts nothing.

pub mod bus_budget;
pub mod catalogue;
pub mod data_sheet;
pub mod error_frames;
pub mod external;
pub mod named_nodes;
pub mod plan;
mod ports;
pub mod presence;
pub mod rig_file;
mod signal_names;
mod swept_fmu;

pub use data_sheet::FILE_BYTES_MAX;
