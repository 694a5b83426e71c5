//! What happened on the bus besides the cyclic traffic, as a table.

use recording::events::Level;
use recording::timeline::Timeline;

/// One row for each event, in the order of time: when, how grave, and what, as the page of a run has them.
///
/// # Errors
/// The library refuses.
pub fn to_csv(timeline: &Timeline) -> Result<Vec<u8>, csv::Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(["time_seconds", "level", "text"])?;
    for event in &timeline.events {
        let level = match event.level {
            Level::Info => "info",
            Level::Warning => "warning",
            Level::Error => "error",
        };
        table.write_record([&format!("{:.6}", event.time_seconds), level, &event.text])?;
    }
    let bytes = table.into_inner();
    bytes.map_err(|error| csv::Error::from(error.into_error()))
}
