//! CAN: the frame and its length in bits on the wire, error messages of drivers, filters, and the contract between a node and the
//! mover of its frames.
//!
//! The crate does not know sockets, clocks, or any protocol above the frame.
#![warn(missing_docs)]

pub mod error_frames;
pub mod frame;
pub mod frame_bits;
mod node;

pub use frame::{CanFrame, Filter, FilterSet, STANDARD_IDS};
pub use node::{Node, Progress, earlier, earliest};
