//! Protocol between the plant's side and the worker. The first byte is the type of a message; numbers are
//! little-endian.

use serde::{Deserialize, Serialize};

use crate::instance::Configuration;

/// Largest length of a message: below the size that a socket accepts at once.
pub(super) const MESSAGE_BYTES_MAX: usize = 128 << 10;

/// To the worker: load an FMU. An [`Order`] follows.
pub(super) const LOAD: u8 = 1;
/// To the worker: step. The time to reach and the inputs follow.
pub(super) const ADVANCE: u8 = 2;
/// To the worker: end.
pub(super) const END: u8 = 3;
/// From the worker: done; the outputs follow.
pub(super) const DONE: u8 = 4;
/// From the worker: failed before the run; a text follows.
pub(super) const CANNOT: u8 = 5;
/// From the worker: failed in the run; a text follows.
pub(super) const FAILED: u8 = 6;

/// Order to load an FMU.
#[derive(Debug, Deserialize, PartialEq, Serialize)]
pub(super) struct Order {
    /// Folder of the unpacked FMU.
    pub(super) folder: String,
    /// File of the FMU, for messages.
    pub(super) file: String,
    /// Configuration for the run.
    pub(super) configuration: Configuration,
}

/// Writes a message of numbers; the buffer keeps its capacity.
pub(super) fn write(message: &mut Vec<u8>, what: u8, numbers: impl Iterator<Item = f64>) {
    message.clear();
    message.push(what);
    for number in numbers {
        message.extend_from_slice(&number.to_le_bytes());
    }
}

/// Returns the numbers of a message after its first byte.
pub(super) fn numbers(message: &[u8]) -> impl ExactSizeIterator<Item = f64> {
    let body = message.get(1..).unwrap_or_default();
    let number = |bytes: &[u8; 8]| f64::from_le_bytes(*bytes);
    body.as_chunks::<8>().0.iter().map(number)
}
