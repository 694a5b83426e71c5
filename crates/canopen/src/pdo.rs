//! Process data objects (CiA 301, 7.2.2, 7.5.2.35 to 7.5.2.38): parameters, mapping, reception and transmission.
//!
//! Mapping is by bytes: at most eight objects and 64 bits. A mapping is written in the standard's order: destroy the
//! PDO (bit 31), write 0 to sub-index 0, write the entries, write their number, create the PDO. Another order is
//! refused with [`AbortCode::UNSUPPORTED_ACCESS`].

use std::time::Duration;

use crate::cob_id::CobId;
use crate::frame::CanFrame;
use crate::node::earlier;
use crate::object_dictionary::{AbortCode, Access, Handle, ObjectDictionary, copy};
use crate::sync::Sync;

const RPDO_PARAMETERS: u16 = 0x1400;
const RPDO_MAPPINGS: u16 = 0x1600;
const TPDO_PARAMETERS: u16 = 0x1800;
const TPDO_MAPPINGS: u16 = 0x1A00;
const NUMBERS_PER_TYPE: u16 = 0x200;
/// Distance between a PDO's parameters and its mapping.
const MAPPING_OFFSET: u16 = RPDO_MAPPINGS - RPDO_PARAMETERS;

const COB_ID: u8 = 1;
const TRANSMISSION_TYPE: u8 = 2;
const INHIBIT_TIME: u8 = 3;
const EVENT_TIMER: u8 = 5;
const SYNC_START: u8 = 6;

const OBJECTS_MAX: u8 = 8;
const LENGTH_MAX: u8 = 8;

/// The way of a PDO as seen from its node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    Receive,
    Transmit,
}

/// A PDO object's place: which PDO, and whether its parameters or its mapping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) direction: Direction,
    /// 1 to 512.
    pub(crate) number: u16,
    is_mapping: bool,
}

impl Place {
    /// The place of a PDO object; `None` for other indices.
    pub(crate) fn of(index: u16) -> Option<Self> {
        let (direction, is_mapping, base) = match index {
            0x1400..=0x15FF => (Direction::Receive, false, RPDO_PARAMETERS),
            0x1600..=0x17FF => (Direction::Receive, true, RPDO_MAPPINGS),
            0x1800..=0x19FF => (Direction::Transmit, false, TPDO_PARAMETERS),
            0x1A00..=0x1BFF => (Direction::Transmit, true, TPDO_MAPPINGS),
            _ => return None,
        };
        Some(Self {
            direction,
            number: index - base + 1,
            is_mapping,
        })
    }

    fn parameters_index(self) -> u16 {
        let base = match self.direction {
            Direction::Receive => RPDO_PARAMETERS,
            Direction::Transmit => TPDO_PARAMETERS,
        };
        base + self.number - 1
    }
}

/// The numbers of the PDOs that a dictionary has parameters for.
pub(crate) fn numbers(
    dictionary: &ObjectDictionary,
    direction: Direction,
) -> impl Iterator<Item = u16> + '_ {
    (1..=NUMBERS_PER_TYPE).filter(move |number| {
        let place = Place {
            direction,
            number: *number,
            is_mapping: false,
        };
        dictionary.find(place.parameters_index(), COB_ID).is_ok()
    })
}

/// The rules for writing a PDO object, beyond access rights and limits.
pub(crate) fn check_write(
    dictionary: &ObjectDictionary,
    place: Place,
    sub_index: u8,
    bytes: &[u8],
) -> Result<(), AbortCode> {
    let cob_id = dictionary.unsigned(place.parameters_index(), COB_ID);
    let cob_id = CobId(cob_id.unwrap_or(0));
    if place.is_mapping {
        check_mapping_write(dictionary, place, cob_id, sub_index, bytes)
    } else {
        check_parameter_write(place.direction, cob_id, sub_index, bytes)
    }
}

/// CiA 301, 7.5.2.35 and 7.5.2.37.
fn check_parameter_write(
    direction: Direction,
    old: CobId,
    sub_index: u8,
    bytes: &[u8],
) -> Result<(), AbortCode> {
    match sub_index {
        COB_ID => {
            let new = CobId::from_bytes(bytes)?;
            new.check()?;
            if old.is_valid() && new.is_valid() && old.id() != new.id() {
                return Err(AbortCode::INVALID_VALUE);
            }
            Ok(())
        }
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

/// CiA 301, 7.5.2.36 and 7.5.2.38.
fn check_mapping_write(
    dictionary: &ObjectDictionary,
    place: Place,
    cob_id: CobId,
    sub_index: u8,
    bytes: &[u8],
) -> Result<(), AbortCode> {
    let index = place.parameters_index() + MAPPING_OFFSET;
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

/// One mapped object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Slot {
    /// `None` for a dummy, whose bytes nobody takes.
    handle: Option<Handle>,
    size_bytes: u8,
}

impl Slot {
    const UNUSED: Self = Self {
        handle: None,
        size_bytes: 0,
    };

    /// The slot that a mapping entry describes: index, sub-index, length in bits (CiA 301, figure 74).
    fn new(
        dictionary: &ObjectDictionary,
        entry: u32,
        direction: Direction,
    ) -> Result<Self, AbortCode> {
        let [length_bits, sub_index, low, high] = entry.to_le_bytes();
        let index = u16::from_le_bytes([low, high]);
        let size_bytes = length_bits / 8;
        if direction == Direction::Receive
            && dummy_size_bytes(index, sub_index) == Some(length_bits / 8)
            && length_bits % 8 == 0
        {
            let handle = None;
            return Ok(Self { handle, size_bytes });
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
        let handle = Some(handle);
        Ok(Self { handle, size_bytes })
    }
}

/// The length of a data type that may stand as a dummy in an RPDO (CiA 301, 7.4.7.1).
fn dummy_size_bytes(index: u16, sub_index: u8) -> Option<u8> {
    match (index, sub_index) {
        (0x0002 | 0x0005, 0) => Some(1),
        (0x0003 | 0x0006, 0) => Some(2),
        (0x0004 | 0x0007, 0) => Some(4),
        _ => None,
    }
}

/// CiA 306: what may be mapped where.
fn is_direction_allowed(access: Access, direction: Direction) -> bool {
    match access {
        Access::ReadWrite => true,
        Access::ReadOnly | Access::Constant | Access::ReadWriteRead => {
            direction == Direction::Transmit
        }
        Access::WriteOnly | Access::ReadWriteWrite => direction == Direction::Receive,
    }
}

/// A checked mapping: where the bytes of a PDO belong. Packing and unpacking allocate nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapping {
    slots: [Slot; OBJECTS_MAX as usize],
    /// Slots in use.
    count: usize,
    length: u8,
}

impl Mapping {
    const EMPTY: Self = Self {
        slots: [Slot::UNUSED; OBJECTS_MAX as usize],
        count: 0,
        length: 0,
    };

    /// The mapping of the first `count` entries of a mapping object.
    fn read(
        dictionary: &ObjectDictionary,
        index: u16,
        count: u8,
        direction: Direction,
    ) -> Result<Self, AbortCode> {
        if count > OBJECTS_MAX {
            return Err(AbortCode::PDO_TOO_LONG);
        }
        let mut mapping = Self {
            count: usize::from(count),
            ..Self::EMPTY
        };
        for (sub_index, slot) in (1..=count).zip(&mut mapping.slots) {
            let handle = dictionary.find(index, sub_index)?;
            let entry = u32::try_from(dictionary.entry(handle).as_integer());
            let entry = entry.map_err(|_| AbortCode::NOT_MAPPABLE)?;
            *slot = Slot::new(dictionary, entry, direction)?;
            mapping.length += slot.size_bytes;
        }
        if mapping.length > LENGTH_MAX {
            return Err(AbortCode::PDO_TOO_LONG);
        }
        Ok(mapping)
    }

    /// Bytes on the wire.
    #[must_use]
    pub fn length(&self) -> usize {
        usize::from(self.length)
    }

    /// The bytes of the PDO from the dictionary.
    fn pack(&self, dictionary: &ObjectDictionary) -> [u8; 8] {
        let mut data = [0; 8];
        for (range, handle) in self.ranges() {
            copy(&mut data[range], dictionary.entry(handle).value());
        }
        data
    }

    /// Stores the bytes of the PDO in the dictionary.
    fn unpack(&self, dictionary: &mut ObjectDictionary, data: &[u8; 8]) {
        for (range, handle) in self.ranges() {
            let stored = dictionary.store(handle, &data[range]);
            debug_assert!(stored.is_ok(), "a slot has the size of its object");
        }
    }

    /// Each object with its place in the PDO.
    fn ranges(&self) -> impl Iterator<Item = (std::ops::Range<usize>, Handle)> + '_ {
        let mut start = 0;
        self.slots[..self.count].iter().filter_map(move |slot| {
            let range = start..start + usize::from(slot.size_bytes);
            start = range.end;
            slot.handle.map(|handle| (range, handle))
        })
    }
}

/// A synchronous RPDO that has arrived and takes effect at the next SYNC.
#[derive(Clone, Copy, Debug)]
pub struct WaitingPdo {
    /// Number of the RPDO, from 1.
    pub number: u16,
    mapping: Mapping,
    data: [u8; 8],
}

impl WaitingPdo {
    /// The integer that an object will get; `None` when it is not mapped here.
    #[must_use]
    pub fn integer(&self, dictionary: &ObjectDictionary, wanted: Handle) -> Option<i128> {
        let (range, handle) = self
            .mapping
            .ranges()
            .find(|(_, handle)| *handle == wanted)?;
        Some(dictionary.entry(handle).decode_integer(&self.data[range]))
    }
}

/// A PDO's communication parameters.
#[derive(Clone, Copy, Debug)]
struct Parameters {
    /// `None` while the PDO does not exist.
    cob_id: Option<u16>,
    allows_remote_frames: bool,
    transmission_type: u8,
    inhibit_time: Duration,
    event_timer: Option<Duration>,
    sync_start: u8,
}

impl Parameters {
    fn read(dictionary: &ObjectDictionary, place: Place) -> Result<Self, AbortCode> {
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

    fn is_synchronous(&self) -> bool {
        self.transmission_type <= 240
    }
}

/// Reads a PDO's parameters and mapping.
fn read(dictionary: &ObjectDictionary, place: Place) -> Result<(Parameters, Mapping), AbortCode> {
    let parameters = Parameters::read(dictionary, place)?;
    let index = place.parameters_index() + MAPPING_OFFSET;
    let count = u8::try_from(dictionary.unsigned(index, 0).unwrap_or(0));
    let count = count.map_err(|_| AbortCode::PDO_TOO_LONG)?;
    let mapping = Mapping::read(dictionary, index, count, place.direction)?;
    Ok((parameters, mapping))
}

/// What became of a received PDO.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Received {
    /// Its data are in the dictionary.
    Stored,
    /// Its data wait for the next SYNC.
    Waiting,
    /// It was too short and is ignored.
    TooShort,
}

/// A receive PDO.
#[derive(Clone, Debug)]
pub(crate) struct Rpdo {
    place: Place,
    parameters: Parameters,
    mapping: Mapping,
    waiting: Option<[u8; 8]>,
    deadline: Option<Duration>,
}

impl Rpdo {
    /// The RPDO as the dictionary configures it.
    pub(crate) fn new(dictionary: &ObjectDictionary, number: u16) -> Result<Self, AbortCode> {
        let place = Place {
            direction: Direction::Receive,
            number,
            is_mapping: false,
        };
        let (parameters, mapping) = read(dictionary, place)?;
        Ok(Self {
            place,
            parameters,
            mapping,
            waiting: None,
            deadline: None,
        })
    }

    /// Reads the configuration again after a write; an invalid one leaves the PDO without effect.
    pub(crate) fn configure(&mut self, dictionary: &ObjectDictionary) {
        match read(dictionary, self.place) {
            Ok((parameters, mapping)) => (self.parameters, self.mapping) = (parameters, mapping),
            Err(_) => self.parameters.cob_id = None,
        }
        self.stop();
    }

    /// Number, from 1.
    pub(crate) fn number(&self) -> u16 {
        self.place.number
    }

    /// True when frames with this identifier are for this PDO.
    #[inline]
    pub(crate) fn listens_to(&self, id: u16) -> bool {
        self.parameters.cob_id == Some(id) && self.mapping.length > 0
    }

    /// True when nothing happens before a SYNC, whatever arrives: neither its data nor the end of a dead-line.
    pub(crate) fn is_silent(&self) -> bool {
        self.is_synchronous() && !self.is_timed()
    }

    /// True when it may have a deadline.
    pub(crate) fn is_timed(&self) -> bool {
        self.parameters.event_timer.is_some()
    }

    /// Forgets what was received (Operational left, or new configuration).
    pub(crate) fn stop(&mut self) {
        self.waiting = None;
        self.deadline = None;
    }

    /// True when what arrives now must wait for a SYNC.
    #[inline]
    pub(crate) fn is_synchronous(&self) -> bool {
        self.parameters.is_synchronous()
    }

    /// True when a payload is longer than the mapping.
    #[inline]
    pub(crate) fn is_exceeded_by(&self, frame: &CanFrame) -> bool {
        frame.data().len() > self.mapping.length()
    }

    /// Takes the payload of a frame; the dead-line (sub-index 5) runs from here.
    pub(crate) fn on_frame(
        &mut self,
        now: Duration,
        dictionary: &mut ObjectDictionary,
        frame: &CanFrame,
    ) -> Received {
        if frame.data().len() < self.mapping.length() {
            return Received::TooShort;
        }
        self.deadline = self.parameters.event_timer.map(|timer| now + timer);
        if !self.is_synchronous() {
            self.mapping.unpack(dictionary, &frame.buffer());
            return Received::Stored;
        }
        self.waiting = Some(frame.buffer());
        Received::Waiting
    }

    /// What waits for the next SYNC.
    pub(crate) fn waiting(&self) -> Option<WaitingPdo> {
        self.waiting.map(|data| WaitingPdo {
            number: self.place.number,
            mapping: self.mapping,
            data,
        })
    }

    /// Puts what waited into the dictionary; false when nothing did.
    #[inline]
    pub(crate) fn on_sync(&mut self, dictionary: &mut ObjectDictionary) -> bool {
        let waiting = self.waiting.take();
        if let Some(data) = &waiting {
            self.mapping.unpack(dictionary, data);
        }
        waiting.is_some()
    }

    /// True once when the dead-line has passed.
    #[inline]
    pub(crate) fn has_timed_out(&mut self, now: Duration) -> bool {
        let has_timed_out = self.deadline.is_some_and(|deadline| now >= deadline);
        if has_timed_out {
            self.deadline = None;
        }
        has_timed_out
    }

    /// When the dead-line passes.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        self.deadline
    }
}

/// A transmit PDO.
#[derive(Clone, Debug)]
pub(crate) struct Tpdo {
    place: Place,
    parameters: Parameters,
    mapping: Mapping,
    is_started: bool,
    /// SYNCs until the next transmission; `None` until the SYNC with the start value.
    countdown: Option<u8>,
    is_requested: bool,
    /// What was sampled at the last SYNC, for remote frames.
    sampled: Option<[u8; 8]>,
    next_allowed: Duration,
    event_deadline: Option<Duration>,
}

impl Tpdo {
    /// The TPDO as the dictionary configures it.
    pub(crate) fn new(dictionary: &ObjectDictionary, number: u16) -> Result<Self, AbortCode> {
        let place = Place {
            direction: Direction::Transmit,
            number,
            is_mapping: false,
        };
        let (parameters, mapping) = read(dictionary, place)?;
        Ok(Self {
            place,
            parameters,
            mapping,
            is_started: false,
            countdown: None,
            is_requested: false,
            sampled: None,
            next_allowed: Duration::ZERO,
            event_deadline: None,
        })
    }

    /// Reads the configuration again after a write; an invalid one leaves the PDO without effect.
    pub(crate) fn configure(&mut self, now: Duration, dictionary: &ObjectDictionary) {
        match read(dictionary, self.place) {
            Ok((parameters, mapping)) => (self.parameters, self.mapping) = (parameters, mapping),
            Err(_) => self.parameters.cob_id = None,
        }
        if self.is_started {
            self.start(now);
        }
    }

    /// Number, from 1.
    pub(crate) fn number(&self) -> u16 {
        self.place.number
    }

    /// Begins (Operational entered, or new configuration): counts SYNCs anew; an event-driven PDO is sent at once.
    pub(crate) fn start(&mut self, now: Duration) {
        let waits_for_start = self.parameters.sync_start != 0;
        self.is_started = true;
        self.countdown = (!waits_for_start).then_some(self.parameters.transmission_type);
        self.is_requested = self.is_event_driven();
        self.sampled = None;
        self.event_deadline = self.parameters.event_timer.map(|timer| now + timer);
    }

    /// Ends (Operational left).
    pub(crate) fn stop(&mut self) {
        self.is_started = false;
        self.is_requested = false;
        self.event_deadline = None;
    }

    /// Asks for transmission: at once for types 254 and 255 (after the inhibit time), at the next SYNC for type 0.
    pub(crate) fn request(&mut self) {
        self.is_requested = self.is_started;
    }

    /// The frame to send at this SYNC.
    #[inline]
    pub(crate) fn on_sync(
        &mut self,
        sync: &Sync,
        dictionary: &ObjectDictionary,
    ) -> Option<CanFrame> {
        if !self.is_active() {
            return None;
        }
        let is_due = match self.parameters.transmission_type {
            0 => std::mem::take(&mut self.is_requested),
            period @ 1..=240 => self.count(period, sync),
            252 => false,
            _ => return None,
        };
        if is_due || self.parameters.allows_remote_frames {
            self.sampled = Some(self.mapping.pack(dictionary));
        }
        self.sampled
            .filter(|_| is_due)
            .and_then(|data| self.frame(&data))
    }

    /// The frame to send at `now` because of an event or the event timer.
    #[inline]
    pub(crate) fn on_tick(
        &mut self,
        now: Duration,
        dictionary: &ObjectDictionary,
    ) -> Option<CanFrame> {
        if !self.is_active() || !self.is_event_driven() || now < self.next_allowed {
            return None;
        }
        let elapsed = self.event_deadline.filter(|deadline| now >= *deadline);
        if !self.is_requested && elapsed.is_none() {
            return None;
        }
        self.is_requested = false;
        self.next_allowed = now + self.parameters.inhibit_time;
        self.event_deadline = self.parameters.event_timer.map(|timer| {
            let from_deadline = elapsed.map(|deadline| deadline + timer);
            from_deadline
                .filter(|next| *next > now)
                .unwrap_or(now + timer)
        });
        self.frame(&self.mapping.pack(dictionary))
    }

    /// The answer to a remote frame with this identifier.
    pub(crate) fn on_remote_frame(
        &mut self,
        id: u16,
        dictionary: &ObjectDictionary,
    ) -> Option<CanFrame> {
        let is_asked = self.parameters.cob_id == Some(id) && self.parameters.allows_remote_frames;
        if !is_asked || !self.is_active() {
            return None;
        }
        let is_sampled_at_sync =
            self.parameters.is_synchronous() || self.parameters.transmission_type == 252;
        let data = if is_sampled_at_sync {
            self.sampled?
        } else {
            self.mapping.pack(dictionary)
        };
        self.frame(&data)
    }

    /// When an event-driven transmission is due.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        if !self.is_active() || !self.is_event_driven() {
            return None;
        }
        let requested = self.is_requested.then_some(self.next_allowed);
        let elapsed = self.event_deadline.map(|due| due.max(self.next_allowed));
        earlier(requested, elapsed)
    }

    fn is_active(&self) -> bool {
        self.is_started && self.parameters.cob_id.is_some() && self.mapping.length > 0
    }

    /// True when it goes by events or by time, so that it may have a deadline.
    pub(crate) fn is_event_driven(&self) -> bool {
        self.parameters.transmission_type >= 254
    }

    fn frame(&self, data: &[u8; 8]) -> Option<CanFrame> {
        let cob_id = self.parameters.cob_id?;
        CanFrame::from_raw(u32::from(cob_id), self.mapping.length, *data)
    }

    /// Counts SYNCs and says whether this is the period's last. A lost SYNC counts by the counter, so that the phase
    /// stays. The SYNC with the start value is a transmission itself (CiA 301, 7.5.2.37).
    fn count(&mut self, period: u8, sync: &Sync) -> bool {
        let remaining = match (self.countdown, sync.counter) {
            (Some(remaining), _) => remaining,
            (None, Some(counter)) if counter != self.parameters.sync_start => return false,
            (None, Some(_)) => 0,
            (None, None) => period,
        };
        let overshoot = sync.elapsed.saturating_sub(remaining);
        let is_due = remaining <= sync.elapsed;
        self.countdown = Some(if remaining == 0 {
            period
        } else if is_due {
            period - overshoot % period
        } else {
            remaining - sync.elapsed
        });
        is_due
    }
}
