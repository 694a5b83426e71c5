//! CANopen without I/O and without a clock.
//!
//! One file per service, named by the standard (CiA 301, CiA 402, CiA 306 for EDS). Every node is a state machine
//! behind [`Node`]: frames and the time go in, frames and the next deadline come out.

pub mod eds;
pub mod frame;
pub mod node;
pub mod object_dictionary;
pub mod sdo;
mod sdo_block;
pub mod sdo_server;

pub use frame::{CanFrame, Filter};
pub use node::{Node, Progress};
pub use object_dictionary::{AbortCode, ObjectDictionary};
