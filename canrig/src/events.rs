//! What happened on the bus besides the cyclic traffic: start-up, states, emergencies, disturbances.

use std::collections::BTreeMap;
use std::time::Duration;

use dbc::{Database, Message, Signal, SignalHandle};
use scenario::Scenario;
use scenario::expect::Emergency;

use crate::error_frames::{self, ErrorMessage};
use crate::recording::Stamped;

/// An error of the bus that was silent for so long begins anew.
const BUS_ERROR_PAUSE: Duration = Duration::from_secs(1);

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

/// An emergency that a node told.
#[derive(Clone, Debug, PartialEq)]
pub struct ToldEmergency {
    /// Scenario time.
    pub time_seconds: f64,
    /// Who told which.
    pub emergency: Emergency,
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
    /// The latest value, and the bits that it was made of.
    last: Option<f64>,
    last_bits: Option<u64>,
    /// What explains an emergency further.
    cause: Option<(SignalHandle, Signal)>,
}

/// Reads events from frames: every change of a state, every NMT command, every emergency.
pub(crate) struct EventReader {
    /// By the raw identifier of their messages.
    sources: BTreeMap<u32, Source>,
    events: Vec<(Duration, Level, String)>,
    emergencies: Vec<(Duration, Emergency)>,
    /// When each was last told.
    bus_errors: BTreeMap<String, Duration>,
    told_until_seconds: f64,
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
            emergencies: Vec::new(),
            bus_errors: BTreeMap::new(),
            told_until_seconds: f64::NEG_INFINITY,
        }
    }

    /// The identifiers of the messages that make events; errors of the bus make some besides.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.sources.keys().copied()
    }

    pub(crate) fn take(&mut self, stamped: &Stamped) {
        if let Some(message) = error_frames::read(&stamped.frame) {
            self.take_error(stamped.time, message);
            return;
        }
        let Some(source) = self.sources.get_mut(&stamped.frame.raw_id()) else {
            return;
        };
        let bits = source.signal.bits(&stamped.frame);
        if source.kind == Kind::State && source.last_bits == bits {
            return;
        }
        let Some(value) = source.signal.decode(&stamped.frame) else {
            return;
        };
        source.last_bits = bits;
        let before = source
            .last
            .replace(value)
            .and_then(|value| source.definition.label(value));
        let label = source.definition.label(value);
        if source.kind == Kind::State && before.is_some() && before == label {
            return;
        }
        let label = label.map_or_else(|| format!("{value}"), str::to_owned);
        let (level, mut text) = describe(source.kind, &source.node, value, &label);
        if source.kind == Kind::Emergency && value != 0.0 {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a signal of 16 bits"
            )]
            let code = value as u16;
            let node = source.node.clone();
            let emergency = Emergency { node, code };
            self.emergencies.push((stamped.time, emergency));
            let cause = source
                .cause
                .as_ref()
                .and_then(|(signal, definition)| definition.label(signal.decode(&stamped.frame)?));
            if let Some(cause) = cause {
                text += &format!(": {cause}");
            }
        }
        self.events.push((stamped.time, level, text));
    }

    /// What a CAN driver tells. What it may tell with each frame is told when it begins.
    fn take_error(&mut self, time: Duration, message: ErrorMessage) {
        let ErrorMessage {
            node,
            text,
            is_good,
            is_state,
        } = message;
        let text = format!("{}: {text}", station(node));
        let before = self.bus_errors.insert(text.clone(), time);
        let goes_on = before.is_some_and(|before| time < before + BUS_ERROR_PAUSE);
        if goes_on && !is_state {
            return;
        }
        let level = if is_good { Level::Info } else { Level::Error };
        self.events.push((time, level, text));
    }

    /// The emergencies in the order of time; the scenario began at `zero`, on the recording's clock.
    pub(crate) fn emergencies(&self, zero: Option<Duration>) -> Vec<ToldEmergency> {
        let zero = zero.unwrap_or_default().as_secs_f64();
        let told = self.emergencies.iter();
        told.map(|(time, emergency)| ToldEmergency {
            time_seconds: time.as_secs_f64() - zero,
            emergency: emergency.clone(),
        })
        .collect()
    }

    /// What happened since the last time, and what the scenario did before `until_seconds`, in the order of time. Before
    /// scenario time 0 is known there is nothing, unless `until_seconds` is infinite.
    pub(crate) fn take_until(
        &mut self,
        until_seconds: f64,
        scenario: &Scenario,
        zero: Option<Duration>,
    ) -> Vec<Event> {
        if zero.is_none() && until_seconds.is_finite() {
            return Vec::new();
        }
        let zero = zero.unwrap_or_default();
        let from_seconds = std::mem::replace(&mut self.told_until_seconds, until_seconds);
        let mut events: Vec<Event> = Vec::new();
        for (time, level, text) in self.events.drain(..) {
            events.push(Event {
                time_seconds: time.as_secs_f64() - zero.as_secs_f64(),
                level,
                text,
            });
        }
        let is_new = |time: f64| from_seconds <= time && time < until_seconds;
        for event in scenario.events() {
            if is_new(event.at_seconds) {
                events.push(Event {
                    time_seconds: event.at_seconds,
                    level: Level::Warning,
                    text: event.text,
                });
            }
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
            last_bits: None,
            cause: cause(database, &message.name),
        })
    })
}

/// Whose CAN controller a node's number stands for.
fn station(node: u8) -> &'static str {
    match node {
        0x01 => "controller",
        0x10 => "drive",
        _ => "bench",
    }
}

/// The signal that explains an emergency further, where its values have names.
fn cause(database: &Database, message: &str) -> Option<(SignalHandle, Signal)> {
    let path = format!("{message}.manufacturer_error");
    Some((database.signal(&path)?, database.definition(&path)?.clone()))
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
