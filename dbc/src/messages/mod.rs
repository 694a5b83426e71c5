//! The messages of a CANopen node, composed from its objects.
//!
//! [`compose`] takes a node's objects, which say what each PDO maps, and the signals that objects carry. It returns the node's
//! messages with signals in mapping order. Call it once per node, then add the messages of [`services`].

use std::collections::BTreeMap;

use canopen::ObjectDictionary;
use canopen::object_dictionary::{DataType, Entry};

use crate::coding::{Coding, Kind, Range};
use crate::database::{Message, Signal};
pub mod services;
pub mod words;

/// First objects of the parameters and of the mappings of PDOs, for receive and transmit PDOs (CiA 301, 7.5.2.35 to 38).
const RECEIVE: [u16; 2] = [0x1400, 0x1600];
const TRANSMIT: [u16; 2] = [0x1800, 0x1A00];
/// Largest number of PDOs per direction.
const PDOS_MAX: u16 = 512;
/// COB-ID bit that disables the PDO.
const INVALID: u32 = 1 << 31;
/// Bits of an identifier with 11 bits.
const IDENTIFIER: u32 = 0x7FF;
/// Transmission types of a PDO that follows SYNC: each one to each 240th (CiA 301, table 71).
const CYCLIC: std::ops::RangeInclusive<u32> = 1..=240;
/// Lower indices are data types; mapping one leaves a gap of the type's length (CiA 301, 7.4.7.1).
const DUMMIES_BELOW: u16 = 0x20;
/// EDS name of an object that only reserves its index; mapped, it is a gap.
const RESERVED: &str = "reserved";
const BITS_OF_BYTE: u8 = 8;
const FRAME_BITS: u8 = 64;

/// A PDO of a node, by its direction and its number from 1 on.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Pdo {
    /// Sent by the node.
    Transmit(u16),
    /// Received by the node.
    Receive(u16),
}

/// Signals of a node's objects, by index and sub-index. Start bits count from the object's first bit; an object may carry several
/// signals.
pub type Carried = BTreeMap<(u16, u8), Vec<Signal>>;

/// Name, parties and description of a message.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct Heading {
    /// Name of the message.
    pub name: String,
    /// Node that sends it.
    pub sender: String,
    /// Nodes that use its signals.
    pub receivers: Vec<String>,
    /// Description of the message.
    pub comment: String,
}

impl Heading {
    /// Makes a heading without a description.
    pub fn new<'a>(
        name: String,
        sender: &str,
        receivers: impl IntoIterator<Item = &'a str>,
    ) -> Self {
        Self {
            name,
            sender: sender.to_owned(),
            receivers: receivers.into_iter().map(str::to_owned).collect(),
            comment: String::new(),
        }
    }

    /// Sets the description.
    #[must_use]
    pub fn about(self, comment: impl Into<String>) -> Self {
        let comment = comment.into();
        Self { comment, ..self }
    }

    /// Makes the message with these signals, which its receivers use.
    fn message(self, identifier: u32, length_bytes: u8, mut signals: Vec<Signal>) -> Message {
        for signal in &mut signals {
            signal.receivers.clone_from(&self.receivers);
        }
        Message {
            name: self.name,
            raw_id: identifier,
            length_bytes,
            sender: Some(self.sender),
            cycle_time_milliseconds: 0,
            comment: self.comment,
            signals,
        }
    }
}

/// Composes a message for each enabled PDO with a mapping. A mapped object in `carried` becomes its carried signals. A statusword
/// or controlword becomes its bits. A gap adds no signal. Any other object becomes one signal with the data sheet's name, type and
/// limits. `heading_of` names the PDO; `None` leaves the PDO out. The cycle time of a PDO sent every n-th SYNC is n times
/// `sync_period_milliseconds`.
pub fn compose(
    objects: &ObjectDictionary,
    carried: &Carried,
    sync_period_milliseconds: u64,
    heading_of: impl Fn(Pdo) -> Option<Heading>,
) -> Vec<Message> {
    let numbers = 0..PDOS_MAX;
    let receive = numbers.clone().map(|number| (RECEIVE, number));
    let transmit = numbers.map(|number| (TRANSMIT, number));
    let pdos = receive.chain(transmit).filter_map(|(first, number)| {
        let [parameters, mapping] = first.map(|first| first + number);
        let cob_id = objects.unsigned(parameters, 1)?;
        let count = objects.unsigned(mapping, 0)?;
        if cob_id & INVALID != 0 || count == 0 {
            return None;
        }
        let heading = heading_of(if first == RECEIVE {
            Pdo::Receive(number + 1)
        } else {
            Pdo::Transmit(number + 1)
        })?;
        let (signals, bits) = mapped_signals(objects, carried, mapping, count);
        let message = heading.message(cob_id & IDENTIFIER, bits / BITS_OF_BYTE, signals);
        let every = objects.unsigned(parameters, 2).unwrap_or_default();
        Some(Message {
            cycle_time_milliseconds: match every {
                every if CYCLIC.contains(&every) => u64::from(every) * sync_period_milliseconds,
                _ => 0,
            },
            ..message
        })
    });
    pdos.collect()
}

/// Returns the signals of a mapping in their order, and the number of bits.
fn mapped_signals(
    objects: &ObjectDictionary,
    carried: &Carried,
    mapping: u16,
    count: u32,
) -> (Vec<Signal>, u8) {
    let (mut signals, mut start_bit) = (Vec::new(), 0);
    for place in 1..=u8::try_from(count).unwrap_or(u8::MAX) {
        let [bits, sub_index, low, high] =
            objects.unsigned(mapping, place).unwrap_or(0).to_le_bytes();
        let end = start_bit + bits;
        if end > FRAME_BITS {
            break;
        }
        let index = u16::from_le_bytes([low, high]);
        let of_object = signals_of(objects, carried, (index, sub_index), bits);
        signals.extend(of_object.into_iter().map(|signal| {
            Signal {
                coding: signal
                    .coding
                    .starting_at(start_bit + signal.coding.start_bit),
                object: address(index, sub_index),
                ..signal
            }
        }));
        start_bit = end;
    }
    (signals, start_bit)
}

/// Returns the signals of a mapped object of this many bits, the first bit of each counted from that of the object.
fn signals_of(
    objects: &ObjectDictionary,
    carried: &Carried,
    (index, sub_index): (u16, u8),
    bits: u8,
) -> Vec<Signal> {
    if let Some(signals) = carried.get(&(index, sub_index)) {
        return signals.clone();
    }
    if let Some(word) = words::word(index).filter(|_| sub_index == 0) {
        return word;
    }
    let entry = objects.get(index, sub_index);
    let entry = entry.filter(|entry| index >= DUMMIES_BELOW && entry.name != RESERVED);
    Vec::from_iter(entry.map(|entry| signal_of(entry, bits)))
}

/// Returns the signal of an object without a meaning on this bus: as its data sheet names, counts and limits it.
fn signal_of(entry: &Entry, bits: u8) -> Signal {
    let kind = match entry.data_type {
        DataType::Real32 => Kind::Float32,
        DataType::Real64 => Kind::Float64,
        data_type if data_type.is_signed() => Kind::Signed,
        _ => Kind::Unsigned,
    };
    let limits = entry.low_limit.zip(entry.high_limit);
    let limits = limits.filter(|_| !entry.data_type.is_real());
    #[expect(clippy::cast_precision_loss, reason = "limits of at most 64 bits")]
    let range = limits.map(|(low, high)| Range {
        minimum: low as f64,
        maximum: high as f64,
    });
    let coding = Coding::little_endian(0, bits, kind, 1.0, range);
    Signal::new(name_of(&entry.name), "", &entry.name, coding)
}

/// Returns an object's address as in [`Signal::object`]: `0x6064:00`.
fn address(index: u16, sub_index: u8) -> String {
    format!("0x{index:04X}:{sub_index:02X}")
}

/// Returns the name of an object as that of a signal: small letters and digits, with underscores between the words.
fn name_of(object: &str) -> String {
    let is_letter = |letter: char| letter.is_ascii_alphanumeric();
    let words = object
        .split(|letter| !is_letter(letter))
        .filter(|word| !word.is_empty());
    Vec::from_iter(words.map(str::to_ascii_lowercase)).join("_")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DRIVE_EDS, dictionary};

    /// Returns the objects of the shipped drive with a mapping of its TPDO1.
    fn mapping(entries: &[u32]) -> ObjectDictionary {
        let mut objects = dictionary(DRIVE_EDS, 0x10).unwrap();
        let count = i128::try_from(entries.len()).unwrap();
        objects.set_integer(0x1A00, 0, count).unwrap();
        for (place, entry) in (1..).zip(entries) {
            objects
                .set_integer(0x1A00, place, i128::from(*entry))
                .unwrap();
        }
        objects
    }

    fn first_tpdo(objects: &ObjectDictionary, carried: &Carried) -> Message {
        let messages = compose(objects, carried, 2, |pdo| {
            let is_it = pdo == Pdo::Transmit(1);
            is_it.then(|| Heading::new("x_tpdo1".to_owned(), "x", ["bench"]).about("Feedback."))
        });
        let [message] = messages.try_into().unwrap();
        message
    }

    fn places(message: &Message) -> Vec<(&str, u8, u8)> {
        let signals = message.signals.iter();
        let places = signals.map(|one| (&*one.name, one.coding.start_bit, one.coding.length_bits));
        places.collect()
    }

    #[test]
    fn a_mapped_object_gives_carried_signals_word_bits_a_gap_or_one_plain_signal() {
        let position = Coding::little_endian(0, 32, Kind::Signed, 0.5, None);
        let position = Signal::new("position_millimetres".to_owned(), "mm", "", position);
        let carried = Carried::from([((0x6064, 0), vec![position])]);
        let objects = mapping(&[0x0005_0008, 0x6061_0008, 0x6064_0020, 0x6041_0010]);
        let message = first_tpdo(&objects, &carried);
        assert_eq!(message.length_bytes, 8);
        assert_eq!(message.cycle_time_milliseconds, 2);
        assert_eq!((&*message.comment, message.raw_id), ("Feedback.", 0x190));
        let expected = [
            ("modes_of_operation_display", 8, 8),
            ("position_millimetres", 16, 32),
            ("statusword_state", 48, 7),
            ("statusword_warning", 55, 1),
        ];
        assert_eq!(places(&message)[..4], expected);
        assert_eq!(message.signals[1].object, "0x6064:00");
        assert_eq!(message.signals[1].receivers, ["bench"]);
        assert_eq!(message.signals[0].coding.kind, Kind::Signed);
    }

    #[test]
    fn disabled_and_empty_pdos_give_no_message() {
        let mut objects = mapping(&[]);
        let count = |objects: &ObjectDictionary| {
            let any = |_| Some(Heading::default());
            compose(objects, &Carried::new(), 1, any).len()
        };
        let others = count(&objects);
        objects.set_integer(0x1A00, 0, 1).unwrap();
        objects.set_integer(0x1A00, 1, 0x6041_0010).unwrap();
        assert_eq!(count(&objects), others + 1);
        objects.set_integer(0x1800, 1, 0xC000_0190).unwrap();
        assert_eq!(count(&objects), others);
    }
}
