//! The object dictionary (CiA 301, 7.4) and the SDO abort codes (CiA 301, table 22).

use std::fmt;

use crate::sdo::check_length;

/// Reason for which an access was refused: an SDO abort code (CiA 301, table 22).
#[derive(Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("abort 0x{:04X}_{:04X}: {}", .0 >> 16, .0 & 0xFFFF, self.text())]
pub struct AbortCode(pub u32);

/// Result of an access, or the reason for which it was refused.
pub type Accepted<T = ()> = Result<T, AbortCode>;

macro_rules! abort_codes {
    ($($name:ident = $code:literal, $text:literal;)*) => {
        impl AbortCode {
            $(#[doc = $text] pub const $name: Self = Self($code);)*

            /// Returns the standard's text for the code.
            pub fn text(self) -> &'static str {
                match self.0 { $($code => $text,)* _ => "unknown abort code" }
            }
        }
    };
}

abort_codes! {
    TOGGLE_BIT_NOT_ALTERNATED = 0x0503_0000, "toggle bit not alternated";
    PROTOCOL_TIMED_OUT = 0x0504_0000, "SDO protocol timed out";
    COMMAND_SPECIFIER_INVALID = 0x0504_0001, "command specifier not valid or unknown";
    INVALID_BLOCK_SIZE = 0x0504_0002, "invalid block size";
    INVALID_SEQUENCE_NUMBER = 0x0504_0003, "invalid sequence number";
    CRC_ERROR = 0x0504_0004, "CRC error";
    OUT_OF_MEMORY = 0x0504_0005, "out of memory";
    UNSUPPORTED_ACCESS = 0x0601_0000, "unsupported access to an object";
    WRITE_ONLY = 0x0601_0001, "attempt to read a write only object";
    READ_ONLY = 0x0601_0002, "attempt to write a read only object";
    NO_SUCH_OBJECT = 0x0602_0000, "object does not exist in the object dictionary";
    NOT_MAPPABLE = 0x0604_0041, "object cannot be mapped to the PDO";
    PDO_TOO_LONG = 0x0604_0042, "the mapped objects would exceed the PDO length";
    PARAMETER_INCOMPATIBLE = 0x0604_0043, "general parameter incompatibility";
    HARDWARE_ERROR = 0x0606_0000, "access failed due to a hardware error";
    LENGTH_MISMATCH = 0x0607_0010, "data type or length does not match";
    TOO_LONG = 0x0607_0012, "length of service parameter too high";
    TOO_SHORT = 0x0607_0013, "length of service parameter too low";
    NO_SUCH_SUB_INDEX = 0x0609_0011, "sub-index does not exist";
    INVALID_VALUE = 0x0609_0030, "invalid value for parameter";
    VALUE_TOO_HIGH = 0x0609_0031, "value of parameter written too high";
    VALUE_TOO_LOW = 0x0609_0032, "value of parameter written too low";
    GENERAL_ERROR = 0x0800_0000, "general error";
    CANNOT_STORE = 0x0800_0020, "data cannot be transferred or stored to the application";
    LOCAL_CONTROL = 0x0800_0021, "data cannot be transferred or stored because of local control";
    DEVICE_STATE = 0x0800_0022, "data cannot be transferred or stored because of the present device state";
    NO_DATA = 0x0800_0024, "no data available";
}

impl fmt::Debug for AbortCode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, formatter)
    }
}

/// The data types that the dictionary holds, by their CiA 301 numbers (table 44).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names are the standard's")]
pub enum DataType {
    Boolean,
    Integer8,
    Integer16,
    Integer32,
    Integer64,
    Unsigned8,
    Unsigned16,
    Unsigned32,
    Unsigned64,
    Integer24,
    Integer40,
    Integer48,
    Integer56,
    Unsigned24,
    Unsigned40,
    Unsigned48,
    Unsigned56,
    Real32,
    Real64,
    TimeOfDay,
    TimeDifference,
    VisibleString,
    UnicodeString,
    OctetString,
    Domain,
}

/// The data types with their numbers.
const NUMBERS: [(u16, DataType); 25] = [
    (0x01, DataType::Boolean),
    (0x02, DataType::Integer8),
    (0x03, DataType::Integer16),
    (0x04, DataType::Integer32),
    (0x05, DataType::Unsigned8),
    (0x06, DataType::Unsigned16),
    (0x07, DataType::Unsigned32),
    (0x08, DataType::Real32),
    (0x09, DataType::VisibleString),
    (0x0A, DataType::OctetString),
    (0x0B, DataType::UnicodeString),
    (0x0C, DataType::TimeOfDay),
    (0x0D, DataType::TimeDifference),
    (0x0F, DataType::Domain),
    (0x10, DataType::Integer24),
    (0x11, DataType::Real64),
    (0x12, DataType::Integer40),
    (0x13, DataType::Integer48),
    (0x14, DataType::Integer56),
    (0x15, DataType::Integer64),
    (0x16, DataType::Unsigned24),
    (0x18, DataType::Unsigned40),
    (0x19, DataType::Unsigned48),
    (0x1A, DataType::Unsigned56),
    (0x1B, DataType::Unsigned64),
];

impl DataType {
    /// Returns the type with this CiA 301 number.
    pub fn from_number(number: u32) -> Option<Self> {
        let mut numbers = NUMBERS.into_iter();
        numbers.find_map(|(one, data_type)| (u32::from(one) == number).then_some(data_type))
    }

    /// Returns the type with this name in CiA 301; case does not matter.
    pub(crate) fn from_name(name: &str) -> Option<Self> {
        if !name.starts_with(|first: char| first.is_ascii_alphabetic()) {
            return None;
        }
        let name = name.replace('_', "");
        let mut types = NUMBERS.iter().map(|(_, data_type)| *data_type);
        types.find(|data_type| format!("{data_type:?}").eq_ignore_ascii_case(&name))
    }

    /// Returns its CiA 301 number.
    pub fn number(self) -> u16 {
        let found = NUMBERS.iter().find(|(_, data_type)| *data_type == self);
        found.map_or(0, |(number, _)| *number)
    }

    /// Returns the length in bytes; `None` if it varies.
    pub fn size_bytes(self) -> Option<usize> {
        match self {
            Self::Boolean | Self::Integer8 | Self::Unsigned8 => Some(1),
            Self::Integer16 | Self::Unsigned16 => Some(2),
            Self::Integer24 | Self::Unsigned24 => Some(3),
            Self::Integer40 | Self::Unsigned40 => Some(5),
            Self::Integer48 | Self::Unsigned48 => Some(6),
            Self::TimeOfDay | Self::TimeDifference => Some(6),
            Self::Integer56 | Self::Unsigned56 => Some(7),
            Self::Integer32 | Self::Unsigned32 | Self::Real32 => Some(4),
            Self::Integer64 | Self::Unsigned64 | Self::Real64 => Some(8),
            Self::VisibleString | Self::UnicodeString | Self::OctetString | Self::Domain => None,
        }
    }

    /// Checks whether it is a signed integer.
    pub fn is_signed(self) -> bool {
        matches!(
            self,
            Self::Integer8
                | Self::Integer16
                | Self::Integer24
                | Self::Integer32
                | Self::Integer40
                | Self::Integer48
                | Self::Integer56
                | Self::Integer64
        )
    }

    /// Checks whether it is a floating-point type.
    pub fn is_real(self) -> bool {
        matches!(self, Self::Real32 | Self::Real64)
    }

    /// Returns the value with this rank, little-endian, in its first bytes: the inverse of [`DataType::rank`].
    fn value_of_rank(self, rank: i128) -> [u8; 16] {
        let size = self.size_bytes().unwrap_or(0);
        if !self.is_real() || rank >= 0 || size == 0 {
            return rank.to_le_bytes();
        }
        let sign_bit = 1 << (8 * size - 1);
        ((-1 - rank) ^ sign_bit).to_le_bytes()
    }

    /// Returns the rank of a value among the values of its type, for comparison with limits: the integer itself, and for reals a
    /// number that grows with the value (-0 below +0, NaN outside the infinities). 0 for types without an order.
    pub fn rank(self, bytes: &[u8]) -> i128 {
        if !self.is_real() {
            return integer_from_le(self, bytes);
        }
        let mut buffer = [0; 16];
        let length = bytes.len().min(8);
        buffer[..length].copy_from_slice(&bytes[..length]);
        // IEEE 754 orders like sign and magnitude.
        let bits = i128::from_le_bytes(buffer);
        let sign_bit = 1 << (8 * length.max(1) - 1);
        if bits & sign_bit == 0 {
            bits
        } else {
            -1 - (bits ^ sign_bit)
        }
    }
}

/// Access rights to an object (CiA 306).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// `ro`
    ReadOnly,
    /// `wo`
    WriteOnly,
    /// `rw`
    ReadWrite,
    /// `rwr`: as `rw`, mappable into a TPDO only.
    ReadWriteRead,
    /// `rww`: as `rw`, mappable into an RPDO only.
    ReadWriteWrite,
    /// `const`
    Constant,
}

impl Access {
    pub(crate) const ALL: [Self; 6] = [
        Self::ReadOnly,
        Self::WriteOnly,
        Self::ReadWrite,
        Self::ReadWriteRead,
        Self::ReadWriteWrite,
        Self::Constant,
    ];

    /// Returns its word in an EDS.
    pub fn word(self) -> &'static str {
        match self {
            Self::ReadOnly => "ro",
            Self::WriteOnly => "wo",
            Self::ReadWrite => "rw",
            Self::ReadWriteRead => "rwr",
            Self::ReadWriteWrite => "rww",
            Self::Constant => "const",
        }
    }

    /// Checks whether SDO may read it.
    pub fn is_readable(self) -> bool {
        self != Self::WriteOnly
    }

    /// Checks whether SDO may write it.
    pub fn is_writable(self) -> bool {
        !matches!(self, Self::ReadOnly | Self::Constant)
    }
}

/// Place in the dictionary, found once and used without search afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Handle(usize);

/// Values that one device sets in a data sheet that many devices share: the default of an integer, and its limits.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Preset {
    /// Index of the object.
    pub index: u16,
    /// Sub-index.
    pub sub_index: u8,
    /// Value after power-on and NMT reset.
    pub value: i64,
    /// Lowest and highest value; those of the data sheet if `None`.
    pub limits: Option<[i64; 2]>,
}

impl Preset {
    /// Makes a value within the limits of the data sheet.
    pub const fn new(index: u16, sub_index: u8, value: i64) -> Self {
        Self {
            index,
            sub_index,
            value,
            limits: None,
        }
    }
}

/// Sub-object.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Index of the object.
    pub index: u16,
    /// Sub-index.
    pub sub_index: u8,
    /// Name in the EDS.
    pub name: String,
    /// Type of the value.
    pub data_type: DataType,
    /// Access rights.
    pub access: Access,
    /// Whether it may be mapped into a PDO.
    pub is_pdo_mappable: bool,
    /// Whether the data sheet leaves open if it may be mapped. CiA 306-1 then says that it may not, but sheets forget it.
    pub lacks_pdo_mapping: bool,
    /// Lowest value that may be written, if the EDS gives one, as its [`DataType::rank`].
    pub low_limit: Option<i128>,
    /// Highest value that may be written, if the EDS gives one, as its [`DataType::rank`].
    pub high_limit: Option<i128>,
    /// Value after power-on and NMT reset, little-endian.
    pub default: Vec<u8>,
    /// Value, little-endian. Numeric values never change their length, so writing them does not allocate.
    value: Vec<u8>,
}

impl Entry {
    /// Makes a sub-object that holds its default.
    pub fn new(
        index: u16,
        sub_index: u8,
        name: &str,
        data_type: DataType,
        access: Access,
        default: Vec<u8>,
    ) -> Self {
        Self {
            index,
            sub_index,
            name: name.to_owned(),
            data_type,
            access,
            is_pdo_mappable: false,
            lacks_pdo_mapping: false,
            low_limit: None,
            high_limit: None,
            value: default.clone(),
            default,
        }
    }

    /// Returns it at another place.
    #[must_use]
    pub fn at(self, index: u16, sub_index: u8) -> Self {
        Self {
            index,
            sub_index,
            ..self
        }
    }

    /// Gives it another default, which it then holds.
    pub fn set_default(&mut self, default: Vec<u8>) {
        self.value.clone_from(&default);
        self.default = default;
    }

    /// Returns the value, little-endian.
    #[inline]
    pub fn value(&self) -> &[u8] {
        &self.value
    }

    /// Returns the value as an integer; 0 for types that are not integers.
    #[inline]
    pub fn as_integer(&self) -> i128 {
        integer_from_le(self.data_type, &self.value)
    }

    /// Decodes bytes as an integer of this object's type; 0 for types that are not integers.
    #[inline]
    pub fn decode_integer(&self, bytes: &[u8]) -> i128 {
        integer_from_le(self.data_type, bytes)
    }

    /// Returns the limit that a value of the type's length exceeds, little-endian in the first bytes; `None` if it is within the
    /// limits.
    pub(crate) fn limit_beyond(&self, bytes: &[u8]) -> Option<[u8; 16]> {
        let rank = self.data_type.rank(bytes);
        let above = self.high_limit.filter(|limit| rank > *limit);
        let beyond = above.or(self.low_limit.filter(|limit| rank < *limit))?;
        Some(self.data_type.value_of_rank(beyond))
    }

    /// Checks length and limits of a value to be written.
    ///
    /// # Errors
    /// Too long, too short, too high or too low.
    pub fn check(&self, bytes: &[u8]) -> Accepted {
        let Some(size) = self.data_type.size_bytes() else {
            return Ok(());
        };
        check_length(bytes.len(), Some(size))?;
        let value = self.data_type.rank(bytes);
        if self.high_limit.is_some_and(|limit| value > limit) {
            return Err(AbortCode::VALUE_TOO_HIGH);
        }
        if self.low_limit.is_some_and(|limit| value < limit) {
            return Err(AbortCode::VALUE_TOO_LOW);
        }
        Ok(())
    }
}

/// Copies a value. The widths of every cycle are written out, so that the compiler makes no call for them.
#[inline]
pub(crate) fn copy(to: &mut [u8], from: &[u8]) {
    match from.len() {
        1 => to.copy_from_slice(&from[..1]),
        2 => to.copy_from_slice(&from[..2]),
        4 => to.copy_from_slice(&from[..4]),
        _ => to.copy_from_slice(from),
    }
}

/// Reads little-endian bytes as an integer, sign-extended by type; 0 for types that are not integers.
#[inline]
fn integer_from_le(data_type: DataType, bytes: &[u8]) -> i128 {
    if matches!(data_type.size_bytes(), None | Some(0)) || data_type.is_real() {
        return 0;
    }
    let is_signed = data_type.is_signed();
    match *bytes {
        // The widths that are read in every cycle.
        [a] if is_signed => i128::from(a.cast_signed()),
        [a] => i128::from(a),
        [a, b] if is_signed => i128::from(i16::from_le_bytes([a, b])),
        [a, b] => i128::from(u16::from_le_bytes([a, b])),
        [a, b, c, d] if is_signed => i128::from(i32::from_le_bytes([a, b, c, d])),
        [a, b, c, d] => i128::from(u32::from_le_bytes([a, b, c, d])),
        _ => {
            let is_negative = is_signed && bytes.last().is_some_and(|byte| byte & 0x80 != 0);
            let mut buffer = if is_negative { [0xFF; 16] } else { [0; 16] };
            let length = bytes.len().min(16);
            buffer[..length].copy_from_slice(&bytes[..length]);
            i128::from_le_bytes(buffer)
        }
    }
}

/// All objects of a node, sorted by index and sub-index.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectDictionary {
    entries: Vec<Entry>,
}

impl ObjectDictionary {
    /// Makes an empty dictionary.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a sub-object, or replaces the one at the same place. Handles taken before are void.
    pub fn insert(&mut self, entry: Entry) {
        match self.place(entry.index, entry.sub_index) {
            Ok(place) => self.entries[place] = entry,
            Err(place) => self.entries.insert(place, entry),
        }
    }

    /// Removes the sub-objects for which this is true, and returns them. Handles taken before are void.
    pub fn take(&mut self, is_taken: impl Fn(&Entry) -> bool) -> Self {
        let entries = self.entries.extract_if(.., |entry| is_taken(entry));
        Self {
            entries: entries.collect(),
        }
    }

    /// Sets the default and the limits of a sub-object, if it is there: its lowest bytes, as many as its type has.
    pub fn preset(&mut self, preset: &Preset) {
        let Ok(Handle(place)) = self.find(preset.index, preset.sub_index) else {
            return;
        };
        let entry = &mut self.entries[place];
        let length = entry.default.len();
        let bytes = preset.value.to_le_bytes();
        entry.set_default(bytes[..length.min(bytes.len())].to_vec());
        if let Some([low, high]) = preset.limits {
            entry.low_limit = Some(low.into());
            entry.high_limit = Some(high.into());
        }
    }

    /// Returns the objects of a PDO like another one of this dictionary, whose parameters and mapping are at `like`. It has the
    /// same parameters at `at`, with an identifier and mapped objects of its own; the names of its entries are those of the copied
    /// PDO.
    pub fn pdo_like(
        &self,
        like: [u16; 2],
        at: [u16; 2],
        identifier: u16,
        mapped: &[u32],
    ) -> Vec<Entry> {
        let copied = |entry: &Entry| {
            let place = like.iter().position(|index| *index == entry.index)?;
            let mut copied = entry.clone();
            copied.index = at[place];
            let sub_index = usize::from(entry.sub_index);
            copied.set_default(match (place, sub_index) {
                (0, 1) => {
                    let flags = entry.decode_integer(&entry.default) & !0x7FF;
                    (flags | i128::from(identifier)).to_le_bytes()[..4].to_vec()
                }
                (0, _) => entry.default.clone(),
                (_, 0) => mapped.len().to_le_bytes()[..1].to_vec(),
                (_, number) => {
                    let object = mapped.get(number - 1).copied();
                    object.unwrap_or_default().to_le_bytes().to_vec()
                }
            });
            Some(copied)
        };
        self.entries.iter().filter_map(copied).collect()
    }

    /// Finds a sub-object.
    ///
    /// # Errors
    /// [`AbortCode::NO_SUCH_OBJECT`] or [`AbortCode::NO_SUCH_SUB_INDEX`].
    pub fn find(&self, index: u16, sub_index: u8) -> Accepted<Handle> {
        self.place(index, sub_index).map(Handle).map_err(|place| {
            let next = (place + 1).min(self.entries.len());
            let mut neighbours = self.entries[place.saturating_sub(1)..next].iter();
            if neighbours.any(|entry| entry.index == index) {
                AbortCode::NO_SUCH_SUB_INDEX
            } else {
                AbortCode::NO_SUCH_OBJECT
            }
        })
    }

    /// Returns a sub-object; `None` if it does not exist.
    pub fn get(&self, index: u16, sub_index: u8) -> Option<&Entry> {
        let place = self.place(index, sub_index).ok()?;
        Some(&self.entries[place])
    }

    /// Returns the place of a sub-object, or the place where it would be.
    fn place(&self, index: u16, sub_index: u8) -> Result<usize, usize> {
        let key = |entry: &Entry| (entry.index, entry.sub_index);
        self.entries.binary_search_by_key(&(index, sub_index), key)
    }

    /// Returns the sub-object at a handle.
    #[inline]
    pub fn entry(&self, handle: Handle) -> &Entry {
        &self.entries[handle.0]
    }

    /// Returns all sub-objects in order.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Stores a value without regard to access rights, as the application does.
    ///
    /// # Errors
    /// A numeric value of another length than the type's.
    #[inline]
    pub fn store(&mut self, handle: Handle, bytes: &[u8]) -> Accepted {
        let entry = &mut self.entries[handle.0];
        // A numeric value has the length of its type, so all of them take this branch.
        if entry.value.len() == bytes.len() {
            copy(&mut entry.value, bytes);
            return Ok(());
        }
        if entry.data_type.size_bytes().is_some() {
            return Err(AbortCode::LENGTH_MISMATCH);
        }
        entry.value.clear();
        entry.value.extend_from_slice(bytes);
        Ok(())
    }

    /// Returns the integer at index and sub-index; `None` if there is no such object.
    pub fn integer(&self, index: u16, sub_index: u8) -> Option<i128> {
        self.get(index, sub_index).map(Entry::as_integer)
    }

    /// Stores an integer at index and sub-index in the width of its type. It is a write of the application itself, so access
    /// rights and limits do not count.
    ///
    /// # Errors
    /// No such object, or the value does not fit the type.
    pub fn set_integer(&mut self, index: u16, sub_index: u8, value: i128) -> Accepted {
        let handle = self.find(index, sub_index)?;
        let entry = &mut self.entries[handle.0];
        let size = entry
            .data_type
            .size_bytes()
            .ok_or(AbortCode::LENGTH_MISMATCH)?;
        let bytes = value.to_le_bytes();
        if integer_from_le(entry.data_type, &bytes[..size]) != value {
            return Err(AbortCode::INVALID_VALUE);
        }
        entry.value.copy_from_slice(&bytes[..size]);
        Ok(())
    }

    /// Returns the integer at index and sub-index if it exists and fits 32 bits without sign.
    pub fn unsigned(&self, index: u16, sub_index: u8) -> Option<u32> {
        self.integer(index, sub_index)
            .and_then(|value| u32::try_from(value).ok())
    }

    /// Returns the value as a client may read it.
    ///
    /// # Errors
    /// No such object or sub-index, or write only.
    pub fn read(&self, index: u16, sub_index: u8) -> Accepted<&[u8]> {
        let entry = self.entry(self.find(index, sub_index)?);
        if !entry.access.is_readable() {
            return Err(AbortCode::WRITE_ONLY);
        }
        Ok(entry.value())
    }

    /// Checks whether a client may write these bytes: existence, access right, length, limits, in this order.
    ///
    /// # Errors
    /// No such object or sub-index, read only, too long or short, too high or low.
    pub fn check_write(&self, index: u16, sub_index: u8, bytes: &[u8]) -> Accepted<Handle> {
        let handle = self.find(index, sub_index)?;
        let entry = self.entry(handle);
        if !entry.access.is_writable() {
            return Err(AbortCode::READ_ONLY);
        }
        entry.check(bytes)?;
        Ok(handle)
    }

    /// Restores the defaults of all objects whose index is in the range (NMT reset).
    pub fn restore_defaults(&mut self, indices: std::ops::RangeInclusive<u16>) {
        for entry in self
            .entries
            .iter_mut()
            .filter(|entry| indices.contains(&entry.index))
        {
            entry.value.clear();
            entry.value.extend_from_slice(&entry.default);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_beyond_a_limit_of_any_type_has_that_limit_in_its_place() {
        let real = |value: f32| value.to_le_bytes().to_vec();
        let whole = |value: i16| value.to_le_bytes().to_vec();
        let ends = |low: f32, high: f32| (real(low), real(high));
        for (data_type, (low, high), value, expected) in [
            (DataType::Real32, ends(-2.5, 3.5), real(4.0), real(3.5)),
            (DataType::Real32, ends(-2.5, 3.5), real(-1e9), real(-2.5)),
            (DataType::Real32, ends(-2.5, -1.5), real(0.0), real(-1.5)),
            (DataType::Real32, ends(-2.5, 3.5), real(f32::NAN), real(3.5)),
            (DataType::Real32, ends(-2.5, 3.5), real(-2.0), real(-2.0)),
            (
                DataType::Integer16,
                (whole(-7), whole(7)),
                whole(-8),
                whole(-7),
            ),
            (
                DataType::Integer16,
                (whole(-7), whole(7)),
                whole(7),
                whole(7),
            ),
        ] {
            let mut entry = Entry::new(0x2000, 0, "", data_type, Access::ReadWrite, value.clone());
            entry.low_limit = Some(data_type.rank(&low));
            entry.high_limit = Some(data_type.rank(&high));
            let limit = entry.limit_beyond(&value);
            let stored = limit.map_or(value.clone(), |limit| limit[..value.len()].to_vec());
            assert_eq!(stored, expected, "{value:?}");
            assert_eq!(entry.check(&value).is_err(), limit.is_some());
        }
    }
}
