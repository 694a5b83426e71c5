//! The terms of a law as objects, from 0x2200 on. The controller's TPDOs map them.

use canopen::object_dictionary::{Access, DataType, Entry, Handle, Preset};
use canopen::{ObjectDictionary, add_half};
use dbc::{Coding, Kind, LAW_TERMS_OBJECT, Range, Signal, layout};
use scenario::port::{Measurand, Port, Width};

use crate::error::ControllerError;

/// First objects of the communication parameters of the controller's TPDOs and of their mappings, and the numbers of
/// objects per loop.
const COMMUNICATION: u16 = 0x1800;
const MAPPING: u16 = 0x1A00;
const TPDOS_OF_LOOP: u16 = 4;
const TERMS_OF_LOOP: u16 = 0x40;
/// Sub-index of a TPDO's SYNC start value (CiA 301, 7.5.2.37).
const SYNC_START: u8 = 6;

/// Returns whether an object of the controller belongs to its law only.
pub(crate) fn is_of_law(index: u16) -> bool {
    let is_in = |first: u16, count: u16| (first..first + count).contains(&index);
    is_in(COMMUNICATION, TPDOS_OF_LOOP)
        || is_in(MAPPING, TPDOS_OF_LOOP)
        || is_in(LAW_TERMS_OBJECT, TERMS_OF_LOOP)
}

/// Returns the term of a port as a signal, with its name in its loop.
pub(crate) fn described(port: &Port, measurand: &Measurand) -> Signal {
    let (bits, kind, counts_per_unit) = match port.width {
        Width::Real32 => (32, Kind::Float32, 1.0),
        Width::Signed(bits) => (bits, Kind::Signed, port.steps_per_unit),
        Width::Unsigned(bits) => (bits, Kind::Unsigned, port.steps_per_unit),
    };
    let [minimum, maximum] = port.range;
    let (name, unit) = measurand.term(port.local_name(), port);
    let range = Some(Range { minimum, maximum });
    let coding = Coding::little_endian(0, bits, kind, 1.0 / counts_per_unit, range);
    Signal::new(name, &unit, &port.comment, coding)
}

/// Adds the terms of a loop's law, and the TPDOs that carry them, to the controller's dictionary. `shipped` is its data
/// sheet, which has the parameters of the TPDOs.
pub(crate) fn declare(
    dictionary: &mut ObjectDictionary,
    shipped: &ObjectDictionary,
    terms: &[Signal],
    identifiers: &[u16],
    place: usize,
) {
    let place = u16::try_from(place).unwrap_or(u16::MAX);
    let objects = layout(terms).unwrap_or_default();
    let first_object = LAW_TERMS_OBJECT + TERMS_OF_LOOP * place;
    for (index, object) in (first_object..).zip(&objects) {
        let term = &terms[object.terms[0].0];
        let data_type = match (term.coding.kind, object.bits) {
            (Kind::Float32 | Kind::Float64, _) => DataType::Real32,
            (Kind::Signed, 8) => DataType::Integer8,
            (Kind::Signed, 16) => DataType::Integer16,
            (Kind::Signed, _) => DataType::Integer32,
            (Kind::Unsigned, 8) => DataType::Unsigned8,
            (Kind::Unsigned, 16) => DataType::Unsigned16,
            (Kind::Unsigned, _) => DataType::Unsigned32,
        };
        let start = vec![0; usize::from(object.bits / 8)];
        let mut entry = Entry::new(index, 0, &term.name, data_type, Access::ReadOnly, start);
        entry.is_pdo_mappable = true;
        dictionary.insert(entry);
    }
    for (number, (message, identifier)) in (0..TPDOS_OF_LOOP).zip(identifiers.iter().enumerate()) {
        let numbered = (u32::from(first_object)..).zip(&objects);
        let own = numbered.filter(|(_, object)| object.message == message);
        let mapped = own.map(|(index, object)| index << 16 | u32::from(object.bits));
        let mapped = Vec::from_iter(mapped);
        if mapped.is_empty() {
            continue;
        }
        let like = [COMMUNICATION, MAPPING].map(|first| first + number);
        let at = like.map(|index| index + TPDOS_OF_LOOP * place);
        let tpdo = shipped.pdo_like(like, at, *identifier, &mapped);
        tpdo.into_iter().for_each(|entry| dictionary.insert(entry));
        // Each loop has its own cycles (`dbc::loops::terms_cycle`).
        dictionary.preset(&Preset::new(at[0], SYNC_START, place.into()));
    }
}

/// The objects of a loop's terms in the dictionary, found once.
#[derive(Clone, Debug)]
pub(crate) struct TermObjects {
    /// Objects, each with its size in bytes and its parts.
    objects: Vec<(Handle, u8, Vec<Part>)>,
}

/// A term as a part of an object.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Index of the output.
    output: usize,
    /// First bit in the object.
    bit: u8,
    /// Counts of an output of one.
    counts: f64,
    /// Lowest and highest count; `None` for a float.
    range: Option<[f64; 2]>,
}

impl Part {
    /// Returns the bits of a value; one beyond the range is limited to it.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a 32-bit number is wanted, and the range lets only those through that fit"
    )]
    fn bits(&self, value: f64) -> u32 {
        match self.range {
            None => (value as f32).to_bits(),
            Some([min, max]) => add_half(value * self.counts).clamp(min, max) as i64 as u32,
        }
    }
}

impl TermObjects {
    /// Finds the objects of a loop's terms. Each term has the index of its output, and a factor from that to the unit
    /// of the term's name.
    pub(crate) fn find<'a>(
        dictionary: &ObjectDictionary,
        of_loop: usize,
        terms: impl Iterator<Item = (usize, &'a Port, f64)>,
    ) -> Result<Self, ControllerError> {
        let terms = Vec::from_iter(terms);
        let described = terms
            .iter()
            .map(|(_, port, _)| described(port, &Measurand::default()));
        let layout = layout(&Vec::from_iter(described)).unwrap_or_default();
        let first = usize::from(LAW_TERMS_OBJECT) + usize::from(TERMS_OF_LOOP) * of_loop;
        let mut objects = Vec::new();
        for (object, laid_out) in layout.iter().enumerate() {
            let index = u16::try_from(first + object).unwrap_or(u16::MAX);
            let handle = dictionary
                .find(index, 0)
                .map_err(|_| ControllerError::no_object(index))?;
            let parts = laid_out.terms.iter().map(|(term, bit)| {
                let (output, port, factor) = terms[*term];
                let steps = port.steps_per_unit;
                let range = port.range.map(|end| (end * steps).round());
                Part {
                    output,
                    bit: *bit,
                    counts: steps * factor,
                    range: (port.width != Width::Real32).then_some(range),
                }
            });
            objects.push((handle, laid_out.bits / 8, parts.collect()));
        }
        Ok(Self { objects })
    }

    /// Stores the terms. Does not allocate.
    pub(crate) fn store(&self, dictionary: &mut ObjectDictionary, writes: &[f64]) {
        for (handle, size, parts) in &self.objects {
            let bits = parts.iter().fold(0, |bits, part| {
                bits | part.bits(writes[part.output]) << part.bit
            });
            let bytes = bits.to_le_bytes();
            // A copy of a constant length needs no loop.
            let stored = match size {
                1 => dictionary.store(*handle, &bytes[..1]),
                2 => dictionary.store(*handle, &bytes[..2]),
                _ => dictionary.store(*handle, &bytes),
            };
            debug_assert!(stored.is_ok(), "each was declared with this type");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::eds;

    fn dictionary(ports: &[Port]) -> ObjectDictionary {
        let terms = ports
            .iter()
            .map(|port| described(port, &Measurand::default()));
        let shipped = eds::parse(dbc::CONTROLLER_EDS, 1).unwrap();
        let mut dictionary = ObjectDictionary::new();
        let terms = Vec::from_iter(terms);
        declare(
            &mut dictionary,
            &shipped,
            &terms,
            &[0x181, 0x281, 0x381, 0x481],
            0,
        );
        dictionary
    }

    #[test]
    fn terms_are_mapped_in_their_order_and_an_empty_tpdo_is_not_there() {
        let dictionary = dictionary(&["a", "b", "c"].map(Port::term));
        let unsigned = |index, sub_index| dictionary.unsigned(index, sub_index);
        assert_eq!(
            [0, 1, 2].map(|sub| unsigned(0x1A00, sub).unwrap()),
            [2, 0x2200_0020, 0x2201_0020]
        );
        let second = [0, 1, 2].map(|sub| unsigned(0x1A01, sub).unwrap());
        assert_eq!(second, [1, 0x2202_0020, 0]);
        assert_eq!(unsigned(0x1800, 1), Some(0x4000_0181));
        assert_eq!((unsigned(0x1802, 1), unsigned(0x1A02, 0)), (None, None));
        let third = dictionary.entry(dictionary.find(0x2202, 0).unwrap());
        assert_eq!(
            (third.name.as_str(), third.data_type),
            ("c", DataType::Real32)
        );
    }

    #[test]
    fn values_are_rounded_and_cut_to_the_range_and_small_ones_share_a_byte() {
        let ports = [
            Port::output("celsius", [-100.0, 100.0]).counted(Width::Signed(16), 100.0),
            Port::flag("hot"),
            Port::output("level", [0.0, 31.0]).counted(Width::Unsigned(5), 1.0),
            Port::position_term("reference_{unit}"),
        ];
        let mut dictionary = dictionary(&ports);
        let terms = ports
            .iter()
            .zip([1.0, 1.0, 1.0, 1e3])
            .enumerate()
            .map(|(place, (port, factor))| (place, port, factor));
        let objects = TermObjects::find(&dictionary, 0, terms).unwrap();
        let mut stored = |writes: [f64; 4]| {
            objects.store(&mut dictionary, &writes);
            [0x2200, 0x2201, 0x2202].map(|index| dictionary.integer(index, 0).unwrap())
        };
        assert_eq!(stored([-20.125, 1.0, 30.6, 0.025]), [-2013, 63, 25_000]);
        assert_eq!(
            stored([1e9, 7.0, -1.0, f64::INFINITY]),
            [10_000, 1, 2_147_483_647]
        );
        assert_eq!(stored([f64::NAN; 4]), [0, 0, 0]);
    }
}
