//! The PDOs of a dictionary, the rules for writing their objects, and their configuration (CiA 301, 7.5.2.35 to 7.5.2.38).

use std::time::Duration;

use crate::cob_id::{self, CobId};
use crate::object_dictionary::{AbortCode, Accepted, Access, Handle, ObjectDictionary, copy};

/// Most PDOs of a direction: the mappings begin behind the parameters of so many.
const NUMBERS_MAX: u16 = 0x200;

const COB_ID: u8 = 1;
const TRANSMISSION_TYPE: u8 = 2;
const INHIBIT_TIME: u8 = 3;
const EVENT_TIMER: u8 = 5;
const SYNC_START: u8 = 6;

const OBJECTS_MAX: u8 = 8;
const LENGTH_MAX: u8 = 8;

/// Direction of a PDO as seen from its node, with the index of the first PDO's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub(crate) enum Direction {
    Receive = 0x1400,
    Transmit = 0x1800,
}

/// Place of a PDO object: the PDO, and whether it is its parameters or its mapping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) direction: Direction,
    /// Number of the PDO, 1 to 512.
    pub(crate) number: u16,
    is_mapping: bool,
}

impl Place {
    /// Returns the place of a PDO object; `None` for other indices.
    pub(crate) fn from_index(index: u16) -> Option<Self> {
        let direction = match index {
            0x1400..=0x17FF => Direction::Receive,
            0x1800..=0x1BFF => Direction::Transmit,
            _ => return None,
        };
        let offset = index - direction as u16;
        Some(Self {
            direction,
            number: offset % NUMBERS_MAX + 1,
            is_mapping: offset >= NUMBERS_MAX,
        })
    }

    /// Returns the place of a PDO's parameters.
    pub(crate) fn from_parameters(direction: Direction, number: u16) -> Self {
        Self {
            direction,
            number,
            is_mapping: false,
        }
    }

    /// Returns the index of the PDO's parameters.
    pub(crate) fn parameters_index(self) -> u16 {
        self.direction as u16 + self.number - 1
    }
}

/// Returns the 11-bit identifier in a PDO's COB-ID, whether the PDO exists now or not.
///
/// # Errors
/// [`AbortCode::INVALID_VALUE`] for a 29-bit identifier, which no node here sends or hears, and for identifiers that CiA 301
/// keeps for other services.
pub fn identifier(cob_id: u32) -> Accepted<u16> {
    let cob_id = CobId(cob_id);
    cob_id.check().map(|()| cob_id.id())
}

/// Returns the places of the PDOs for which a dictionary has parameters.
pub(crate) fn places(
    dictionary: &ObjectDictionary,
    direction: Direction,
) -> impl Iterator<Item = Place> + '_ {
    let places = (1..=NUMBERS_MAX).map(move |number| Place::from_parameters(direction, number));
    places.filter(|place| dictionary.find(place.parameters_index(), COB_ID).is_ok())
}

/// Checks the rules for writing a PDO object, beyond access rights and limits.
pub(crate) fn check_write(
    dictionary: &ObjectDictionary,
    place: Place,
    sub_index: u8,
    bytes: &[u8],
) -> Accepted {
    let (index, direction) = (place.parameters_index(), place.direction);
    let old = CobId(dictionary.unsigned(index, COB_ID).unwrap_or(0));
    if place.is_mapping {
        return check_mapping_write(dictionary, place, old, sub_index, bytes);
    }
    // CiA 301, 7.5.2.35 and 7.5.2.37.
    match sub_index {
        COB_ID => cob_id::check_write(dictionary, (index, COB_ID), bytes, AbortCode::INVALID_VALUE),
        TRANSMISSION_TYPE => match (direction, bytes) {
            (_, [0..=240 | 254 | 255]) | (Direction::Transmit, [252 | 253]) => Ok(()),
            _ => Err(AbortCode::INVALID_VALUE),
        },
        INHIBIT_TIME | SYNC_START if direction == Direction::Transmit && old.is_valid() => {
            Err(AbortCode::DEVICE_STATE)
        }
        SYNC_START if matches!(bytes, [241..=255]) => Err(AbortCode::INVALID_VALUE),
        _ => Ok(()),
    }
}

/// Checks the rules of CiA 301, 7.5.2.36 and 7.5.2.38.
fn check_mapping_write(
    dictionary: &ObjectDictionary,
    place: Place,
    cob_id: CobId,
    sub_index: u8,
    bytes: &[u8],
) -> Accepted {
    let index = place.parameters_index() + NUMBERS_MAX;
    let count = dictionary.unsigned(index, 0).unwrap_or(0);
    if cob_id.is_valid() || (sub_index != 0 && count != 0) {
        return Err(AbortCode::UNSUPPORTED_ACCESS);
    }
    match (sub_index, bytes) {
        (0, [count]) => Mapping::read(dictionary, index, *count, place.direction).map(drop),
        (0, _) => Err(AbortCode::LENGTH_MISMATCH),
        _ => {
            let bytes = bytes.try_into().map_err(|_| AbortCode::LENGTH_MISMATCH)?;
            match u32::from_le_bytes(bytes) {
                0 => Ok(()),
                entry => Slot::new(dictionary, entry, place.direction).map(drop),
            }
        }
    }
}

/// Mapped object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Slot {
    /// Handle of the object; `None` for a dummy, whose bytes are dropped.
    handle: Option<Handle>,
    size_bytes: u8,
    /// Whether the object has a limit, against which received values are checked.
    is_limited: bool,
}

impl Slot {
    /// Makes the slot of a mapping entry: index, sub-index, length in bits (CiA 301, figure 74).
    fn new(dictionary: &ObjectDictionary, entry: u32, direction: Direction) -> Accepted<Self> {
        let [length_bits, sub_index, low, high] = entry.to_le_bytes();
        let index = u16::from_le_bytes([low, high]);
        let size_bytes = length_bits / 8;
        let dummy_bits = dummy_size_bits(index, sub_index);
        if direction == Direction::Receive && dummy_bits == Some(length_bits) {
            return Ok(Self {
                size_bytes,
                ..Self::default()
            });
        }
        let handle = dictionary.find(index, sub_index)?;
        let entry = dictionary.entry(handle);
        let size_bits = entry.data_type.size_bytes().map(|size| size * 8);
        if !entry.is_pdo_mappable
            || !is_direction_allowed(entry.access, direction)
            || size_bits != Some(usize::from(length_bits))
        {
            return Err(AbortCode::NOT_MAPPABLE);
        }
        Ok(Self {
            handle: Some(handle),
            size_bytes,
            is_limited: entry.low_limit.is_some() || entry.high_limit.is_some(),
        })
    }
}

/// Returns the length in bits of a data type that may be a dummy in an RPDO (CiA 301, 7.4.7.1).
fn dummy_size_bits(index: u16, sub_index: u8) -> Option<u8> {
    match (index, sub_index) {
        (0x0002 | 0x0005, 0) => Some(8),
        (0x0003 | 0x0006, 0) => Some(16),
        (0x0004 | 0x0007, 0) => Some(32),
        _ => None,
    }
}

/// Checks whether an object with these rights may be mapped into a PDO of this direction (CiA 306).
fn is_direction_allowed(access: Access, direction: Direction) -> bool {
    match access {
        Access::ReadWrite => true,
        Access::ReadOnly | Access::Constant | Access::ReadWriteRead => {
            direction == Direction::Transmit
        }
        Access::WriteOnly | Access::ReadWriteWrite => direction == Direction::Receive,
    }
}

/// Checked mapping: the objects of a PDO's bytes. Packing and unpacking do not allocate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapping {
    slots: [Slot; OBJECTS_MAX as usize],
    /// Slots in use.
    count: usize,
    pub(super) length: u8,
}

impl Mapping {
    /// Reads the mapping of the first `count` entries of a mapping object.
    fn read(
        dictionary: &ObjectDictionary,
        index: u16,
        count: u8,
        direction: Direction,
    ) -> Accepted<Self> {
        if count > OBJECTS_MAX {
            return Err(AbortCode::PDO_TOO_LONG);
        }
        let mut mapping = Self {
            slots: [Slot::default(); OBJECTS_MAX as usize],
            count: usize::from(count),
            length: 0,
        };
        for (sub_index, slot) in (1..=count).zip(&mut mapping.slots) {
            let handle = dictionary.find(index, sub_index)?;
            let entry = u32::try_from(dictionary.entry(handle).as_integer())
                .map_err(|_| AbortCode::NOT_MAPPABLE)?;
            *slot = Slot::new(dictionary, entry, direction)?;
            mapping.length += slot.size_bytes;
        }
        if mapping.length > LENGTH_MAX {
            return Err(AbortCode::PDO_TOO_LONG);
        }
        Ok(mapping)
    }

    /// Returns the number of bytes on the wire.
    pub fn length(&self) -> usize {
        usize::from(self.length)
    }

    /// Packs the bytes of the PDO from the dictionary.
    pub(super) fn pack(&self, dictionary: &ObjectDictionary) -> [u8; 8] {
        let mut data = [0; 8];
        for (range, _, handle) in self.places() {
            copy(&mut data[range], dictionary.entry(handle).value());
        }
        data
    }

    /// Stores the bytes of the PDO in the dictionary. A value beyond its object's limits is cut to the limit, since a PDO cannot
    /// be refused as an SDO can; the result is true if that happened.
    pub(super) fn unpack(&self, dictionary: &mut ObjectDictionary, data: &[u8; 8]) -> bool {
        let mut is_cut = false;
        for (range, slot, handle) in self.places() {
            let bytes = &data[range];
            let limit = slot
                .is_limited
                .then(|| dictionary.entry(handle).limit_beyond(bytes))
                .flatten();
            let stored = match limit {
                Some(limit) => dictionary.store(handle, &limit[..bytes.len()]),
                None => dictionary.store(handle, bytes),
            };
            is_cut |= limit.is_some();
            debug_assert!(stored.is_ok(), "a slot has the size of its object");
        }
        is_cut
    }

    /// Returns the place of an object in the PDO.
    pub(super) fn place_of(&self, object: Handle) -> Option<std::ops::Range<usize>> {
        let mut places = self.places();
        places.find_map(|(range, _, handle)| (handle == object).then_some(range))
    }

    /// Returns the place of each object in the PDO, with its slot.
    fn places(&self) -> impl Iterator<Item = (std::ops::Range<usize>, &Slot, Handle)> + '_ {
        let mut start = 0;
        self.slots[..self.count].iter().filter_map(move |slot| {
            let range = start..start + usize::from(slot.size_bytes);
            start = range.end;
            slot.handle.map(|handle| (range, slot, handle))
        })
    }
}

/// Communication parameters of a PDO.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameters {
    /// COB-ID; `None` while the PDO does not exist.
    pub(super) cob_id: Option<u16>,
    pub(super) allows_remote_frames: bool,
    pub(super) transmission_type: u8,
    pub(super) inhibit_time: Duration,
    pub(super) event_timer: Option<Duration>,
    pub(super) sync_start: u8,
}

impl Parameters {
    fn read(dictionary: &ObjectDictionary, place: Place) -> Accepted<Self> {
        let get = |sub_index| dictionary.unsigned(place.parameters_index(), sub_index);
        let cob_id = CobId(get(COB_ID).unwrap_or(u32::MAX));
        if cob_id.is_valid() {
            cob_id.check()?;
        }
        let small = |value: Option<u32>| value.and_then(|value| u8::try_from(value).ok());
        let event_timer = get(EVENT_TIMER).filter(|milliseconds| *milliseconds != 0);
        Ok(Self {
            cob_id: cob_id.is_valid().then(|| cob_id.id()),
            allows_remote_frames: !cob_id.flag_30(),
            transmission_type: small(get(TRANSMISSION_TYPE)).unwrap_or(255),
            inhibit_time: Duration::from_micros(u64::from(get(INHIBIT_TIME).unwrap_or(0)) * 100),
            event_timer: event_timer.map(|value| Duration::from_millis(u64::from(value))),
            sync_start: small(get(SYNC_START)).unwrap_or(0),
        })
    }

    pub(super) fn is_synchronous(&self) -> bool {
        self.transmission_type <= 240
    }
}

/// Reads a PDO's parameters and mapping.
pub(super) fn read(dictionary: &ObjectDictionary, place: Place) -> Accepted<(Parameters, Mapping)> {
    let parameters = Parameters::read(dictionary, place)?;
    let index = place.parameters_index() + NUMBERS_MAX;
    let count = u8::try_from(dictionary.unsigned(index, 0).unwrap_or(0))
        .map_err(|_| AbortCode::PDO_TOO_LONG)?;
    let mapping = Mapping::read(dictionary, index, count, place.direction)?;
    Ok((parameters, mapping))
}
