//! Events of a run other than cyclic traffic: start-up, states, emergencies, disturbances.

use std::collections::BTreeMap;
use std::time::Duration;

use can::CanFrame;
use can::error_frames::{self, ErrorMessage};
use dbc::{Database, Signal, SignalHandle, names};
use platform::terminal::printable;
use scenario::Trial;
use scenario::expect::Emergency;
use scenario::node::Nodes;

use crate::identifiers::ByIdentifier;
use crate::log::Stamped;
use crate::occurrences::{Notes, Occurrence};

/// Silence after which an error of the bus makes a new event.
const BUS_ERROR_PAUSE: Duration = Duration::from_secs(1);

/// Severity of an event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// A part of a normal run.
    #[default]
    Info,
    /// A fault that the scenario injects.
    Warning,
    /// A fault.
    Error,
}

/// Event on the bus or of the scenario.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Event {
    pub level: Level,
    /// Description of the event for the user.
    pub text: String,
    /// Emergency that a node sent.
    pub emergency: Option<Emergency>,
}

impl Event {
    /// Makes an event. Its text cannot steer a terminal, even if it holds labels of a foreign DBC.
    pub fn new(level: Level, text: &str) -> Self {
        Self {
            level,
            text: printable(text).into_owned(),
            emergency: None,
        }
    }
}

/// All events of a run.
pub type Events = Vec<Occurrence<Event>>;

/// Rule by which a message makes events.
#[derive(Clone, Copy, PartialEq, Eq)]
enum EventKind {
    /// State, at each change.
    State,
    /// Command, with every message.
    Command,
    /// Emergency, with every message; 0 means that it is over.
    Emergency,
}

/// Signal that makes events.
struct EventSignal {
    signal: SignalHandle,
    definition: Signal,
    kind: EventKind,
    /// Node of the signal.
    node: String,
    /// Latest value, and the bits from which it was decoded.
    last: Option<f64>,
    last_bits: Option<u64>,
    /// Signal that explains an emergency further.
    cause: Option<(SignalHandle, Signal)>,
}

impl EventSignal {
    /// Returns the signal's value with its label, if it makes an event.
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

    /// Returns the label of the signal that explains an emergency further.
    fn cause(&self, stamped: &Stamped) -> Option<&str> {
        let (signal, definition) = self.cause.as_ref()?;
        definition.label(signal.decode(&stamped.frame)?)
    }
}

/// Reader of events from frames: every change of a state, every NMT command, every emergency.
pub(crate) struct EventReader {
    nodes: Nodes,
    has_several_loops: bool,
    signals: ByIdentifier<EventSignal>,
    /// Events with recording times.
    events: Notes<Event>,
    /// Time of the last sighting of each error.
    bus_errors: BTreeMap<String, Duration>,
}

impl EventReader {
    /// Makes the reader of these nodes.
    pub(crate) fn new(database: &Database, nodes: &Nodes, has_several_loops: bool) -> Self {
        let signals = event_signals(database, nodes)
            .into_iter()
            .map(|signal| (signal.signal.raw_id(), signal));
        Self {
            signals: signals.collect(),
            nodes: nodes.clone(),
            has_several_loops,
            events: Notes::default(),
            bus_errors: BTreeMap::new(),
        }
    }

    /// Takes each frame of the bus.
    #[inline]
    pub(crate) fn on_frame(&mut self, stamped: &Stamped) {
        if let Some(message) = error_frames::read(&stamped.frame) {
            self.on_error_frame(stamped.time, message);
            return;
        }
        let signal = self.signals.get_mut(stamped.frame.raw_id());
        let Some((signal, (value, label))) =
            signal.and_then(|signal| signal.read(stamped).map(|read| (signal, read)))
        else {
            return;
        };
        let at_seconds = stamped.time.as_secs_f64();
        let node = &signal.node;
        let (level, text) = match signal.kind {
            EventKind::State => {
                let is_fault = label.starts_with("fault");
                let level = if is_fault { Level::Error } else { Level::Info };
                (level, format!("{node}: {label}"))
            }
            EventKind::Command => {
                let addressee = match self.has_several_loops {
                    true => addressee(&stamped.frame, &self.nodes),
                    false => String::new(),
                };
                (Level::Info, format!("NMT command: {label}{addressee}"))
            }
            EventKind::Emergency if value == 0.0 => {
                (Level::Info, format!("{node}: emergency over"))
            }
            EventKind::Emergency => {
                let cause = signal
                    .cause(stamped)
                    .map_or_else(String::new, |cause| format!(": {cause}"));
                (Level::Error, format!("{node}: emergency {label}{cause}"))
            }
        };
        let is_emergency = signal.kind == EventKind::Emergency && value != 0.0;
        let emergency = || Emergency {
            node: node.clone(),
            code: word(value),
        };
        let event = Event {
            emergency: is_emergency.then(emergency),
            ..Event::new(level, &text)
        };
        self.events.add(at_seconds, event);
    }

    /// Takes the report of a CAN driver. An error that it may report with each frame makes an event only when it begins.
    fn on_error_frame(&mut self, time: Duration, message: ErrorMessage) {
        let node = name_or_bench(message.node, &self.nodes);
        let text = format!("{node}: {}", message.text);
        let before = self.bus_errors.insert(text.clone(), time);
        let goes_on = before.is_some_and(|before| time.saturating_sub(before) < BUS_ERROR_PAUSE);
        if goes_on && !message.is_state {
            return;
        }
        let level = if message.is_good {
            Level::Info
        } else {
            Level::Error
        };
        self.events
            .add(time.as_secs_f64(), Event::new(level, &text));
    }

    /// Takes the events since the last call, with their times since scenario time 0.
    pub(crate) fn take(&mut self, zero: Duration) -> Events {
        self.events.take_since(zero.as_secs_f64())
    }
}

/// Returns the steps, disturbances and faults of a loop, in no order; `loop_name` is its name, where there are several.
pub(crate) fn planned(trial: &Trial, loop_name: Option<&str>) -> Events {
    let mut events = Events::new();
    let mut add = |at_seconds, level, text: &str| {
        events.push(Occurrence::new(at_seconds, Event::new(level, text)));
    };
    let prefix = loop_name.map_or_else(String::new, |name| format!("{name}: "));
    let unit = trial.wiring.feedback.quantity.unit.symbol();
    for step in &trial.reference.step {
        let text = format!("{prefix}step to {} {unit}", step.position);
        add(step.at_seconds, Level::Info, &text);
    }
    for change in trial.disturbances() {
        let (window, text) = (change.window, change.text);
        // Each loop of which it is a signal has it.
        let is_named = loop_name.is_some() || trial.wiring.io_nodes().count() > 1;
        let node = Some(format!("{}: ", change.node)).filter(|_| is_named);
        let prefix = node.unwrap_or_default();
        add(window.from_seconds, Level::Info, &format!("{prefix}{text}"));
        if window.until_seconds > window.from_seconds {
            let of = text.split([',', ' ']).next().unwrap_or_default();
            add(
                window.until_seconds,
                Level::Info,
                &format!("{prefix}{of} off"),
            );
        }
    }
    for fault in trial.loop_faults() {
        let text = fault.text(&trial.wiring.shared.nodes, loop_name.is_some());
        add(fault.from_seconds.unwrap_or(0.0), Level::Warning, &text);
        let is_instant = fault.from_seconds == fault.until_seconds;
        if let Some(end) = fault.until_seconds.filter(|_| !is_instant) {
            add(end, Level::Info, &format!("{text} over"));
        }
    }
    events
}

/// Returns the value of a signal that is a word, such as an error code or a statusword.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a signal of 16 bits"
)]
pub fn word(value: f64) -> u16 {
    value as u16
}

/// Returns the signals that make events: commands of NMT, and for each node its state, its statusword and its emergencies.
fn event_signals(database: &Database, nodes: &Nodes) -> Vec<EventSignal> {
    let make = |message: &str, name: &str, kind, node: &str| {
        let message = database.message(message)?;
        let definition = message.signal(name)?;
        Some(EventSignal {
            signal: message.handle(definition),
            definition: definition.clone(),
            kind,
            node: node.to_owned(),
            last: None,
            last_bits: None,
            cause: cause(database, &message.name),
        })
    };
    let node_events = nodes.iter().flat_map(|(_, node)| {
        let node = node.name.as_str();
        let services = [
            (names::HEARTBEAT, names::NMT_STATE, EventKind::State),
            (names::TPDO1, names::STATUSWORD, EventKind::State),
            (names::EMERGENCY, "error_code", EventKind::Emergency),
        ];
        services
            .map(|(service, signal, kind)| make(&names::message(node, service), signal, kind, node))
    });
    let nmt = make("nmt_command", "nmt_command", EventKind::Command, "nmt");
    [nmt].into_iter().chain(node_events).flatten().collect()
}

/// Returns the name of the node with this node-ID, or of the bench for an unknown one.
fn name_or_bench(id: u8, nodes: &Nodes) -> &str {
    nodes
        .with_id(id)
        .map_or(names::BENCH, |node| &nodes[node].name)
}

/// Describes the addressee of a command.
fn addressee(frame: &CanFrame, nodes: &Nodes) -> String {
    match frame.data() {
        [_, 0, ..] => " to all nodes".to_owned(),
        [_, id, ..] => match nodes.with_id(*id) {
            Some(node) => format!(" to {}", nodes[node].name),
            None => format!(" to node {id}"),
        },
        _ => String::new(),
    }
}

/// Returns the signal that explains an emergency further, if its values have names.
fn cause(database: &Database, message: &str) -> Option<(SignalHandle, Signal)> {
    let path = format!("{message}.{}", names::MANUFACTURER_ERROR);
    Some((database.signal(&path)?, database.definition(&path)?.clone()))
}

#[cfg(test)]
mod tests {
    use dbc::Quantities;
    use dbc::messages::{Heading, services};
    use scenario::node::{Node, Profile};

    use super::*;
    use crate::occurrences::in_order;

    /// Returns the nodes of two loops with a drive each.
    fn two_drives() -> Nodes {
        let drives = [("left", 0x12), ("right", 0x13)];
        let drives = drives.map(|(name, id)| Node::canopen(name, id, Profile::Drive));
        let controller = Node::canopen("controller", 0x01, Profile::Manager);
        Nodes::new([controller].into_iter().chain(drives)).unwrap()
    }

    #[test]
    fn no_event_steers_a_terminal() {
        let event = Event::new(Level::Info, "drive: \u{1b}]0;a\u{7} \u{202e}b °C");
        assert_eq!(event.text, r"drive: \u001b]0;a\u0007 \u202eb °C");
    }

    #[test]
    fn among_several_loops_an_event_names_its_node() {
        let nodes = two_drives();
        let to = |node| addressee(&CanFrame::new(0, &[1, node]), &nodes);
        assert_eq!(
            [0x13, 0, 0x14].map(to),
            [" to right", " to all nodes", " to node 20"]
        );
        assert_eq!(
            [0x01, 0x13, 0x7F].map(|node| name_or_bench(node, &nodes)),
            ["controller", "right", "bench"]
        );
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.pid]\n\
            [[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 35.0\n\
            [[fault.sensor.stuck]]\nfrom_seconds = 5.0\n[[fault.node.hang]]\nnode = \"drive\"\nfrom_seconds = 6.0\n\
            [[fault.node.hang]]\nnode = \"controller\"\nfrom_seconds = 7.0\n[[fault.bus.load]]\nidentifier = 1000\nperiod_milliseconds = 5.0\nfrom_seconds = 8.0\n";
        let trial = testing::part(text, "drive");
        let events = in_order(planned(&trial, Some("y")));
        let texts = Vec::from_iter(events.iter().map(|event| event.what.text.as_str()));
        assert_eq!(
            texts,
            [
                "y: step to 35 mm",
                "fault: drive sensor stuck",
                "fault: drive hang",
                "fault: controller hang",
                "fault: bus load"
            ]
        );
    }

    #[test]
    fn among_several_drives_an_emergency_names_the_one_concerned() {
        let drives = [("left", 0x12), ("right", 0x13)];
        let drives = drives.map(|(name, id)| (name, id, Quantities::default()));
        let heading = Heading::new("controller_emergency".to_owned(), "controller", []);
        let causes = services::causes_at(&drives);
        let bus = Database::from_messages(vec![services::emergency(heading, 0x081, false, causes)]);
        let mut reader = EventReader::new(&bus, &two_drives(), true);
        for node in [0x12, 0x13] {
            let frame = CanFrame::new(0x081, &[0, 0x10, 1, node, 6, 0, 0, 0]);
            reader.on_frame(&Stamped::new(Duration::ZERO, frame));
        }
        let events = reader.events.take_since(0.0);
        let texts = Vec::from_iter(events.iter().map(|event| event.text.as_str()));
        let start = "controller: emergency generic error: the drive reports an emergency";
        let expected = ["(left)", "(right)"].map(|node| format!("{start} {node}"));
        assert_eq!(texts, expected);
    }

    #[test]
    fn steps_and_disturbances_are_events_with_their_values() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 30.0\n[controller.pid]\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
            [[reference.step]]\nat_seconds = 10.0\nposition_millimetres = 35.0\n\
            [[reference.step]]\nat_seconds = 20.0\nposition_millimetres = 15.0\n\
            [[disturbance.fan]]\nfrom_seconds = 12.0\nuntil_seconds = 15.0\nconvection_factor = 5.0\n\
            [[disturbance.load]]\nat_seconds = 13.0\nadded_grams = 10.0\n\
            [[disturbance.load]]\nat_seconds = 25.0\nadded_grams = -5.0\n";
        let trial = testing::part(text, "drive");
        let taken = in_order(planned(&trial, None));
        let events = taken.iter();
        let texts = events.map(|event| format!("{} {}", event.time_seconds, event.text));
        assert_eq!(
            Vec::from_iter(texts),
            [
                "10 step to 35 mm",
                "12 fan, convection × 5",
                "13 load +10 g",
                "15 fan off",
                "20 step to 15 mm",
                "25 load -5 g"
            ]
        );
    }

    #[test]
    fn faults_are_the_only_warnings_of_a_scenario() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.pid]\n\
            [[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 35.0\n\
            [[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 3.0\nconvection_factor = 5.0\n\
            [[disturbance.load]]\nat_seconds = 4.0\nadded_grams = 10.0\n\
            [[fault.sensor.stuck]]\nfrom_seconds = 5.0\nuntil_seconds = 6.0\n";
        let trial = testing::part(text, "drive");
        let events = in_order(planned(&trial, None));
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
