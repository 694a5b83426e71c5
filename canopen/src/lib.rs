//! CANopen without I/O and without a clock.
//!
//! One file per service, named by the standard (CiA 301, CiA 402, CiA 306 for EDS). Every node is a state machine
//! behind [`Node`]: frames and the time go in, frames and the next deadline come out.

pub mod application;
pub mod cia402;
mod cob_id;
pub mod device;
pub mod eds;
pub mod emcy;
pub mod frame;
pub mod heartbeat;
pub mod nmt;
pub mod node;
pub mod object_dictionary;
pub mod pdo;
pub mod sdo;
mod sdo_block;
mod sdo_channels;
pub mod sdo_client;
pub mod sdo_server;
pub mod services;
pub mod sync;

pub use application::{Application, CommunicationLoss};
pub use device::Device;
pub use frame::{CanFrame, Filter, FilterSet};
pub use nmt::{NmtCommand, NmtState, NodeId};
pub use node::{Node, Progress, earlier, earliest};
pub use object_dictionary::{AbortCode, ObjectDictionary};
pub use services::Services;
