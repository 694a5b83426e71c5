//! `[[expect.sequence]]`: events that must follow each other in time.

use std::fmt;

use schemars::JsonSchema;
use serde::Deserialize;

use super::{ExpectedRow, at_most};
use crate::limit::{Limit, rounded};
use crate::window::Window;

/// Events that must come one after the other, each soon enough after the one before.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Sequence {
    /// Short name of the sequence.
    #[schemars(length(min = 1, max = 200))]
    pub name: String,
    /// Requirements that the sequence tests, such as "REQ-12".
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 100), inner(length(min = 1, max = 100)))]
    pub requirements: Vec<String>,
    /// Start of the window: earlier events do not count, and the time of the first event counts from here. The start of the
    /// scenario if absent.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// End of the window: later events do not count. The end of the run if absent.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: Option<f64>,
    /// The events, in their order.
    #[schemars(length(min = 1, max = 100))]
    pub event: Vec<Expected>,
}

/// Event of a sequence: exactly one of `emcy`, `text` and `signal`.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Expected {
    /// An emergency, as node and code: "drive 0x8130".
    #[schemars(length(min = 1, max = 200))]
    pub emcy: Option<String>,
    /// Part of the text of an event in the report, such as "loss: no SYNC".
    #[schemars(length(min = 1, max = 200))]
    pub text: Option<String>,
    /// A signal, named as in `[[expect.signal]]`, that gets within `reaches`.
    #[schemars(length(min = 1, max = 200))]
    pub signal: Option<String>,
    /// Limits that the signal must reach.
    pub reaches: Option<Limit>,
    /// Time for which the signal must stay within the limits; one sample is enough if absent.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub for_milliseconds: Option<f64>,
    /// Longest time after the event before; optional for the first event.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub within_milliseconds: Option<f64>,
}

impl Sequence {
    /// Returns the window in which events count, in a run of this duration.
    pub fn window(&self, duration_seconds: f64) -> Window {
        Window::new(
            self.from_seconds,
            self.until_seconds.unwrap_or(duration_seconds),
        )
    }

    /// Returns the rows of its events in the verdict of a run of this duration.
    pub fn rows(&self, duration_seconds: f64) -> impl Iterator<Item = ExpectedRow> {
        let window = self.window(duration_seconds);
        let whole = rounded(1e3 * (window.until_seconds - window.from_seconds));
        let events = self.event.iter().enumerate();
        events.map(move |(place, event)| ExpectedRow {
            name: self.row_name(place),
            limit: Some(at_most(event.within_milliseconds.unwrap_or(whole))),
            requirements: self.requirements.clone(),
        })
    }

    /// Returns the name of an event's row in the verdict.
    fn row_name(&self, place: usize) -> String {
        let (name, number) = (&self.name, place + 1);
        let event = &self.event[place];
        format!("{name}, {number}: {event} within milliseconds")
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.emcy, &self.text, &self.signal) {
            (Some(emcy), ..) => write!(formatter, "EMCY {emcy}"),
            (_, Some(text), _) => write!(formatter, "\"{text}\""),
            (_, _, Some(signal)) => {
                let limit = self.reaches.unwrap_or_default();
                write!(formatter, "{signal} {limit}")?;
                match self.for_milliseconds {
                    Some(milliseconds) => write!(formatter, " for {milliseconds} ms"),
                    None => Ok(()),
                }
            }
            (None, None, None) => formatter.write_str("nothing"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_named_by_place_and_event() {
        let text = "name = \"loss\"\nevent = [{ text = \"no SYNC\" }, { emcy = \"drive 0x8130\" },\n\
                    { signal = \"current_amperes\", reaches = { max = 0 }, for_milliseconds = 20 }]";
        let sequence: Sequence = toml::from_str(text).unwrap();
        let names: Vec<String> = (0..3).map(|place| sequence.row_name(place)).collect();
        let expected = [
            "loss, 1: \"no SYNC\" within milliseconds",
            "loss, 2: EMCY drive 0x8130 within milliseconds",
            "loss, 3: current_amperes at most 0 for 20 ms within milliseconds",
        ];
        assert_eq!(names, expected);
    }
}
