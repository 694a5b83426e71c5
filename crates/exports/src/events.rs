//! Table of the events of a run other than cyclic traffic.

use std::io::{self, Write};

use recording::cell::inert;
use recording::events::{Event, Level};
use recording::occurrences::Occurrence;

/// Writes one row for each event, in the order of time: its time, severity and text, as on the page of a run.
///
/// # Errors
/// If the output does not take it.
pub fn write(output: impl Write, events: &[Occurrence<Event>]) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(output);
    table.write_record(["time_seconds", "level", "text"])?;
    for event in events {
        let level = match event.level {
            Level::Info => "info",
            Level::Warning => "warning",
            Level::Error => "error",
        };
        let (time, text) = (format!("{:.6}", event.time_seconds), inert(&event.text));
        table.write_record([&*time, level, &*text])?;
    }
    table.flush()
}
