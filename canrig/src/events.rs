//! What happened on the bus besides the cyclic traffic: start-up, states, emergencies, disturbances.

use std::collections::BTreeMap;
use std::time::Duration;

use dbc::{Database, Message, Signal, SignalHandle};
use scenario::Scenario;

use crate::recording::Stamped;

/// How grave an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Part of a normal run.
    Info,
    /// Something the scenario did to the rig.
    Warning,
    /// A fault.
    Error,
}

/// One thing that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// Scenario time; negative before scenario time 0.
    pub time_seconds: f64,
    /// How grave it is.
    pub level: Level,
    /// What happened, for people.
    pub text: String,
}

/// What of a message is worth an event.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A state, whenever it changes.
    State,
    /// Every message.
    Command,
    /// Every message; 0 says that the emergency is over.
    Emergency,
}

/// A signal that makes events.
struct Source {
    signal: SignalHandle,
    definition: Signal,
    kind: Kind,
    node: String,
    last: Option<f64>,
}

/// Reads events from frames: every change of a state, every NMT command, every emergency.
pub(crate) struct EventReader {
    sources: BTreeMap<u32, Source>,
    events: Vec<(Duration, Level, String)>,
    zero: Option<Duration>,
}

impl EventReader {
    pub(crate) fn new(database: &Database) -> Self {
        let sources = database
            .messages()
            .iter()
            .filter_map(|message| source(database, message));
        let sources = sources
            .map(|source| (source.signal.raw_id(), source))
            .collect();
        Self {
            sources,
            events: Vec::new(),
            zero: None,
        }
    }

    pub(crate) fn take(&mut self, stamped: &Stamped, scenario_time: Option<Duration>) {
        if let (None, Some(time)) = (self.zero, scenario_time) {
            self.zero = Some(stamped.time.saturating_sub(time));
        }
        let Some(source) = self.sources.get_mut(&stamped.frame.raw_id()) else {
            return;
        };
        let Some(value) = source.signal.decode(&stamped.frame) else {
            return;
        };
        if source.kind == Kind::State && source.last == Some(value) {
            return;
        }
        let before = source
            .last
            .replace(value)
            .and_then(|value| source.definition.label(value));
        let label = source.definition.label(value);
        if source.kind == Kind::State && before.is_some() && before == label {
            return;
        }
        let label = label.map_or_else(|| format!("{value}"), str::to_owned);
        let (level, text) = describe(source.kind, &source.node, value, &label);
        self.events.push((stamped.time, level, text));
    }

    /// All events in the order of time, with those of the scenario among them.
    pub(crate) fn finish(self, scenario: &Scenario) -> Vec<Event> {
        let zero = self.zero.unwrap_or_default();
        let mut events: Vec<Event> = Vec::new();
        for (time, level, text) in self.events {
            events.push(Event {
                time_seconds: time.as_secs_f64() - zero.as_secs_f64(),
                level,
                text,
            });
        }
        for event in scenario.events() {
            events.push(Event {
                time_seconds: event.at_seconds,
                level: Level::Warning,
                text: event.text,
            });
        }
        events.sort_by(|left, right| left.time_seconds.total_cmp(&right.time_seconds));
        events
    }
}

/// The signal of a message that makes events, if it has one.
fn source(database: &Database, message: &Message) -> Option<Source> {
    let kinds = [
        ("nmt_state", Kind::State),
        ("statusword_state", Kind::State),
        ("nmt_command", Kind::Command),
        ("error_code", Kind::Emergency),
    ];
    kinds.into_iter().find_map(|(name, kind)| {
        let path = format!("{}.{name}", message.name);
        let node = message
            .name
            .split('_')
            .next()
            .unwrap_or_default()
            .to_owned();
        let (signal, definition) = (database.signal(&path)?, database.definition(&path)?.clone());
        Some(Source {
            signal,
            definition,
            kind,
            node,
            last: None,
        })
    })
}

fn describe(kind: Kind, node: &str, value: f64, label: &str) -> (Level, String) {
    match kind {
        Kind::State if label.starts_with("fault") => (Level::Error, format!("{node}: {label}")),
        Kind::State => (Level::Info, format!("{node}: {label}")),
        Kind::Command => (Level::Info, format!("NMT command: {label}")),
        Kind::Emergency if value == 0.0 => (Level::Info, format!("{node}: emergency over")),
        Kind::Emergency => (Level::Error, format!("{node}: emergency {label}")),
    }
}
