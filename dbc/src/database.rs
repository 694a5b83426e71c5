//! Messages and signals by name.

use std::collections::{BTreeMap, BTreeSet};

use can::CanFrame;
use serde::{Deserialize, Serialize};

use crate::coding::{Coding, Kind};
use crate::error::{DbcError, SignalMissing};

/// Signal with the node that an NMT command is for.
const NMT_NODE_ID: &str = "nmt_node_id";
/// Value of this signal for all nodes.
const ALL_NODES: i64 = 0;

/// All messages of a DBC file, by identifier.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Database {
    messages: Vec<Message>,
}

/// Message on the bus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Message {
    /// Name.
    pub name: String,
    /// Identifier with the kernel's flag for 29 bits, as in [`CanFrame::raw_id`].
    pub raw_id: u32,
    /// Payload length.
    pub length_bytes: u8,
    /// Node that sends it.
    pub sender: Option<String>,
    /// Cycle time; 0 if the message is not cyclic.
    pub cycle_time_milliseconds: u64,
    /// Description of the message.
    pub comment: String,
    /// Signals in the order of the file.
    pub signals: Vec<Signal>,
}

/// Signal of a message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Signal {
    /// Name.
    pub name: String,
    /// Unit as text; empty for a number without one.
    pub unit: String,
    /// Bits and scaling.
    pub coding: Coding,
    /// Labels of raw values.
    pub labels: Vec<(i64, String)>,
    /// Nodes that use it.
    pub receivers: Vec<String>,
    /// Object behind the signal, such as `0x6064:00`; empty if there is none.
    pub object: String,
    /// Description of the signal.
    pub comment: String,
}

impl Message {
    /// Returns a signal by its name.
    pub fn signal(&self, name: &str) -> Option<&Signal> {
        self.signals.iter().find(|signal| signal.name == name)
    }

    /// Returns a handle for one of its signals.
    pub fn handle(&self, signal: &Signal) -> SignalHandle {
        let payload_bytes = signal.coding.payload_bytes();
        // A signal that no payload has is longer than any payload.
        let is_somewhere = payload_bytes <= size_of::<u64>();
        SignalHandle {
            raw_id: self.raw_id,
            payload_bytes,
            mask: if is_somewhere {
                signal.coding.occupied_bits()
            } else {
                0
            },
            coding: signal.coding,
        }
    }

    /// Decodes the signals for which the payload of a frame of this message is long enough, in the order of the file.
    pub fn decode(&self, frame: &CanFrame) -> impl Iterator<Item = (&Signal, f64)> + use<'_> {
        let (payload, payload_bytes) = (frame.buffer(), frame.data().len());
        let present = move |signal: &&Signal| signal.coding.payload_bytes() <= payload_bytes;
        let present = self.signals.iter().filter(present);
        present.map(move |signal| (signal, signal.coding.decode(&payload)))
    }
}

impl Signal {
    /// Makes a signal of no message yet, without labels, receivers and object.
    pub fn new(name: String, unit: &str, comment: &str, coding: Coding) -> Self {
        Self {
            name,
            unit: unit.to_owned(),
            coding,
            labels: Vec::new(),
            receivers: Vec::new(),
            object: String::new(),
            comment: comment.to_owned(),
        }
    }

    /// Returns the label of a physical value, if the value table has one.
    pub fn label(&self, value: f64) -> Option<&str> {
        let raw = ((value - self.coding.offset) / self.coding.factor).round();
        let found = self.labels.iter().find(|(number, _)| *number as f64 == raw);
        found.map(|(_, label)| label.as_str())
    }
}

/// Handle of a signal, found once: it decodes and encodes without search and without allocation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalHandle {
    raw_id: u32,
    payload_bytes: usize,
    /// Bits of the signal in the payload, byte 0 lowest.
    mask: u64,
    coding: Coding,
}

impl SignalHandle {
    /// Returns the identifier of the message, with the kernel's flag for 29 bits.
    pub fn raw_id(&self) -> u32 {
        self.raw_id
    }

    /// Returns the bits of the signal in a payload, byte 0 lowest; the value depends on no others.
    #[inline]
    pub fn mask(&self) -> u64 {
        self.mask
    }

    /// Checks whether a frame has the signal: the identifier is right and the payload long enough.
    #[inline]
    pub fn is_in(&self, frame: &CanFrame) -> bool {
        frame.raw_id() == self.raw_id && frame.data().len() >= self.payload_bytes
    }

    /// Decodes the physical value; `None` for a frame with another identifier, or too short for the signal.
    #[inline]
    pub fn decode(&self, frame: &CanFrame) -> Option<f64> {
        self.is_in(frame)
            .then(|| self.coding.decode(&frame.buffer()))
    }

    /// Checks whether the value of a little-endian integer is at an end of its field, where one that does not fit is cut. 0 may be
    /// the value of an unsigned one.
    #[inline]
    pub fn is_cut(&self, frame: &CanFrame) -> bool {
        let sign = self.mask & !(self.mask >> 1);
        let bits = u64::from_le_bytes(frame.buffer()) & self.mask;
        match self.coding.kind {
            Kind::Unsigned => bits == self.mask,
            Kind::Signed => bits == sign || bits == self.mask ^ sign,
            Kind::Float32 | Kind::Float64 => false,
        }
    }

    /// Returns the bits that make the value, in their places in the payload; `None` as for [`SignalHandle::decode`].
    #[inline]
    pub fn bits(&self, frame: &CanFrame) -> Option<u64> {
        self.is_in(frame)
            .then(|| u64::from_le_bytes(frame.buffer()) & self.mask)
    }

    /// Writes a physical value into a payload; see [`Coding::encode`] for values out of range.
    pub fn encode(&self, value: f64, payload: &mut [u8; 8]) {
        self.coding.encode(value, payload);
    }
}

/// Builder of frames of one message; bits of signals that were never set are 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageBuilder {
    raw_id: u32,
    length_bytes: u8,
    payload: [u8; 8],
}

impl MessageBuilder {
    /// Sets a signal to a physical value; see [`Coding::encode`] for values out of range.
    ///
    /// # Panics
    /// The signal belongs to another message, which is the caller's mistake.
    pub fn set(&mut self, signal: &SignalHandle, value: f64) {
        assert_eq!(signal.raw_id, self.raw_id, "signal of another message");
        signal.encode(value, &mut self.payload);
    }

    /// Returns the frame with the values that were set so far.
    pub fn frame(&self) -> CanFrame {
        CanFrame::from_raw(self.raw_id, self.length_bytes, self.payload)
            .expect("messages longer than 8 bytes are refused when parsed")
    }
}

impl Database {
    /// Checks whether any message has a signal of this name.
    pub fn has_signal(&self, name: &str) -> bool {
        let mut signals = self.messages.iter().flat_map(|message| &message.signals);
        signals.any(|signal| signal.name == name)
    }

    /// Makes a database of messages in any order, each of which has been checked.
    pub fn from_messages(mut messages: Vec<Message>) -> Self {
        messages.sort_by_key(|message| message.raw_id);
        Self { messages }
    }

    /// Labels the target of an NMT command with the names of these nodes, by their node-IDs.
    pub fn with_nodes<'a>(&self, nodes: impl IntoIterator<Item = (u8, &'a str)>) -> Self {
        let label = |(node_id, name): (u8, &str)| (i64::from(node_id), name.to_owned());
        let labels = BTreeMap::from_iter(nodes.into_iter().map(label));
        let mut messages = self.messages.clone();
        let signals = messages.iter_mut().flat_map(|message| &mut message.signals);
        for signal in signals.filter(|signal| signal.name == NMT_NODE_ID) {
            signal.labels.retain(|(node_id, _)| *node_id == ALL_NODES);
            signal.labels.extend(labels.clone());
        }
        Self { messages }
    }

    /// Refuses two messages with the same identifier or name.
    ///
    /// # Errors
    /// The names of both.
    pub fn refuse_duplicates(&self) -> Result<(), DbcError> {
        // Equal identifiers are neighbours, since the messages are sorted.
        let mut neighbours = self.messages.windows(2);
        let same_id = neighbours.find(|pair| pair[0].raw_id == pair[1].raw_id);
        let mut names = BTreeSet::new();
        let same_name = self.messages.iter().find(|one| !names.insert(&one.name));
        let (first, second, what) = match (same_id, same_name) {
            (Some(pair), _) => (&pair[0].name, &pair[1].name, "identifier"),
            (None, Some(message)) => (&message.name, &message.name, "name"),
            (None, None) => return Ok(()),
        };
        Err(DbcError(format!(
            "messages {first} and {second} have the same {what}"
        )))
    }

    /// Returns all messages, by identifier.
    pub fn messages(&self) -> &[Message] {
        &self.messages
    }

    /// Returns the message of this name.
    pub fn message(&self, name: &str) -> Option<&Message> {
        self.messages.iter().find(|message| message.name == name)
    }

    /// Returns the message that a frame carries.
    pub fn message_of(&self, frame: &CanFrame) -> Option<&Message> {
        let found = self
            .messages
            .binary_search_by_key(&frame.raw_id(), |message| message.raw_id);
        found.ok().map(|place| &self.messages[place])
    }

    /// Returns the definition of a signal, by `message.signal`.
    pub fn definition(&self, path: &str) -> Option<&Signal> {
        self.find(path).map(|(_, signal)| signal)
    }

    /// Returns a handle for a signal, by `message.signal`.
    pub fn signal(&self, path: &str) -> Option<SignalHandle> {
        self.find(path)
            .map(|(message, signal)| message.handle(signal))
    }

    /// Returns a handle as [`Database::signal`], for a signal that must exist.
    ///
    /// # Errors
    /// The signal does not exist.
    pub fn require(&self, path: &str) -> Result<SignalHandle, SignalMissing> {
        self.signal(path).ok_or_else(|| SignalMissing::new(path))
    }

    /// Returns a builder for frames of the message of this name.
    ///
    /// # Errors
    /// The message does not exist.
    pub fn builder(&self, name: &str) -> Result<MessageBuilder, SignalMissing> {
        let message = self.message(name).ok_or_else(|| SignalMissing::new(name))?;
        Ok(MessageBuilder {
            raw_id: message.raw_id,
            length_bytes: message.length_bytes,
            payload: [0; 8],
        })
    }

    fn find(&self, path: &str) -> Option<(&Message, &Signal)> {
        let (message, signal) = path.split_once('.')?;
        let message = self.message(message)?;
        Some((message, message.signal(signal)?))
    }
}

#[cfg(test)]
mod tests {
    use can::frame::{EXTENDED_FLAG, REMOTE_FLAG};

    use super::*;

    #[test]
    fn a_value_at_the_end_of_its_field_was_cut() {
        let database = Database::shipped();
        let is_cut = |path: &str, raw: u16| {
            let signal = database.signal(path).unwrap();
            let bits = u64::from(raw) * (signal.mask() & 0x0001_0001_0001_0001);
            signal.is_cut(&CanFrame::new(0x290, &bits.to_le_bytes()))
        };
        let signed = |raw| is_cut("drive_tpdo2.wire_temperature_celsius", raw);
        assert_eq!(
            [0x7FFF, 0x8000, 0, 0xFFFF, 0x7FFE].map(signed),
            [true, true, false, false, false]
        );
        let unsigned = |raw| is_cut("drive_tpdo2.martensite_fraction", raw);
        assert_eq!(
            [0xFFFF, 0, 0x7FFF, 0x8000].map(unsigned),
            [true, false, false, false]
        );
    }

    #[test]
    fn a_signal_is_found_decoded_and_labelled_by_name() {
        let database = Database::shipped();
        let frame = CanFrame::new(0x190, &[0x37, 0x12, 0xF0, 0xD8, 0xFF, 0xFF, 0xF4, 0x01]);
        let message = database.message_of(&frame).unwrap();
        assert_eq!(message.name, "drive_tpdo1");
        let by_name = |name| {
            let mut signals = message.decode(&frame);
            signals.find(|(signal, _)| signal.name == name).unwrap()
        };
        let label = |name| {
            let (signal, value) = by_name(name);
            signal.label(value)
        };
        let (signal, position) = by_name("position_millimetres");
        assert_eq!((position, signal.unit.as_str()), (-10.0, "mm"));
        assert_eq!(by_name("current_amperes").1, 0.5);
        assert_eq!(label("statusword_state"), Some("operation enabled"));
        assert_eq!(by_name("statusword_follows_command").1, 1.0);
        assert_eq!(label("position_millimetres"), None);
    }

    #[test]
    fn names_that_do_not_exist_are_not_found() {
        let database = Database::shipped();
        for path in [
            "",
            ".",
            "drive_tpdo1",
            "drive_tpdo1.",
            "drive_tpdo9.position_millimetres",
        ] {
            assert_eq!(database.signal(path), None, "{path}");
        }
        assert!(database.builder("drive_tpdo9").is_err());
    }

    #[test]
    fn long_names_come_from_the_attribute() {
        let database = Database::shipped();
        let path = "controller_tpdo1.reference_velocity_millimetres_per_second";
        assert!(database.signal(path).is_some());
        assert_eq!(database.signal("controller_tpdo1.reference_velocity"), None);
        let sliding = "controller_tpdo3.sliding_variable_metres_per_second_squared";
        assert_eq!(
            database.definition(sliding).unwrap().coding.kind,
            Kind::Float32
        );
    }

    #[test]
    fn signals_beyond_a_short_payload_are_absent() {
        let database = Database::shipped();
        let frame = CanFrame::new(0x190, &[0x37, 0x12, 0x10, 0x27, 0, 0]);
        let message = database.message_of(&frame).unwrap();
        let names: Vec<_> = message
            .decode(&frame)
            .map(|(signal, _)| signal.name.clone())
            .collect();
        assert!(names.contains(&"position_millimetres".to_owned()));
        assert!(!names.contains(&"current_amperes".to_owned()));
        let current = database.signal("drive_tpdo1.current_amperes").unwrap();
        assert_eq!(current.decode(&frame), None);
        assert_eq!(message.decode(&CanFrame::new(0x190, &[])).count(), 0);
    }

    #[test]
    fn other_identifiers_remote_and_extended_frames_are_passed_over() {
        let database = Database::shipped();
        let position = database.signal("drive_tpdo1.position_millimetres").unwrap();
        for id in [0x191, 0x190 | REMOTE_FLAG, 0x190 | EXTENDED_FLAG] {
            let frame = CanFrame::from_raw(id, 8, [0; 8]).unwrap();
            assert!(database.message_of(&frame).is_none(), "{id:#x}");
            assert_eq!(position.decode(&frame), None, "{id:#x}");
        }
    }

    #[test]
    fn the_disturbance_frame_is_built_by_name_and_saturates() {
        let database = Database::shipped();
        let mut builder = database.builder("disturbance_rpdo1").unwrap();
        let factor = database
            .signal("disturbance_rpdo1.convection_factor")
            .unwrap();
        let load = database
            .signal("disturbance_rpdo1.added_load_grams")
            .unwrap();
        builder.set(&factor, 5.0);
        builder.set(&load, -12.34);
        assert_eq!(
            builder.frame(),
            CanFrame::new(0x211, &[0x88, 0x13, 0x85, 0xFF])
        );
        builder.set(&factor, 1e9);
        builder.set(&load, f64::NEG_INFINITY);
        assert_eq!(
            builder.frame(),
            CanFrame::new(0x211, &[0x30, 0x75, 0x00, 0x80])
        );
    }

    #[test]
    fn not_a_number_is_kept_by_floats_and_is_raw_0_to_integers() {
        let database = Database::shipped();
        let encode = |path: &str| {
            let handle = database.signal(path).unwrap();
            let mut payload = [0xFF; 8];
            handle.encode(f64::NAN, &mut payload);
            database.definition(path).unwrap().coding.decode(&payload)
        };
        assert!(encode("controller_tpdo4.equivalent_part_amperes_squared").is_nan());
        assert_eq!(encode("drive_rpdo1.target_current_amperes"), 0.0);
    }

    #[test]
    fn decoded_decimals_are_exact() {
        let database = Database::shipped();
        let position = database.signal("drive_tpdo1.position_millimetres").unwrap();
        let mut payload = [0; 8];
        payload[2..6].copy_from_slice(&35_004_i32.to_le_bytes());
        assert_eq!(
            position.decode(&CanFrame::new(0x190, &payload)),
            Some(35.004)
        );
    }
}
