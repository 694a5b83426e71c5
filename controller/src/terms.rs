//! The terms of a law as objects, from 0x2200 on. The controller's TPDOs map them.

use canopen::object_dictionary::{DataType, Handle};
use canopen::{ObjectDictionary, add_half};
use dbc::{Coding, Kind, Port, Quantities, Range, Signal, Width, first_term, layout};
use scenario::wiring::Measured;

use crate::error::ControllerError;

/// Returns the term of a port as a signal, with its name in its loop. A position is a float where its drive does not count it in
/// thousandths of the unit, or 32 bits do not hold it.
pub(crate) fn described(port: &Port, quantities: &Quantities, feedback: &Measured) -> Signal {
    let is_float = feedback.counts_per_unit() != port.steps_per_unit || feedback.is_true_float();
    let (bits, kind, counts_per_unit) = match port.width {
        _ if port.is_position && is_float => (32, Kind::Float32, 1.0),
        Width::Real32 => (32, Kind::Float32, 1.0),
        Width::Signed(bits) => (bits, Kind::Signed, port.steps_per_unit),
        Width::Unsigned(bits) => (bits, Kind::Unsigned, port.steps_per_unit),
    };
    let [minimum, maximum] = port.range;
    let (name, unit) = quantities.term(port.local_name(), port);
    let range =
        Some(Range { minimum, maximum }).filter(|_| kind != Kind::Float32 || !port.is_position);
    let coding = Coding::little_endian(0, bits, kind, 1.0 / counts_per_unit, range);
    Signal::new(name, &unit, &port.comment, coding)
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
            None => ((value * self.counts) as f32).to_bits(),
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
            .map(|(_, port, _)| described(port, &Quantities::default(), &Measured::default()));
        let layout = layout(&Vec::from_iter(described)).unwrap_or_default();
        let first = first_term(u8::try_from(of_loop).unwrap_or(u8::MAX));
        let mut objects = Vec::new();
        for (index, laid_out) in (first..).zip(&layout) {
            let missing = format!("the controller's EDS has no object 0x{index:04X}");
            let found = dictionary.find(index, 0);
            let handle = found.map_err(|_| ControllerError::Other(missing))?;
            let is_float = dictionary.entry(handle).data_type == DataType::Real32;
            let parts = laid_out.terms.iter().map(|(term, bit)| {
                let (output, port, factor) = terms[*term];
                let steps = if is_float { 1.0 } else { port.steps_per_unit };
                let range = port.range.map(|end| (end * steps).round());
                Part {
                    output,
                    bit: *bit,
                    counts: if port.width == Width::Real32 {
                        1.0
                    } else {
                        steps * factor
                    },
                    range: (!is_float).then_some(range),
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
    use dbc::{Quantity, Unit};

    use super::*;

    fn dictionary(ports: &[Port]) -> ObjectDictionary {
        let terms = ports
            .iter()
            .map(|port| described(port, &Quantities::default(), &Measured::default()));
        let identifiers = [0x181, 0x281, 0x381, 0x481];
        let loops = [(Vec::from_iter(terms), identifiers)];
        dbc::node_objects::controller(1, &loops, &[0x10], &[])
    }

    #[test]
    fn a_position_is_a_float_where_thousandths_of_its_unit_would_not_do() {
        let kind = |unit: &str, max, increment| {
            let measured = Measured {
                quantity: Quantity::position(Unit::Other(unit.to_owned())),
                max,
                increment,
                ..Measured::default()
            };
            described(
                &Port::position_term("reference_{unit}"),
                &Quantities::default(),
                &measured,
            )
            .coding
            .kind
        };
        assert_eq!(kind("degrees", Some(400.0), None), Kind::Signed);
        assert_eq!(kind("bar", Some(10.0), Some(1e-4)), Kind::Float32);
        assert_eq!(kind("pascals", Some(1e6), None), Kind::Float32);
        let port = Port::position_term("reference_{unit}");
        let pressure = Measured {
            increment: Some(1.0),
            ..Measured::default()
        };
        let loops = [(
            vec![described(&port, &Quantities::default(), &pressure)],
            [0x181; 4],
        )];
        let mut dictionary = dbc::node_objects::controller(1, &loops, &[0x10], &[]);
        let terms = [(0, &port, 2.0)].into_iter();
        let objects = TermObjects::find(&dictionary, 0, terms).unwrap();
        objects.store(&mut dictionary, &[4e6]);
        let stored = dictionary.get(0x2200, 0).unwrap().value();
        assert_eq!(stored, 8e6_f32.to_le_bytes());
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
