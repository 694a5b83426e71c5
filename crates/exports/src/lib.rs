//! Recordings in the formats of other programs.
//!
//! Input: the frames of a run or its timeline. Output: the bytes of a file that other programs open: ASC, BLF and tables for
//! frames, MDF and MCAP for both, Parquet for signals, a table for events. [`parquet`] also writes the tables of sweeps.
//!
//! It knows no verdict and no scenario; it reads names and units from the timeline. It writes no file of a run folder, and runs
//! only on request.
pub mod asc;
pub mod blf;
pub mod events;
pub mod frames;
pub mod mcap;
pub mod mf4;
pub mod parquet;

use dbc::{Message, SignalHandle};

/// Bits of the identifier in a raw one, without its flags.
const ID_BITS: u32 = 0x1FFF_FFFF;
/// Bits of the identifier in a raw one, and the flag of an extended one.
const MARKED_ID_BITS: u32 = 0x9FFF_FFFF;

/// Returns the signals of a message, in its order.
fn signals(message: &Message) -> Vec<SignalHandle> {
    let signals = message.signals.iter();
    signals.map(|signal| message.handle(signal)).collect()
}
