//! What happened on the bus besides the cyclic traffic: start-up, states, emergencies, disturbances.

use std::collections::BTreeMap;
use std::time::Duration;

use dbc::{Database, Message, Signal, SignalHandle};
use rig::error_frames::{self, ErrorMessage};
use scenario::Scenario;
use scenario::expect::Emergency;

use crate::identifiers::ByIdentifier;
use crate::log::Stamped;

/// An error of the bus that was silent for so long begins anew.
const BUS_ERROR_PAUSE: Duration = Duration::from_secs(1);

/// How grave an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Part of a normal run.
    Info,
    /// A fault that the scenario injects.
    Warning,
    /// A fault.
    Error,
}

/// One thing that happened, on the bus or by the scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct TimelineEvent {
    /// Scenario time; negative before scenario time 0.
    pub time_seconds: f64,
    pub level: Level,
    /// What happened, for people.
    pub text: String,
}

/// An emergency that a node sent.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedEmergency {
    /// Scenario time.
    pub time_seconds: f64,
    pub emergency: Emergency,
}

/// What of a message is worth an event.
#[derive(Clone, Copy, PartialEq, Eq)]
enum EventKind {
    /// A state, whenever it changes.
    State,
    /// Every message.
    Command,
    /// Every message; 0 says that the emergency is over.
    Emergency,
}

/// A signal that makes events.
struct EventSignal {
    signal: SignalHandle,
    definition: Signal,
    kind: EventKind,
    /// Whose it is, as a scenario of one drive names it.
    node: String,
    /// The same for people, who see all loops.
    shown: String,
    /// The latest value, and the bits that it was made of.
    last: Option<f64>,
    last_bits: Option<u64>,
    /// What explains an emergency further.
    cause: Option<(SignalHandle, Signal)>,
}

impl EventSignal {
    /// The signal's value with its label, where it makes an event.
    fn read(&mut self, stamped: &Stamped) -> Option<(f64, String)> {
        let is_state = self.kind == EventKind::State;
        let bits = self.signal.bits(&stamped.frame);
        if is_state && self.last_bits == bits {
            return None;
        }
        let value = self.signal.decode(&stamped.frame)?;
        self.last_bits = bits;
        let before = self
            .last
            .replace(value)
            .and_then(|value| self.definition.label(value));
        let label = self.definition.label(value);
        if is_state && before.is_some() && before == label {
            return None;
        }
        let text = label.map_or_else(|| format!("{value}"), str::to_owned);
        Some((value, text))
    }

    /// The label of what explains an emergency further; where there are several drives, with the number of the node concerned,
    /// which is the lowest byte.
    fn cause(&self, stamped: &Stamped) -> Option<String> {
        let (signal, definition) = self.cause.as_ref()?;
        let value = signal.decode(&stamped.frame)?;
        let node = value % 256.0;
        let named = || Some(format!("{} (node {node})", definition.label(value - node)?));
        definition.label(value).map(str::to_owned).or_else(named)
    }
}

/// Reads events from frames: every change of a state, every NMT command, every emergency.
pub(crate) struct EventReader {
    signals: ByIdentifier<EventSignal>,
    events: Vec<(Duration, Level, String)>,
    emergencies: Vec<(Duration, Emergency)>,
    /// When each was last seen.
    bus_errors: BTreeMap<String, Duration>,
    given_until_seconds: f64,
}

impl EventReader {
    /// Of several loops each has a reader, which is given its name.
    pub(crate) fn new(database: &Database, loop_name: Option<&str>) -> Self {
        let messages = database.messages().iter();
        let signals = messages.filter_map(|message| event_signal(database, message, loop_name));
        Self {
            signals: signals
                .map(|signal| (signal.signal.raw_id(), signal))
                .collect(),
            events: Vec::new(),
            emergencies: Vec::new(),
            bus_errors: BTreeMap::new(),
            given_until_seconds: f64::NEG_INFINITY,
        }
    }

    /// The identifiers of the messages that make events; errors of the bus make some besides.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.signals.raw_ids()
    }

    pub(crate) fn on_frame(&mut self, stamped: &Stamped) {
        if let Some(message) = error_frames::read(&stamped.frame) {
            self.on_error_frame(stamped.time, message);
            return;
        }
        let Some(signal) = self.signals.get_mut(stamped.frame.raw_id()) else {
            return;
        };
        let Some((value, label)) = signal.read(stamped) else {
            return;
        };
        let (level, mut text) = describe(signal.kind, &signal.shown, value, &label);
        if signal.kind == EventKind::Emergency && value != 0.0 {
            let emergency = emergency(&signal.node, value);
            self.emergencies.push((stamped.time, emergency));
            if let Some(cause) = signal.cause(stamped) {
                text += &format!(": {cause}");
            }
        }
        self.events.push((stamped.time, level, text));
    }

    /// What a CAN driver reports. What it may report with each frame is an event when it begins.
    fn on_error_frame(&mut self, time: Duration, message: ErrorMessage) {
        let ErrorMessage {
            node,
            text,
            is_good,
            is_state,
        } = message;
        let text = format!("{}: {text}", controller_of(node));
        let before = self.bus_errors.insert(text.clone(), time);
        let goes_on = before.is_some_and(|before| time < before + BUS_ERROR_PAUSE);
        if goes_on && !is_state {
            return;
        }
        let level = if is_good { Level::Info } else { Level::Error };
        self.events.push((time, level, text));
    }

    /// The emergencies in the order of time; the scenario began at `zero`, on the recording's clock.
    pub(crate) fn emergencies(&self, zero: Option<Duration>) -> Vec<TimedEmergency> {
        let zero = zero.unwrap_or_default().as_secs_f64();
        let emergencies = self
            .emergencies
            .iter()
            .map(|(time, emergency)| TimedEmergency {
                time_seconds: time.as_secs_f64() - zero,
                emergency: emergency.clone(),
            });
        emergencies.collect()
    }

    /// What happened since the last time, and what the scenario did before `until_seconds`, in the order of time. Before
    /// scenario time 0 is known there is nothing, unless `until_seconds` is infinite.
    pub(crate) fn take_until(
        &mut self,
        until_seconds: f64,
        scenario: &Scenario,
        zero: Option<Duration>,
    ) -> Vec<TimelineEvent> {
        if zero.is_none() && until_seconds.is_finite() {
            return Vec::new();
        }
        let zero_seconds = zero.unwrap_or_default().as_secs_f64();
        let from_seconds = std::mem::replace(&mut self.given_until_seconds, until_seconds);
        let on_bus = self
            .events
            .drain(..)
            .map(|(time, level, text)| TimelineEvent {
                time_seconds: time.as_secs_f64() - zero_seconds,
                level,
                text,
            });
        let planned = scenario
            .events()
            .into_iter()
            .filter(|event| from_seconds <= event.at_seconds && event.at_seconds < until_seconds)
            .map(|event| TimelineEvent {
                time_seconds: event.at_seconds,
                level: match event.is_fault {
                    true => Level::Warning,
                    false => Level::Info,
                },
                text: event.text,
            });
        let mut events: Vec<TimelineEvent> = on_bus.chain(planned).collect();
        events.sort_by(|left, right| left.time_seconds.total_cmp(&right.time_seconds));
        events
    }
}

fn emergency(node: &str, value: f64) -> Emergency {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a signal of 16 bits"
    )]
    let code = value as u16;
    Emergency {
        node: node.to_owned(),
        code,
    }
}

/// The signal of a message that makes events, if it has one.
fn event_signal(
    database: &Database,
    message: &Message,
    loop_name: Option<&str>,
) -> Option<EventSignal> {
    let kinds = [
        ("nmt_state", EventKind::State),
        ("statusword_state", EventKind::State),
        ("nmt_command", EventKind::Command),
        ("error_code", EventKind::Emergency),
    ];
    kinds.into_iter().find_map(|(name, kind)| {
        let definition = message.signal(name)?;
        let (node, shown) = node_of(&message.name, loop_name);
        Some(EventSignal {
            signal: message.handle(definition),
            definition: definition.clone(),
            kind,
            node,
            shown,
            last: None,
            last_bits: None,
            cause: cause(database, &message.name),
        })
    })
}

/// Whose a message is: as a scenario of one drive names the node, and for people. Messages of other loops begin with their names.
fn node_of(message: &str, loop_name: Option<&str>) -> (String, String) {
    let shown = |name: &str, node: &str| match node {
        "drive" => name.to_owned(),
        node => format!("{name} {node}"),
    };
    let of_others = ["drive", "disturbance"].iter().find_map(|node| {
        let (name, _) = message.split_once(&format!("_{node}_"))?;
        Some(shown(name, node))
    });
    if let Some(other) = of_others {
        return (other.clone(), other);
    }
    let node = message.split('_').next().unwrap_or_default();
    let own = loop_name.filter(|_| ["drive", "disturbance"].contains(&node));
    let own = own.map_or_else(|| node.to_owned(), |name| shown(name, node));
    (node.to_owned(), own)
}

/// Whose CAN controller a node's number stands for.
fn controller_of(node: u8) -> &'static str {
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

fn describe(kind: EventKind, node: &str, value: f64, label: &str) -> (Level, String) {
    match kind {
        EventKind::State if label.starts_with("fault") => {
            (Level::Error, format!("{node}: {label}"))
        }
        EventKind::State => (Level::Info, format!("{node}: {label}")),
        EventKind::Command => (Level::Info, format!("NMT command: {label}")),
        EventKind::Emergency if value == 0.0 => (Level::Info, format!("{node}: emergency over")),
        EventKind::Emergency => (Level::Error, format!("{node}: emergency {label}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_has_one_name_whichever_loop_sees_it() {
        let shown = |message, loop_name| node_of(message, loop_name).1;
        assert_eq!(shown("drive_heartbeat", None), "drive");
        for (of_x, of_y, name) in [
            ("drive_heartbeat", "x_1_drive_heartbeat", "x_1"),
            (
                "disturbance_emergency",
                "x_1_disturbance_emergency",
                "x_1 disturbance",
            ),
            ("y_drive_tpdo1", "drive_tpdo1", "y"),
            ("controller_heartbeat", "controller_heartbeat", "controller"),
        ] {
            assert_eq!(shown(of_x, Some("x_1")), name);
            assert_eq!(shown(of_y, Some("y")), name);
        }
        // What a scenario of one drive calls it.
        assert_eq!(node_of("drive_emergency", Some("y")).0, "drive");
    }

    #[test]
    fn of_what_the_scenario_does_only_faults_are_warnings() {
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 9.0\n[controller.pid]\n\
            [[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 35.0\n\
            [[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 3.0\nconvection_factor = 5.0\n\
            [[disturbance.load]]\nat_seconds = 4.0\nadded_grams = 10.0\n\
            [[fault.sensor.stuck]]\nfrom_seconds = 5.0\nuntil_seconds = 6.0\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let mut reader = EventReader::new(Database::shipped(), None);
        let events = reader.take_until(f64::INFINITY, &scenario, Some(Duration::ZERO));
        let levels = events.iter().map(|event| (event.time_seconds, event.level));
        let expected = [
            (1.0, Level::Info),
            (2.0, Level::Info),
            (3.0, Level::Info),
            (4.0, Level::Info),
            (5.0, Level::Warning),
            (6.0, Level::Info),
        ];
        assert_eq!(levels.collect::<Vec<_>>(), expected);
    }
}
