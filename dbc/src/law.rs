//! The frames of the rig with a law that has terms of its own: they stand in place of those of the sliding-mode law.

use crate::coding::{ByteOrder, Coding, Kind, Scale};
use crate::database::{Database, Signal};

/// Messages that hold a law's own terms, in this order; TPDO1 keeps the reference that every law follows.
const MESSAGES: [&str; 3] = ["controller_tpdo2", "controller_tpdo3", "controller_tpdo4"];
/// Terms in a message.
const TERMS_IN_MESSAGE: usize = 2;
const BITS: u8 = 32;
/// Object of the first term; the others follow.
pub const LAW_TERMS_OBJECT: u16 = 0x2210;
/// Most terms that a law may have of its own: what fits TPDO2 to TPDO4.
pub const LAW_TERMS_MAX: usize = MESSAGES.len() * TERMS_IN_MESSAGE;

/// A term of a law's own: a real number of 32 bits.
#[derive(Clone, Debug, PartialEq)]
pub struct LawTerm {
    /// Name; the unit is its end.
    pub name: String,
    /// Unit; empty for a number without one.
    pub unit: String,
    /// What it is.
    pub comment: String,
}

impl Database {
    /// The same with a law that has these terms: two in each of `controller_tpdo2` to `controller_tpdo4`, of which only
    /// those are left that hold one. A law without own terms changes nothing.
    #[must_use]
    pub fn with_law(&self, terms: &[LawTerm]) -> Self {
        if terms.is_empty() {
            return self.clone();
        }
        let mut messages = self.messages().to_vec();
        for (place, name) in MESSAGES.into_iter().enumerate() {
            let first = place * TERMS_IN_MESSAGE;
            let terms = terms.iter().enumerate().skip(first).take(TERMS_IN_MESSAGE);
            for message in messages.iter_mut().filter(|message| message.name == name) {
                let receivers = message.signals[0].receivers.clone();
                let signals = terms
                    .clone()
                    .zip([0, BITS])
                    .map(|((number, term), start_bit)| Signal {
                        receivers: receivers.clone(),
                        ..signal(number, term, start_bit)
                    });
                message.signals = signals.collect();
                message.length_bytes = message.signals.iter().map(|_| BITS / 8).sum();
                "Own terms of the law, every 10th SYNC.".clone_into(&mut message.comment);
            }
        }
        messages.retain(|message| {
            !MESSAGES.contains(&message.name.as_str()) || !message.signals.is_empty()
        });
        Self::from_messages(messages)
    }
}

fn signal(number: usize, term: &LawTerm, start_bit: u8) -> Signal {
    Signal {
        name: term.name.clone(),
        unit: term.unit.clone(),
        coding: Coding {
            start_bit,
            length_bits: BITS,
            byte_order: ByteOrder::LittleEndian,
            kind: Kind::Float32,
            factor: 1.0,
            offset: 0.0,
            range: None,
            scale: Scale::new(1.0),
        },
        labels: Vec::new(),
        receivers: Vec::new(),
        object: format!("0x{:04X}:00", usize::from(LAW_TERMS_OBJECT) + number),
        comment: term.comment.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::CanFrame;

    fn terms(names: &[&str]) -> Vec<LawTerm> {
        let term = |name: &&str| LawTerm {
            name: (*name).to_owned(),
            unit: "A".to_owned(),
            comment: String::new(),
        };
        names.iter().map(term).collect()
    }

    #[test]
    fn terms_stand_in_place_of_those_of_the_sliding_mode_law() {
        let database = Database::shipped().with_law(&terms(&["a", "b", "c"]));
        let value = -0.125_f32;
        let mut bytes = [0; 8];
        bytes[4..].copy_from_slice(&value.to_le_bytes());
        let decode = |path, id, bytes: &[u8]| {
            let signal = database.signal(path).unwrap();
            signal.decode(&CanFrame::new(id, bytes))
        };
        assert_eq!(decode("controller_tpdo2.b", 0x281, &bytes), Some(-0.125));
        let third = decode("controller_tpdo3.c", 0x381, &value.to_le_bytes());
        assert_eq!(third, Some(-0.125));
        assert!(database.message("controller_tpdo4").is_none());
        let reference = "controller_tpdo1.reference_position_millimetres";
        assert!(database.signal(reference).is_some());
        let object = &database.definition("controller_tpdo3.c").unwrap().object;
        assert_eq!(object, "0x2212:00");
    }

    #[test]
    fn a_law_without_own_terms_has_the_shipped_frames() {
        let shipped = Database::shipped();
        assert_eq!(&shipped.with_law(&[]), shipped);
    }
}
