//! The objects that an application uses every cycle. They are found and checked once, then accessed without a search.

use canopen::object_dictionary::{DataType, Handle};
use canopen::{NodeId, ObjectDictionary, add_half};

use crate::InvalidEmulator;

/// Converts a number to a node-ID.
pub(crate) fn node_id(number: u8) -> Result<NodeId, InvalidEmulator> {
    NodeId::new(number).ok_or_else(|| InvalidEmulator::Other(format!("{number} is no node-ID")))
}

/// Finds an object of a given type.
pub(crate) fn find(
    dictionary: &ObjectDictionary,
    index: u16,
    sub_index: u8,
    data_type: DataType,
) -> Result<Handle, InvalidEmulator> {
    let found = dictionary.find(index, sub_index).ok();
    found
        .filter(|handle| dictionary.entry(*handle).data_type == data_type)
        .ok_or_else(|| {
            InvalidEmulator::Other(format!(
                "the EDS has no object {index:#06x}:{sub_index:02x} of type {data_type:?}"
            ))
        })
}

/// Stores a value. Its width is that of the object's type, as [`find`] has checked.
pub(crate) fn store(dictionary: &mut ObjectDictionary, handle: Handle, bytes: &[u8]) {
    let stored = dictionary.store(handle, bytes);
    debug_assert!(stored.is_ok(), "the type was checked when it was found");
}

/// Returns an integer object as a signed number of 16 bits, saturated.
pub(crate) fn integer16(dictionary: &ObjectDictionary, handle: Handle) -> i16 {
    let limits = i128::from(i16::MIN)..=i128::from(i16::MAX);
    let value = dictionary.entry(handle).as_integer();
    i16::try_from(value.clamp(*limits.start(), *limits.end())).unwrap_or_default()
}

/// Rounds a number to the nearest integer, saturated; 0 for NaN.
#[inline]
pub(crate) fn rounded_i32(value: f64) -> i32 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the cast saturates and makes 0 of NaN, which is what is wanted"
    )]
    let rounded = add_half(value) as i32;
    rounded
}

/// Range of 16 bits with sign.
pub(crate) const SIGNED_16: [i32; 2] = [-0x8000, 0x7FFF];
/// Range of 16 bits without sign.
pub(crate) const UNSIGNED_16: [i32; 2] = [0, 0xFFFF];

/// Works as [`rounded_i32`], for 16 bits in a range.
#[inline]
pub(crate) fn rounded_16(value: f64, [min, max]: [i32; 2]) -> [u8; 2] {
    let [low, high, ..] = rounded_i32(value).clamp(min, max).to_le_bytes();
    [low, high]
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::object_dictionary::{Access, Entry};

    #[test]
    fn an_object_of_another_type_is_missing() {
        let mut dictionary = ObjectDictionary::new();
        let bytes = vec![0, 0];
        let entry = Entry::new(0x6071, 0, "", DataType::Integer16, Access::ReadWrite, bytes);
        dictionary.insert(entry);
        assert!(find(&dictionary, 0x6071, 0, DataType::Integer16).is_ok());
        let missing = find(&dictionary, 0x6071, 0, DataType::Integer32).unwrap_err();
        assert_eq!(
            missing.to_string(),
            "the EDS has no object 0x6071:00 of type Integer32"
        );
    }

    #[test]
    fn rounding_saturates() {
        assert_eq!(rounded_i32(1e12), i32::MAX);
        assert_eq!(rounded_16(-1e12, SIGNED_16), i16::MIN.to_le_bytes());
        assert_eq!(rounded_16(-1.0, UNSIGNED_16), [0, 0]);
        assert_eq!(rounded_16(1.5, UNSIGNED_16), [2, 0]);
        assert_eq!(rounded_16(1e12, UNSIGNED_16), [0xFF, 0xFF]);
        assert_eq!(rounded_i32(f64::NAN), 0);
    }
}
