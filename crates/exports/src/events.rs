//! Table of the events of a run other than cyclic traffic.

use std::io::{self, Write};

use recording::cell::cell;
use recording::events::{Event, Level};
use recording::occurrences::Occurrence;

/// Writes one row for each event, in the order of time: its time, severity and text, as on the page of a run.
///
/// # Errors
/// If the output does not take it.
pub fn write(mut output: impl Write, events: &[Occurrence<Event>]) -> io::Result<()> {
    writeln!(output, "time_seconds,level,text")?;
    for event in events {
        let level = match event.level {
            Level::Info => "info",
            Level::Warning => "warning",
            Level::Error => "error",
        };
        let text = cell(&event.text);
        writeln!(output, "{:.6},{level},{text}", event.time_seconds)?;
    }
    Ok(())
}
