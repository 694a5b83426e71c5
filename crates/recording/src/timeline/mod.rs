//! Decoded recording: one row for each cycle, and the events between them.

mod columns;
mod commands;
mod decoded;
mod floods;
mod passing;
mod reader;

pub use decoded::{Column, TIME_TOLERANCE_SECONDS, Timeline, all_events, signals};
pub use platform::series::{Series, SeriesWriter};
pub use reader::{RunReader, decode};
