//! A recording, decoded: one row for each cycle, and the events between them.

mod columns;
mod decoded;
mod reader;
mod traffic;

pub use decoded::{Column, TIME_TOLERANCE_SECONDS, Timeline};
pub use reader::{TimelineReader, decode};
