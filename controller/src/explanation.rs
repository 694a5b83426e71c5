//! The law's terms as objects, from where the controller's TPDOs take them: 0x2200 to 0x2208, and from 0x2210 on those of
//! a law that has terms of its own.

use std::ops::RangeInclusive;

use canopen::ObjectDictionary;
use canopen::object_dictionary::{Access, DataType, Entry, Handle};
use dbc::loops::law_offset;
use dbc::{LAW_TERMS_OBJECT, LawTerm};

use crate::error::ControllerError;
use crate::law::Explanation;

/// Communication and mapping of TPDO2 to TPDO4, which hold a law's own terms.
const TPDOS: [[u16; 2]; 3] = [[0x1801, 0x1A01], [0x1802, 0x1A02], [0x1803, 0x1A03]];
/// Own terms in a TPDO: each has 32 bits.
const TERMS_IN_TPDO: usize = 2;
const TERM_BITS: u32 = 32;
/// Bit 31 of a COB-ID: the PDO does not exist (CiA 301, 7.5.2.37).
const INVALID: u32 = 0x8000_0000;

const MICRO: f64 = 1e6;
const CENTI: f64 = 100.0;
const FRACTION_STEPS: f64 = 50_000.0;
/// Above the flags of 0x2206: how far the law backs off, in bits 3 to 7.
const BACK_OFF_SHIFT: u8 = 3;
const BACK_OFF_STEPS: f64 = 31.0;

/// Where the terms stand in the dictionary, found once.
#[derive(Clone, Debug)]
pub(crate) struct ExplanationObjects {
    first_to_last: [Handle; 9],
    own: Vec<Handle>,
}

/// What explains a loop: its terms, and the TPDOs that take them. Those of the next loop stand so far behind.
const OBJECTS: [RangeInclusive<u16>; 3] = [0x1800..=0x1803, 0x1A00..=0x1A03, 0x2200..=0x223F];
const OBJECT_DISTANCES: [u16; 3] = [4, 4, 0x40];

/// Puts a loop's terms, and the TPDOs that take them, into the controller's dictionary: those of its data sheet, or behind
/// them for a loop that is not the first. A law's own terms are in TPDO2 to TPDO4 in place of the others.
pub(crate) fn declare(
    dictionary: &mut ObjectDictionary,
    shipped: &ObjectDictionary,
    terms: &[LawTerm],
    place: usize,
) {
    let mut own = shipped.clone();
    declare_terms(&mut own, terms);
    for entry in own.entries() {
        let ranges = OBJECTS.iter().zip(OBJECT_DISTANCES);
        let range = ranges
            .clone()
            .find(|(range, _)| range.contains(&entry.index));
        if let Some((_, distance)) = range {
            dictionary.insert(of_loop(entry, distance, place));
        }
    }
}

/// The entry of the first loop as that of another one.
fn of_loop(entry: &Entry, distance: u16, place: usize) -> Entry {
    let places = u16::try_from(place).unwrap_or(u16::MAX);
    let value = entry.decode_integer(&entry.default);
    let number = u32::try_from(value).unwrap_or_default();
    let default = match (entry.index, entry.sub_index) {
        (0x1800..=0x1803, 1) => {
            let behind = u8::try_from(place).map_or(0, law_offset);
            (number + behind).to_le_bytes().to_vec()
        }
        // The SYNC start value: each loop has cycles of its own (`LoopPlace::terms_cycle`).
        (0x1800..=0x1803, 6) => u8::try_from(place).into_iter().collect(),
        (0x1A00..=0x1A03, 1..) if number != 0 => {
            let behind = u32::from(OBJECT_DISTANCES[2] * places) << 16;
            (number + behind).to_le_bytes().to_vec()
        }
        _ => entry.default.clone(),
    };
    let index = entry.index + distance * places;
    let (data_type, access) = (entry.data_type, entry.access);
    let mut twin = Entry::new(
        index,
        entry.sub_index,
        &entry.name,
        data_type,
        access,
        default,
    );
    twin.is_pdo_mappable = entry.is_pdo_mappable;
    (twin.low_limit, twin.high_limit) = (entry.low_limit, entry.high_limit);
    twin
}

fn declare_terms(dictionary: &mut ObjectDictionary, terms: &[LawTerm]) {
    if terms.is_empty() {
        return;
    }
    for (index, term) in own_objects().zip(terms) {
        let start = 0.0_f32.to_le_bytes().to_vec();
        let mut entry = Entry::new(
            index,
            0,
            &term.name,
            DataType::Real32,
            Access::ReadOnly,
            start,
        );
        entry.is_pdo_mappable = true;
        dictionary.insert(entry);
    }
    let objects = Vec::from_iter(own_objects().take(terms.len()));
    let mut pairs = objects.chunks(TERMS_IN_TPDO);
    for [communication, mapping] in TPDOS {
        let mapped = pairs.next().unwrap_or_default();
        let count = mapped.len().to_le_bytes();
        set_default(dictionary, mapping, 0, &count[..1]);
        for (sub_index, object) in (1..).zip(mapped) {
            let object = u32::from(*object) << 16 | TERM_BITS;
            set_default(dictionary, mapping, sub_index, &object.to_le_bytes());
        }
        if mapped.is_empty() {
            let cob_id = dictionary.unsigned(communication, 1).unwrap_or_default();
            set_default(
                dictionary,
                communication,
                1,
                &(cob_id | INVALID).to_le_bytes(),
            );
        }
    }
}

/// The objects of a law's own terms, in their order.
fn own_objects() -> impl Iterator<Item = u16> {
    LAW_TERMS_OBJECT..
}

/// Gives an object another default, and makes it its value.
pub(crate) fn set_default(
    dictionary: &mut ObjectDictionary,
    index: u16,
    sub_index: u8,
    bytes: &[u8],
) {
    if let Ok(handle) = dictionary.find(index, sub_index) {
        let entry = dictionary.entry(handle);
        let (name, data_type, access) = (entry.name.clone(), entry.data_type, entry.access);
        let twin = Entry::new(index, sub_index, &name, data_type, access, bytes.to_vec());
        dictionary.insert(twin);
    }
}

impl ExplanationObjects {
    pub(crate) fn find(
        dictionary: &ObjectDictionary,
        terms_count: usize,
        place: usize,
    ) -> Result<Self, ControllerError> {
        let behind = OBJECT_DISTANCES[2] * u16::try_from(place).unwrap_or(u16::MAX);
        let find = |first: u16| {
            let index = first + behind;
            let found = dictionary.find(index, 0);
            found.map_err(|_| ControllerError::NoObject(index))
        };
        let own = own_objects().take(terms_count).map(find);
        Ok(Self {
            first_to_last: [
                find(0x2200)?,
                find(0x2201)?,
                find(0x2202)?,
                find(0x2203)?,
                find(0x2204)?,
                find(0x2205)?,
                find(0x2206)?,
                find(0x2207)?,
                find(0x2208)?,
            ],
            own: own.collect::<Result<_, _>>()?,
        })
    }

    /// Stores the terms; values beyond an object's type are cut to its ends. Allocates nothing.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "`as` cuts to the ends of the type, which is what is wanted"
    )]
    pub(crate) fn store(
        &self,
        dictionary: &mut ObjectDictionary,
        terms: &Explanation,
        own: impl Iterator<Item = f64>,
    ) {
        let micro = |value: f64| ((value * MICRO).round() as i32).to_le_bytes();
        let real = |value: f64| (value as f32).to_le_bytes();
        let temperature = (terms.estimated_temperature_celsius * CENTI).round() as i16;
        let fraction = terms.estimated_martensite_fraction.clamp(0.0, 1.0);
        let fraction = (fraction * FRACTION_STEPS).round() as u16;
        let back_off = (terms.caution.clamp(0.0, 1.0) * BACK_OFF_STEPS).round() as u8;
        let mut store = |place: usize, value: &[u8]| {
            let stored = dictionary.store(self.first_to_last[place], value);
            debug_assert!(stored.is_ok(), "the EDS gives each object its type");
        };
        store(0, &micro(terms.reference_position_metres));
        store(1, &micro(terms.reference_velocity_metres_per_second));
        store(2, &temperature.to_le_bytes());
        store(3, &fraction.to_le_bytes());
        store(4, &micro(terms.estimated_velocity_metres_per_second));
        store(5, &real(terms.sliding_variable_metres_per_second_squared));
        store(6, &[terms.saturation.bits() | back_off << BACK_OFF_SHIFT]);
        store(7, &real(terms.equivalent_part_square_amperes));
        store(8, &real(terms.switching_part_square_amperes));
        for (handle, value) in self.own.iter().zip(own) {
            let stored = dictionary.store(*handle, &real(value));
            debug_assert!(stored.is_ok(), "each was declared with this type");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::eds;

    fn dictionary(names: &[&str]) -> ObjectDictionary {
        let term = |name: &&str| LawTerm {
            name: (*name).to_owned(),
            unit: String::new(),
            comment: String::new(),
        };
        let terms: Vec<LawTerm> = names.iter().map(term).collect();
        let shipped = eds::parse(dbc::CONTROLLER_EDS, 1).unwrap().dictionary;
        let mut dictionary = shipped.clone();
        declare(&mut dictionary, &shipped, &terms, 0);
        dictionary
    }

    #[test]
    fn own_terms_are_mapped_two_by_two_and_what_is_left_is_not_sent() {
        let dictionary = dictionary(&["a", "b", "c"]);
        let unsigned = |index, sub_index| dictionary.unsigned(index, sub_index).unwrap();
        assert_eq!(
            [0, 1, 2].map(|sub| unsigned(0x1A01, sub)),
            [2, 0x2210_0020, 0x2211_0020]
        );
        assert_eq!([0, 1].map(|sub| unsigned(0x1A02, sub)), [1, 0x2212_0020]);
        assert_eq!(unsigned(0x1A03, 0), 0);
        let is_sent = |index| unsigned(index, 1) & INVALID == 0;
        let sent = [0x1800, 0x1801, 0x1802, 0x1803].map(is_sent);
        assert_eq!(sent, [true, true, true, false]);
        let third = dictionary.entry(dictionary.find(0x2212, 0).unwrap());
        assert_eq!(
            (third.name.as_str(), third.data_type),
            ("c", DataType::Real32)
        );
    }

    #[test]
    fn a_law_without_own_terms_has_the_shipped_dictionary() {
        let shipped = eds::parse(dbc::CONTROLLER_EDS, 1).unwrap().dictionary;
        let objects = |dictionary: &ObjectDictionary| format!("{:?}", dictionary.entries());
        assert_eq!(objects(&dictionary(&[])), objects(&shipped));
    }
}
