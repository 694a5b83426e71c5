//! The frames of a rig, composed of those of its nodes.
//!
//! Each node contributes its messages under its own name. The shipped DBC describes the smallest rig; its messages are the
//! patterns of all others.

use crate::coding::{Coding, Kind};
use crate::database::{Database, Message, Signal};
use crate::law::{BYTE, first_term, layout};
use crate::loops::TERMS_EVERY_CYCLES;
use crate::names::{self, TERMS_MAX};
use crate::node_objects::{PLANT_OBJECTS, SIGNALS_IN_TPDO2, object_name};

/// Names of the nodes of the shipped DBC.
const CONTROLLER: &str = "controller";
const DRIVE: &str = "drive";
const IO: &str = "disturbance";
/// Messages that belong to the bus.
const BUS_MESSAGES: [&str; 2] = [names::NMT_COMMAND, names::SYNC];
const BITS: u8 = 16;
const FLOAT_BITS: u8 = 32;

/// A drive of the bus.
#[derive(Debug)]
struct Drive {
    name: String,
    node_id: u8,
    /// Names of what it measures and of what it commands.
    quantities: [String; 2],
}

impl Drive {
    /// Returns a text about a drive of the shipped DBC in the words of this one.
    fn words(&self, text: &str) -> String {
        let [measured, commanded] = &self.quantities;
        // A measured quantity may have the name of a commanded one, and no text has braces.
        let text = text.replace(names::SHIPPED_COMMAND, "{}");
        let text = match measured.as_str() {
            names::SHIPPED_SIGNAL => text,
            measured => {
                let range = text.replace("the travel", "its range");
                range.replace(names::SHIPPED_SIGNAL, measured)
            }
        };
        text.replace("{}", commanded)
    }
}

/// Composes a database node by node.
#[derive(Debug)]
pub struct Composer {
    controller: String,
    drives: Vec<Drive>,
    io_nodes: Vec<String>,
    /// Names by node-ID.
    nodes: Vec<(u8, String)>,
    messages: Vec<Message>,
}

impl Composer {
    /// Starts a bus with its controller.
    pub fn new(controller: &str, node_id: u8) -> Self {
        let mut composer = Self {
            controller: controller.to_owned(),
            drives: Vec::new(),
            io_nodes: Vec::new(),
            nodes: Vec::new(),
            messages: BUS_MESSAGES.map(pattern).into(),
        };
        composer.add_node(
            CONTROLLER,
            (controller, node_id),
            &names::CONTROLLER_SERVICES,
        );
        composer
    }

    fn add_node(&mut self, like: &str, (name, node_id): (&str, u8), services: &[&str]) {
        self.nodes.push((node_id, name.to_owned()));
        self.add(like, (name, node_id), services);
    }

    /// Adds the messages of a node for these services, like those of a node of the shipped DBC.
    fn add(&mut self, like: &str, (name, node_id): (&str, u8), services: &[&str]) {
        let has = |(service, _): &(&str, u32)| services.contains(service);
        for (service, function) in names::SERVICES.into_iter().filter(has) {
            // The shipped plant has no more signals than TPDO2 holds.
            let known = match service {
                names::TPDO3 => names::TPDO2,
                service => service,
            };
            let mut message = pattern(&names::message(like, known));
            message.name = names::message(name, service);
            message.raw_id = function + u32::from(node_id);
            message.sender = message.sender.map(|sender| self.renamed(&sender, name));
            for signal in &mut message.signals {
                for receiver in &mut signal.receivers {
                    *receiver = self.renamed(receiver, name);
                }
            }
            self.messages.push(message);
        }
    }

    /// Returns the message of a node for a service, if it has been added.
    fn message_mut(&mut self, node: &str, service: &str) -> Option<&mut Message> {
        let name = names::message(node, service);
        self.messages.iter_mut().find(|one| one.name == name)
    }

    /// Returns the name on this bus of a node of the shipped DBC, in a message of the node `name`.
    fn renamed(&self, shipped: &str, name: &str) -> String {
        match shipped {
            CONTROLLER => self.controller.clone(),
            DRIVE | IO => name.to_owned(),
            other => other.to_owned(),
        }
    }

    /// Adds a drive, with the signals of its plant that an emulated one publishes.
    #[must_use]
    pub fn with_drive(mut self, (name, node_id): (&str, u8), published: Option<&[Signal]>) -> Self {
        let services = names::SERVICES.into_iter().map(|(service, _)| service);
        let own = services.filter(|service| !names::PLANT_SERVICES.contains(service));
        self.add_node(DRIVE, (name, node_id), &Vec::from_iter(own));
        if let Some(published) = published {
            self.add_plant((name, node_id), published);
        }
        self.drives.push(Drive {
            name: name.to_owned(),
            node_id,
            quantities: [names::SHIPPED_SIGNAL, names::SHIPPED_COMMAND].map(str::to_owned),
        });
        self
    }

    /// Names what a drive measures and commands.
    #[must_use]
    pub fn measuring(mut self, drive: &str, measured: &str, commanded: &str) -> Self {
        let its = self.drives.iter_mut().filter(|one| one.name == drive);
        for drive in its {
            drive.quantities = [measured, commanded].map(str::to_owned);
        }
        self
    }

    /// Edits the message of a node for a service, if it has been added.
    #[must_use]
    pub fn edited(mut self, node: &str, service: &str, edit: impl FnOnce(&mut Message)) -> Self {
        if let Some(message) = self.message_mut(node, service) {
            edit(message);
        }
        self
    }

    /// Adds the signals of a plant: the first two before its true position, the others in a further message.
    fn add_plant(&mut self, (name, node_id): (&str, u8), published: &[Signal]) {
        let (first, others) = published.split_at(published.len().min(SIGNALS_IN_TPDO2));
        let place = self.messages.len();
        self.add(DRIVE, (name, node_id), &names::PLANT_SERVICES);
        let [tpdo2, tpdo3, _] = &mut self.messages[place..] else {
            return;
        };
        let like = std::mem::take(&mut tpdo2.signals);
        tpdo2.signals = laid_out(first, &PLANT_OBJECTS, &like);
        tpdo2.signals.extend_from_slice(&like[SIGNALS_IN_TPDO2..]);
        if others.is_empty() {
            self.messages.remove(place + 1);
            return;
        }
        tpdo3.signals = laid_out(others, &PLANT_OBJECTS[SIGNALS_IN_TPDO2..], &like);
        tpdo3.length_bytes = bytes_of(&tpdo3.signals);
        "TPDO3 of the emulated drive, every SYNC: more of the truth."
            .clone_into(&mut tpdo3.comment);
    }

    /// Adds an io node with these outputs; with those of the shipped one if there are none.
    #[must_use]
    pub fn with_io(mut self, (name, node_id): (&str, u8), outputs: &[Signal]) -> Self {
        self.add_node(IO, (name, node_id), &names::IO_SERVICES);
        self.io_nodes.push(name.to_owned());
        let message = self.message_mut(name, names::RPDO1);
        if let Some(message) = message.filter(|_| !outputs.is_empty()) {
            message.signals = laid_out(outputs, &[], &message.signals);
            for (number, signal) in (1..).zip(&mut message.signals) {
                // Write analogue output 16-bit (CiA 401).
                signal.coding.kind = Kind::Signed;
                signal.object = format!("0x6411:{number:02X}");
            }
            message.length_bytes = bytes_of(&message.signals);
        }
        self
    }

    /// Adds the terms of the law of a loop, by its place and its name, which is empty if it is the only one.
    #[must_use]
    pub fn with_terms(
        mut self,
        (loop_place, loop_name): (u8, &str),
        identifiers: [u16; TERMS_MAX],
        terms: &[Signal],
    ) -> Self {
        let objects = layout(terms).unwrap_or_default();
        for (place, identifier) in identifiers.into_iter().enumerate() {
            let numbered = (first_term(loop_place)..).zip(&objects);
            let own = numbered.filter(|(_, object)| object.message == place);
            let length_bits: u8 = own.clone().map(|(_, object)| object.bits).sum();
            if length_bits == 0 {
                break;
            }
            let signals = own.flat_map(|(number, object)| {
                let terms = object.terms.iter().map(|(term, bit)| (&terms[*term], bit));
                terms.map(move |(term, bit)| law_signal(number, term, object.start_bit + bit))
            });
            self.messages.push(Message {
                name: names::terms(&self.controller, loop_name, place),
                raw_id: identifier.into(),
                length_bytes: length_bits / BYTE,
                sender: Some(self.controller.clone()),
                cycle_time_milliseconds: TERMS_EVERY_CYCLES.into(),
                comment: format!(
                    "TPDO{} of the controller, every {TERMS_EVERY_CYCLES}th SYNC: terms of the law.",
                    place + 1
                ),
                signals: signals.collect(),
            });
        }
        self
    }

    /// Adds the set-point of a loop and its rate, by the name of the set-point and the symbols of both units.
    #[must_use]
    pub fn with_set_point(
        mut self,
        loop_name: &str,
        identifier: u16,
        signal: &str,
        [unit, rate_unit]: [&str; 2],
    ) -> Self {
        let rate = format!("{signal}_per_second");
        let float = |name: &str, unit: &str, start_bit, comment: &str| {
            let coding = Coding::little_endian(start_bit, FLOAT_BITS, Kind::Float32, 1.0, None);
            Signal {
                receivers: vec![self.controller.clone()],
                ..Signal::new(name.to_owned(), unit, comment, coding)
            }
        };
        self.messages.push(Message {
            name: names::set_point(loop_name),
            raw_id: identifier.into(),
            length_bytes: 2 * FLOAT_BITS / 8,
            sender: Some(names::BENCH.to_owned()),
            cycle_time_milliseconds: 0,
            comment: "From the bench after a SYNC: what the scenario wants at the next one."
                .to_owned(),
            signals: vec![
                float(signal, unit, 0, "Set-point."),
                float(&rate, rate_unit, FLOAT_BITS, "Its first derivative."),
            ],
        });
        self
    }

    /// Words the causes of the controller's emergencies as the only drive measures and commands. Of several drives each has causes
    /// of its own, whose lowest byte is its node-ID.
    fn word_causes(&mut self) {
        let name = names::message(&self.controller, names::EMERGENCY);
        let mut messages = self.messages.iter_mut().filter(|one| one.name == name);
        let signals = messages.next().into_iter().flat_map(|one| &mut one.signals);
        for signal in signals.filter(|one| one.name == names::MANUFACTURER_ERROR) {
            if let [drive] = &self.drives[..] {
                let labels = signal.labels.iter_mut();
                labels.for_each(|(_, text)| *text = drive.words(text));
                continue;
            }
            let causes = signal.labels.clone();
            for drive in &self.drives {
                let of_drive = causes.iter().map(|(cause, text)| {
                    let text = format!("{} ({})", drive.words(text), drive.name);
                    (cause | i64::from(drive.node_id), text)
                });
                signal.labels.extend(of_drive);
            }
        }
    }

    /// Returns the database. Two of its messages may have the same identifier or name: see [`Database::refuse_duplicates`].
    pub fn finish(mut self) -> Database {
        let drives = self.drives.iter().map(|drive| &drive.name);
        let listeners = drives.chain(&self.io_nodes).cloned();
        let listeners = Vec::from_iter(listeners.chain([names::BENCH.to_owned()]));
        let heartbeat = names::message(&self.controller, names::HEARTBEAT);
        let is_for_all = |message: &&mut Message| {
            BUS_MESSAGES.contains(&message.name.as_str()) || message.name == heartbeat
        };
        for message in self.messages.iter_mut().filter(is_for_all) {
            message.sender = Some(self.controller.clone());
            for signal in &mut message.signals {
                signal.receivers.clone_from(&listeners);
            }
        }
        self.word_causes();
        let database = Database::from_messages(self.messages);
        let nodes = self.nodes.iter();
        database.with_nodes(nodes.map(|(node_id, name)| (*node_id, name.as_str())))
    }
}

/// Returns the signal of a term of a law, in its object and from its first bit on.
fn law_signal(object: u16, term: &Signal, start_bit: u8) -> Signal {
    Signal {
        coding: term.coding.starting_at(start_bit),
        labels: match term.coding.length_bits {
            1 => vec![(0, "no".to_owned()), (1, "yes".to_owned())],
            _ => Vec::new(),
        },
        receivers: vec![names::BENCH.to_owned()],
        object: object_name(object),
        ..term.clone()
    }
}

/// Returns a message of the shipped DBC.
fn pattern(name: &str) -> Message {
    let message = Database::shipped().message(name);
    message.expect("a test composes the shipped rig").clone()
}

fn bytes_of(signals: &[Signal]) -> u8 {
    signals.iter().map(|_| BITS / 8).sum()
}

/// Places signals one after the other from the first bit on, with the receivers of the patterns `like`, each with its object.
fn laid_out(signals: &[Signal], objects: &[u16], like: &[Signal]) -> Vec<Signal> {
    let starts = (0..=u8::MAX).step_by(usize::from(BITS)).enumerate();
    let laid_out = signals
        .iter()
        .zip(starts)
        .map(|(signal, (place, start_bit))| {
            let object = objects.get(place).map(|index| object_name(*index));
            Signal {
                coding: signal.coding.starting_at(start_bit),
                receivers: like[0].receivers.clone(),
                object: object.unwrap_or_default(),
                ..signal.clone()
            }
        });
    laid_out.collect()
}

#[cfg(test)]
mod tests {
    use can::CanFrame;

    use super::*;

    /// Identifiers of the shipped rig.
    const TERMS: [u16; TERMS_MAX] = [0x181, 0x281, 0x381, 0x481];

    fn signal(name: &str, kind: Kind) -> Signal {
        let coding = Coding::little_endian(0, BITS, kind, 0.5, None);
        Signal::new(name.to_owned(), "", "", coding)
    }

    fn composed(signals: &[Signal]) -> Database {
        let composer = Composer::new("controller", 1).with_drive(("drive", 0x10), Some(signals));
        composer.finish()
    }

    /// Returns the terms of the shipped DBC.
    fn shipped_terms() -> Vec<Signal> {
        let messages = Database::shipped().term_messages("controller", "");
        messages
            .flat_map(|message| message.signals.clone())
            .collect()
    }

    /// Returns a rig of two loops, of which the second has no io node.
    fn two_loops() -> Database {
        Composer::new("hand", 1)
            .with_drive(("left", 0x10), Some(&[]))
            .with_io(("fan", 0x11), &[])
            .with_terms((0, "x"), TERMS, &shipped_terms())
            .with_drive(("right", 0x12), Some(&[]))
            .measuring("right", "speed", "voltage")
            .with_terms((1, "y"), TERMS.map(|id| id + 0x20), &shipped_terms())
            .finish()
    }

    #[test]
    fn the_shipped_rig_is_the_shipped_dbc() {
        let shipped = Database::shipped();
        let messages = shipped.plant_messages("drive");
        let signals = messages.flat_map(|message| &message.signals);
        let signals =
            signals.filter(|signal| names::pattern(&signal.name) != Some(names::TRUE_POSITION));
        let composed = Composer::new("controller", 1)
            .with_drive(("drive", 0x10), Some(&Vec::from_iter(signals.cloned())))
            .with_io(("disturbance", 0x11), &[])
            .with_terms((0, ""), TERMS, &shipped_terms())
            .finish();
        for (ours, theirs) in composed.messages().iter().zip(shipped.messages()) {
            assert_eq!(ours, theirs);
        }
        assert_eq!(&composed, shipped);
    }

    /// A drive may measure a quantity that has the name of another one's command.
    #[test]
    fn a_text_about_a_drive_names_its_quantities() {
        let mut drive = Drive {
            name: "a".to_owned(),
            node_id: 1,
            quantities: ["current", "voltage"].map(str::to_owned),
        };
        let text = "position in the travel, current off";
        assert_eq!(drive.words(text), "current in its range, voltage off");
        drive.quantities = [names::SHIPPED_SIGNAL, names::SHIPPED_COMMAND].map(str::to_owned);
        assert_eq!(drive.words(text), text);
    }

    #[test]
    fn a_third_signal_goes_into_a_message_of_its_own() {
        let [a, b] = ["a", "b"].map(|name| signal(name, Kind::Unsigned));
        let database = composed(&[a.clone(), b, signal("c", Kind::Signed)]);
        let frame = CanFrame::new(0x390, &[0xFE, 0xFF]);
        let handle = database.signal("drive_tpdo3.c").unwrap();
        assert_eq!(handle.decode(&frame), Some(-1.0));
        assert_eq!(database.message_of(&frame).unwrap().length_bytes, 2);
        let has = |path| database.signal(path).is_some();
        assert!(has("drive_tpdo2.b") && has("drive_tpdo2.true_position_millimetres"));
        assert!(!has("drive_tpdo2.martensite_fraction"));
        assert!(composed(&[a]).message("drive_tpdo3").is_none());
    }

    #[test]
    fn each_message_has_the_name_and_the_identifier_of_its_node() {
        let both = two_loops();
        assert_eq!(both.refuse_duplicates(), Ok(()));
        for (id, name) in [
            (0x000, "nmt_command"),
            (0x080, "sync"),
            (0x181, "hand_x_tpdo1"),
            (0x190, "left_tpdo1"),
            (0x192, "right_tpdo1"),
            (0x1A1, "hand_y_tpdo1"),
            (0x211, "fan_rpdo1"),
            (0x212, "right_rpdo1"),
            (0x6B2, "right_truth"),
            (0x701, "hand_heartbeat"),
        ] {
            let frame = CanFrame::new(id, &[0; 8]);
            let found = both.message_of(&frame).map(|message| message.name.as_str());
            assert_eq!(found, Some(name), "0x{id:03X}");
        }
        let message = |name| both.message(name).unwrap();
        assert_eq!(message("right_tpdo1").sender.as_deref(), Some("right"));
        assert_eq!(message("right_rpdo1").sender.as_deref(), Some("hand"));
        let receivers = &message("sync").signals[0].receivers;
        assert_eq!(receivers[..], ["left", "right", "fan", "bench"]);
        assert_eq!(
            message("left_tpdo1").signals[0].receivers[..],
            ["hand", "bench"]
        );
        let causes = &both.definition("hand_emergency.manufacturer_error");
        let label = |value| causes.unwrap().label(value).unwrap();
        assert_eq!(label(256.0), "no position from the drive");
        assert_eq!(label(272.0), "no position from the drive (left)");
        assert_eq!(label(274.0), "no speed from the drive (right)");
        assert_eq!(label(530.0), "speed outside its range (right)");
        let stall = "speed stands still under a large voltage (right)";
        assert_eq!(label(1042.0), stall);
        let labels = &message("nmt_command").signals[1].labels;
        let labels = Vec::from_iter(labels.iter().map(|(id, name)| (*id, name.as_str())));
        assert_eq!(
            labels[1..],
            [(1, "hand"), (16, "left"), (17, "fan"), (18, "right")]
        );
    }

    #[test]
    fn scenario_time_begins_once_every_drive_is_enabled() {
        use std::time::Duration;

        use crate::scenario_clock::ScenarioClock;

        let mut clock = ScenarioClock::new(&two_loops(), ["left", "right"]).unwrap();
        let of = |id, data: &[u8]| CanFrame::new(id, data);
        let on = [0x37, 0x12, 0, 0, 0, 0, 0, 0];
        let [sync, x, y] = [of(0x080, &[1]), of(0x190, &on), of(0x192, &on)];
        let off = of(0x190, &[0x33, 0x12, 0, 0, 0, 0, 0, 0]);
        let frames = [x, sync, off, y, sync, x, sync];
        for (time, frame) in (0..).map(Duration::from_millis).zip(&frames) {
            clock.on_frame(time, frame);
        }
        assert_eq!(clock.zero(), Some(Duration::from_millis(6)));
    }
}
