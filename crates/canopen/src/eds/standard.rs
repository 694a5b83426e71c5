//! The types that CiA 301 and CiA 402 give to objects which the bench uses, for sheets that do not give them.

use crate::object_dictionary::DataType;

/// Returns the type of a standard object; `None` if it is not known here.
pub fn data_type(index: u16, sub_index: u8) -> Option<DataType> {
    let data_type = match (index, sub_index) {
        (0x1000 | 0x1002 | 0x1005..=0x1007 | 0x1012 | 0x1014, 0) => DataType::Unsigned32,
        (0x1001, 0) => DataType::Unsigned8,
        (0x1008..=0x100A, 0) => DataType::VisibleString,
        (0x1015 | 0x1017, 0) => DataType::Unsigned16,
        (0x1003 | 0x1010 | 0x1011 | 0x1016 | 0x1018 | 0x1029 | 0x1200..=0x1BFF, 0) => {
            DataType::Unsigned8
        }
        (0x1003 | 0x1010 | 0x1011 | 0x1016 | 0x1018, _) => DataType::Unsigned32,
        (0x1200..=0x12FF, 1 | 2) => DataType::Unsigned32,
        (0x1029 | 0x1200..=0x12FF, _) => DataType::Unsigned8,
        // Parameters and mappings of PDOs.
        (0x1400..=0x15FF | 0x1800..=0x19FF, 1) => DataType::Unsigned32,
        (0x1400..=0x15FF | 0x1800..=0x19FF, 3 | 5) => DataType::Unsigned16,
        (0x1400..=0x15FF | 0x1800..=0x19FF, _) => DataType::Unsigned8,
        (0x1600..=0x17FF | 0x1A00..=0x1BFF, _) => DataType::Unsigned32,
        (0x603F..=0x6041, 0) => DataType::Unsigned16,
        (0x605A..=0x605E, 0) => DataType::Integer16,
        (0x6060 | 0x6061, 0) => DataType::Integer8,
        (0x6062..=0x6064 | 0x606B | 0x606C | 0x607A | 0x60FF, 0) => DataType::Integer32,
        (0x6071 | 0x6074 | 0x6077 | 0x6078 | 0x60B2, 0) => DataType::Integer16,
        (0x6072 | 0x6073, 0) => DataType::Unsigned16,
        (0x6075 | 0x6076 | 0x6502, 0) => DataType::Unsigned32,
        _ => return None,
    };
    Some(data_type)
}
