//! The layout of a law's terms in the objects and the frames of the controller.

use crate::database::Signal;
use crate::messages::Carried;
use crate::messages::words::yes_or_no;
use crate::names::TERMS_MAX;

/// Index of the first object of the terms of the first loop, and the number of objects that a loop has.
const LAW_TERMS_OBJECT: u16 = 0x2200;
const TERMS_OF_LOOP: u16 = 0x40;
const MESSAGE_BITS: u8 = 64;
pub(crate) const BYTE: u8 = 8;

/// Returns the index of the first object of a loop's terms, by the place of the loop; the others follow.
pub fn first_term(loop_place: u8) -> u16 {
    LAW_TERMS_OBJECT + TERMS_OF_LOOP * u16::from(loop_place)
}

/// Object that holds a term, or several that share a byte.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct TermObject {
    /// Place of its TPDO, from 0.
    pub message: usize,
    /// First bit in the TPDO.
    pub start_bit: u8,
    /// Number of bits.
    pub bits: u8,
    /// Places of its terms, each with its first bit in the object.
    pub terms: Vec<(usize, u8)>,
}

/// Lays out the terms of a law in objects, and these in TPDOs of 8 bytes, in their order; `None` if they need more TPDOs than the
/// controller has. Terms have 8, 16 or 32 bits, or fewer than 8.
pub fn layout(terms: &[Signal]) -> Option<Vec<TermObject>> {
    let mut objects: Vec<TermObject> = Vec::new();
    let (mut message, mut end, mut shared) = (0, 0, 0);
    for (place, term) in terms.iter().enumerate() {
        let length_bits = term.coding.length_bits;
        let is_part = length_bits < BYTE;
        if let Some(object) = objects.last_mut().filter(|_| is_part && shared > 0)
            && shared + length_bits <= BYTE
        {
            object.terms.push((place, shared));
            shared += length_bits;
            continue;
        }
        shared = if is_part { length_bits } else { 0 };
        let bits = length_bits.max(BYTE);
        if end + bits > MESSAGE_BITS {
            (message, end) = (message + 1, 0);
        }
        objects.push(TermObject {
            message,
            start_bit: end,
            bits,
            terms: vec![(place, 0)],
        });
        end += bits;
    }
    (message < TERMS_MAX).then_some(objects)
}

/// Returns the objects of the terms of a law, by the place of its loop, each with the terms that it carries.
pub fn carried_terms(terms: &[Signal], loop_place: u8) -> Carried {
    let objects = layout(terms).unwrap_or_default();
    let carried = (first_term(loop_place)..)
        .zip(objects)
        .map(|(index, object)| {
            let signals = object.terms.iter().map(|(place, bit)| {
                let term = &terms[*place];
                let labels = match term.coding.length_bits {
                    1 => yes_or_no(),
                    _ => Vec::new(),
                };
                let coding = term.coding.starting_at(*bit);
                Signal {
                    coding,
                    labels,
                    ..term.clone()
                }
            });
            ((index, 0), signals.collect())
        });
    carried.collect()
}

#[cfg(test)]
mod tests {
    use can::CanFrame;

    use super::*;
    use crate::Database;
    use crate::coding::{Coding, Kind};
    use crate::messages::{Heading, Pdo, compose};
    use crate::node_objects::controller;

    fn term(name: &str, bits: u8, kind: Kind) -> Signal {
        let coding = Coding::little_endian(0, bits, kind, 1.0, None);
        Signal::new(name.to_owned(), "A", "", coding)
    }

    fn with_terms(terms: &[Signal]) -> Database {
        let loops = [(terms.to_vec(), [0x181, 0x281, 0x381, 0x481])];
        let objects = controller(1, &loops, &[0x10], &[]);
        let heading_of = |pdo: Pdo| match pdo {
            Pdo::Transmit(number) => {
                let name = format!("controller_tpdo{number}");
                Some(Heading::new(name, "controller", ["bench"]))
            }
            Pdo::Receive(_) => None,
        };
        let messages = compose(&objects, &carried_terms(terms, 0), 1, heading_of);
        Database::from_messages(messages)
    }

    fn real(name: &str) -> Signal {
        term(name, 32, Kind::Float32)
    }

    #[test]
    fn terms_stand_one_behind_the_other() {
        let terms = ["a", "b", "c"].map(real);
        let database = with_terms(&terms);
        let value = -0.125_f32;
        let mut bytes = [0; 8];
        bytes[4..].copy_from_slice(&value.to_le_bytes());
        let decode = |path, id, bytes: &[u8]| {
            let signal = database.signal(path).unwrap();
            signal.decode(&CanFrame::new(id, bytes))
        };
        assert_eq!(decode("controller_tpdo1.b", 0x181, &bytes), Some(-0.125));
        let third = decode("controller_tpdo2.c", 0x281, &value.to_le_bytes());
        assert_eq!(third, Some(-0.125));
        assert!(database.message("controller_tpdo3").is_none());
        let object = &database.definition("controller_tpdo2.c").unwrap().object;
        assert_eq!(object, "0x2202:00");
    }

    #[test]
    fn small_terms_share_a_byte_as_far_as_it_goes() {
        let flag = |name| term(name, 1, Kind::Unsigned);
        let five = |name| term(name, 5, Kind::Unsigned);
        let terms = [real("a"), flag("b"), five("c"), five("d"), real("e")];
        let objects = layout(&terms).unwrap();
        let places = Vec::from_iter(objects.iter().map(|it| (it.message, it.start_bit, it.bits)));
        assert_eq!(places, [(0, 0, 32), (0, 32, 8), (0, 40, 8), (1, 0, 32)]);
        assert_eq!(objects[1].terms, [(1, 0), (2, 1)]);
        let database = with_terms(&terms);
        let coding = database.definition("controller_tpdo1.c").unwrap().coding;
        assert_eq!((coding.start_bit, coding.length_bits), (33, 5));
        assert_eq!(
            database.message("controller_tpdo1").unwrap().length_bytes,
            6
        );
    }

    #[test]
    fn more_than_four_frames_of_terms_are_refused() {
        let reals = |count| Vec::from_iter((0..count).map(|number| real(&format!("x{number}"))));
        assert!(layout(&reals(8)).is_some());
        assert_eq!(layout(&reals(9)), None);
    }

    #[test]
    fn a_law_without_terms_has_no_frames() {
        assert_eq!(with_terms(&[]).term_messages("controller", "").count(), 0);
    }
}
