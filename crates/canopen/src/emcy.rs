//! Emergencies (CiA 301, 7.2.7): the error register 0x1001, the history 0x1003, the message by 0x1014 and 0x1015, and the error
//! code 0x603F of CiA 402.
//!
//! An error is a condition: it is raised once and stays active; "no error" reports its end, with the register of the remaining
//! errors. While the node is Stopped, messages wait.

use std::collections::VecDeque;
use std::time::Duration;

use crate::cob_id::{self, CobId};
use crate::object_dictionary::{AbortCode, Accepted, ObjectDictionary};
use can::CanFrame;

/// Default COB-ID of emergencies, without the node-ID.
pub const DEFAULT_ID: u16 = 0x080;

const ERROR_REGISTER: u16 = 0x1001;
const HISTORY: u16 = 0x1003;
const COB_ID: u16 = 0x1014;
const INHIBIT_TIME: u16 = 0x1015;
const DRIVE_ERROR_CODE: u16 = 0x603F;

/// Largest number of messages that wait for the bus; a further one drops the oldest.
const QUEUE_LENGTH: usize = 16;
/// Largest number of active conditions; further ones are not reported.
const ACTIVE_MAX: usize = 64;

/// An emergency error code (CiA 301, table 26).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorCode(pub u16);

impl ErrorCode {
    /// Error reset or no error.
    pub const NO_ERROR: Self = Self(0x0000);
    /// Generic error.
    pub const GENERIC: Self = Self(0x1000);
    /// Load level fault: I²t, thermal state.
    pub const THERMAL_OVERLOAD: Self = Self(0x2350);
    /// The device's own hardware.
    pub const HARDWARE: Self = Self(0x5000);
    /// A sensor of the device.
    pub const SENSOR: Self = Self(0x7300);
    /// Communication: no SYNC within its time.
    pub const COMMUNICATION: Self = Self(0x8100);
    /// CAN overrun: objects lost.
    pub const CAN_OVERRUN: Self = Self(0x8110);
    /// CAN in error passive mode.
    pub const ERROR_PASSIVE: Self = Self(0x8120);
    /// Heartbeat error.
    pub const HEARTBEAT: Self = Self(0x8130);
    /// Recovered from bus-off.
    pub const RECOVERED_FROM_BUS_OFF: Self = Self(0x8140);
    /// PDO not processed because of its length.
    pub const PDO_TOO_SHORT: Self = Self(0x8210);
    /// PDO length exceeded.
    pub const PDO_TOO_LONG: Self = Self(0x8220);
    /// Unexpected SYNC data length.
    pub const SYNC_LENGTH: Self = Self(0x8240);
    /// The position is further from its demand than the window (0x6065) for too long.
    pub const FOLLOWING_ERROR: Self = Self(0x8611);
    /// RPDO time-out.
    pub const RPDO_TIMEOUT: Self = Self(0x8250);

    /// Returns the bits in the error register 0x1001 (CiA 301, table 46); bit 0 is set with any error.
    pub fn register_bits(self) -> u8 {
        const GENERIC: u8 = 1;
        GENERIC
            | match self.0 >> 12 {
                0x0 => return if self.0 == 0 { 0 } else { GENERIC },
                0x2 => 1 << 1,
                0x3 => 1 << 2,
                0x4 => 1 << 3,
                0x8 if matches!(self.0 >> 8, 0x81 | 0x82) => 1 << 4,
                0x7 | 0x8 => 1 << 5,
                0xF => 1 << 7,
                _ => 0,
            }
    }
}

/// Content of an EMCY frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmergencyMessage {
    /// Code of the error; [`ErrorCode::NO_ERROR`] when an error has ended.
    pub code: ErrorCode,
    /// Error register 0x1001.
    pub register: u8,
    /// Five manufacturer bytes. In messages of this crate they begin with the number of the RPDO or node concerned
    /// (little-endian); with "no error" the code of the error that has ended comes before that number.
    pub manufacturer: [u8; 5],
}

impl EmergencyMessage {
    /// Encodes the eight bytes, little-endian (CiA 301, figure 44).
    pub fn encode(&self) -> [u8; 8] {
        let [low, high] = self.code.0.to_le_bytes();
        let [a, b, c, d, e] = self.manufacturer;
        [low, high, self.register, a, b, c, d, e]
    }

    /// Decodes the message in a payload; `None` if it has not eight bytes.
    pub fn decode(data: &[u8]) -> Option<Self> {
        let [low, high, register, a, b, c, d, e] = *data else {
            return None;
        };
        Some(Self {
            code: ErrorCode(u16::from_le_bytes([low, high])),
            register,
            manufacturer: [a, b, c, d, e],
        })
    }
}

/// Condition that lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Condition {
    pub(crate) code: ErrorCode,
    /// RPDO or node, which separates several conditions with the same code.
    pub(crate) source: u16,
}

/// EMCY producer of a node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Emcy {
    active: Vec<Condition>,
    queue: VecDeque<[u8; 8]>,
    cob_id: Option<u16>,
    inhibit_time: Duration,
    next_allowed: Duration,
}

impl Emcy {
    /// Makes a producer that is not configured yet.
    pub(crate) fn new() -> Self {
        Self {
            active: Vec::with_capacity(ACTIVE_MAX),
            queue: VecDeque::with_capacity(QUEUE_LENGTH),
            ..Self::default()
        }
    }

    /// Forgets all conditions and messages and reads the configuration.
    pub(crate) fn reset(&mut self, dictionary: &ObjectDictionary) {
        self.active.clear();
        self.queue.clear();
        self.next_allowed = Duration::ZERO;
        self.configure(dictionary);
    }

    /// Reads 0x1014 and 0x1015.
    pub(crate) fn configure(&mut self, dictionary: &ObjectDictionary) {
        let cob_id = dictionary.unsigned(COB_ID, 0).map(CobId);
        self.cob_id = cob_id.filter(|id| id.is_valid()).map(CobId::id);
        let inhibit_time = dictionary.unsigned(INHIBIT_TIME, 0).unwrap_or(0);
        self.inhibit_time = Duration::from_micros(u64::from(inhibit_time) * 100);
    }

    /// Checks the rules for writing 0x1003, and 0x1014 (CiA 301, 7.5.2.17): bit 30 is reserved.
    pub(crate) fn check_write(dictionary: &ObjectDictionary, index: u16, bytes: &[u8]) -> Accepted {
        match index {
            HISTORY if bytes.iter().any(|byte| *byte != 0) => Err(AbortCode::INVALID_VALUE),
            COB_ID if CobId::from_bytes(bytes)?.flag_30() => Err(AbortCode::INVALID_VALUE),
            COB_ID => cob_id::check_write(dictionary, (COB_ID, 0), bytes, AbortCode::DEVICE_STATE),
            _ => Ok(()),
        }
    }

    /// Applies a write to 0x1003, 0x1014 or 0x1015.
    pub(crate) fn on_write(&mut self, dictionary: &mut ObjectDictionary, index: u16) {
        match index {
            HISTORY => clear_history(dictionary),
            COB_ID | INHIBIT_TIME => self.configure(dictionary),
            _ => {}
        }
    }

    /// Raises a condition unless it is active.
    pub(crate) fn raise(
        &mut self,
        dictionary: &mut ObjectDictionary,
        condition: Condition,
        manufacturer: [u8; 5],
    ) {
        if self.is_active(condition) || self.active.len() >= ACTIVE_MAX {
            return;
        }
        self.active.push(condition);
        let code = condition.code;
        record(dictionary, code, manufacturer);
        self.announce(dictionary, code, manufacturer);
    }

    /// Ends a condition, if it is active.
    #[inline]
    pub(crate) fn clear(&mut self, dictionary: &mut ObjectDictionary, condition: Condition) {
        let mut active = self.active.iter();
        let Some(place) = active.position(|active| *active == condition) else {
            return;
        };
        self.active.swap_remove(place);
        let Condition { code, source } = condition;
        let [low, high] = code.0.to_le_bytes();
        let [source_low, source_high] = source.to_le_bytes();
        let manufacturer = [low, high, source_low, source_high, 0];
        self.announce(dictionary, ErrorCode::NO_ERROR, manufacturer);
    }

    /// Checks whether a condition is active.
    #[inline]
    pub(crate) fn is_active(&self, condition: Condition) -> bool {
        self.active.contains(&condition)
    }

    /// Returns the next message, once the inhibit time has passed.
    #[inline]
    pub(crate) fn next_frame(&mut self, now: Duration) -> Option<CanFrame> {
        let cob_id = self.cob_id?;
        if now < self.next_allowed {
            return None;
        }
        let bytes = self.queue.pop_front()?;
        self.next_allowed = now + self.inhibit_time;
        Some(CanFrame::new(cob_id, &bytes))
    }

    /// Returns the time at which the next message may go.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        let is_waiting = self.cob_id.is_some() && !self.queue.is_empty();
        is_waiting.then_some(self.next_allowed)
    }

    /// Updates 0x1001 and queues the message.
    fn announce(
        &mut self,
        dictionary: &mut ObjectDictionary,
        code: ErrorCode,
        manufacturer: [u8; 5],
    ) {
        let active = self.active.iter();
        let bits = active.map(|condition| condition.code.register_bits());
        let register = bits.fold(0, |all, bits| all | bits);
        set(dictionary, ERROR_REGISTER, 0, u32::from(register));
        if self.queue.len() >= QUEUE_LENGTH {
            self.queue.pop_front();
        }
        let message = EmergencyMessage {
            code,
            register,
            manufacturer,
        };
        self.queue.push_back(message.encode());
    }
}

/// Stores a value if the object exists: all of EMCY's objects but 0x1001 are optional.
fn set(dictionary: &mut ObjectDictionary, index: u16, sub_index: u8, value: u32) {
    dictionary
        .set_integer(index, sub_index, i128::from(value))
        .ok();
}

/// Puts the newest error at 0x1003:01 (CiA 301, 7.5.2.4) and into 0x603F.
fn record(dictionary: &mut ObjectDictionary, code: ErrorCode, manufacturer: [u8; 5]) {
    set(dictionary, DRIVE_ERROR_CODE, 0, u32::from(code.0));
    let depth = history_depth(dictionary);
    for sub_index in (2..=depth).rev() {
        let older = dictionary.unsigned(HISTORY, sub_index - 1).unwrap_or(0);
        set(dictionary, HISTORY, sub_index, older);
    }
    let [low, high] = code.0.to_le_bytes();
    let newest = u32::from_le_bytes([low, high, manufacturer[0], manufacturer[1]]);
    set(dictionary, HISTORY, 1, newest);
    let count = dictionary.unsigned(HISTORY, 0).unwrap_or(0);
    set(dictionary, HISTORY, 0, (count + 1).min(u32::from(depth)));
}

/// Returns the number of errors that 0x1003 can hold.
fn history_depth(dictionary: &ObjectDictionary) -> u8 {
    let has_room = |sub_index: &u8| dictionary.find(HISTORY, *sub_index).is_ok();
    (1..=254).take_while(has_room).last().unwrap_or(0)
}

/// Forgets the history, as a write of 0 to 0x1003:00 demands.
fn clear_history(dictionary: &mut ObjectDictionary) {
    for sub_index in 0..=history_depth(dictionary) {
        set(dictionary, HISTORY, sub_index, 0);
    }
}

/// Refuses reading an entry of 0x1003 that holds no error (CiA 301, 7.5.2.4).
pub(crate) fn check_read(dictionary: &ObjectDictionary, index: u16, sub_index: u8) -> Accepted {
    let count = dictionary.unsigned(HISTORY, 0).unwrap_or(0);
    if index == HISTORY && u32::from(sub_index) > count {
        return Err(AbortCode::NO_DATA);
    }
    Ok(())
}
