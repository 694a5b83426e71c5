//! CANopen without I/O and without a clock.
//!
//! Input: the frames that a node receives, the time, orders of the application, the text of an EDS. Output: the frames that the
//! node sends, the time of its next deadline, an [`ObjectDictionary`].
//!
//! Every node is a state machine behind [`can::Node`]; a [`Device`] is one with the services of the standard around an
//! [`Application`]. There is one file for each service, named by the standard: CiA 301, CiA 402, and CiA 306 for EDS files.
//!
//! The crate does not know sockets, threads, the clock of the machine, the meaning of the bytes of this bench's PDOs, or whether
//! anything is simulated.
#![warn(missing_docs)]

pub mod application;
pub mod cia402;
pub mod cob_id;
pub mod device;
pub mod eds;
pub mod emcy;
pub mod heartbeat;
pub mod nmt;
pub mod object_dictionary;
pub mod pdo;
mod rounding;
pub mod sdo;
mod sdo_block;
mod sdo_channels;
pub mod sdo_client;
pub mod sdo_server;
pub mod services;
pub mod sync;

pub use application::{Application, CommunicationLoss};
pub use device::Device;
pub use nmt::{NmtCommand, NmtState, NodeId};
pub use object_dictionary::{AbortCode, Accepted, ObjectDictionary};
pub use rounding::add_half;
pub use services::Services;
