//! Common parts of the SDO server and client (CiA 301, 7.2.4.3): layout of the 8 bytes, segments, CRC, limits.

use std::time::Duration;

use crate::object_dictionary::{AbortCode, Accepted};
use crate::sdo_block::BlockSender;
use can::CanFrame;

/// Longest value that is transferred; longer ones are aborted with [`AbortCode::OUT_OF_MEMORY`].
pub const MAX_TRANSFER_BYTES: usize = 64 << 10;

/// Time for which a server waits for its client, and a client for its server unless it is set otherwise.
pub const DEFAULT_TIMEOUT: Duration = Duration::from_secs(1);

/// COB-ID of requests on the default channel, without the node-ID.
pub const DEFAULT_REQUEST_ID: u16 = 0x600;

/// COB-ID of answers on the default channel, without the node-ID.
pub const DEFAULT_RESPONSE_ID: u16 = 0x580;

/// Data bytes of a segment.
pub(crate) const SEGMENT_BYTES: usize = 7;

/// Payload of every SDO frame.
pub(crate) type Payload = [u8; 8];

/// "Abort SDO transfer" of either side.
pub(crate) const ABORT: u8 = 0x80;

/// Object of a transfer (the standard's multiplexer).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Multiplexer {
    pub(crate) index: u16,
    pub(crate) sub_index: u8,
}

impl Multiplexer {
    /// Reads the multiplexer in bytes 1 to 3.
    pub(crate) fn from_payload(payload: &Payload) -> Self {
        Self {
            index: u16::from_le_bytes([payload[1], payload[2]]),
            sub_index: payload[3],
        }
    }

    /// Returns a payload of command, multiplexer and four bytes.
    pub(crate) fn payload(self, command: u8, data: [u8; 4]) -> Payload {
        let [low, high] = self.index.to_le_bytes();
        let [a, b, c, d] = data;
        [command, low, high, self.sub_index, a, b, c, d]
    }

    /// Returns a payload of command, multiplexer and a length in bytes, which [`MAX_TRANSFER_BYTES`] keeps small.
    pub(crate) fn payload_with_length(self, command: u8, length: usize) -> Payload {
        let length = u32::try_from(length).unwrap_or(u32::MAX);
        self.payload(command, length.to_le_bytes())
    }

    /// Returns the payload of "abort SDO transfer".
    pub(crate) fn abort(self, code: AbortCode) -> Payload {
        self.payload(ABORT, code.0.to_le_bytes())
    }
}

/// Effect of a frame on a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// It does not advance the transfer, so that its time-out runs on.
    Stale,
    Forward,
    Done,
}

/// State of a transfer: the frame for which client or server waits. The first word says which of them has the state.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum State {
    /// Both: no transfer.
    #[default]
    Idle,
    /// Client: it asked for a value.
    UploadRequested { is_block: bool },
    /// Client: it announced a value, or sent it. `is_expedited`: the answer ends the transfer.
    DownloadRequested { is_expedited: bool },
    /// Client: it announced a value, to send it in blocks.
    BlockDownloadRequested,
    /// Both: the next segment to receive has this toggle bit.
    Receiving { toggle: bool },
    /// Both: the next segment to send begins at `position`. The request for it has this toggle bit, or the confirmation of the
    /// one before it.
    Sending { toggle: bool, position: usize },
    /// Both: the next segment of a block.
    ReceivingBlock {
        /// Number of segments of the block that were stored.
        stored: u8,
    },
    /// Both: the sender's end of the transfer.
    BlockReceived,
    /// Server: the client's start.
    BlockPrepared(BlockSender),
    /// Both: the acknowledgement of a block.
    SendingBlock(BlockSender),
    /// Both: the confirmation of the end.
    BlockSent,
}

/// Transfer under way, as client and server keep it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Transfer {
    pub(crate) state: State,
    pub(crate) object: Multiplexer,
    /// Length that the sender of the value has announced.
    pub(crate) announced: Option<usize>,
    /// Whether a block transfer ends with a CRC.
    pub(crate) with_crc: bool,
    /// The value, as far as it is known.
    pub(crate) buffer: Vec<u8>,
    /// Payload to send next.
    pub(crate) outgoing: Option<Payload>,
    pub(crate) deadline: Option<Duration>,
}

impl Transfer {
    /// Checks whether it is under way.
    pub(crate) fn is_busy(&self) -> bool {
        !matches!(self.state, State::Idle)
    }

    /// Ends it.
    pub(crate) fn close(&mut self) {
        self.state = State::Idle;
        self.deadline = None;
    }

    /// Checks whether a frame aborts it. A segment of a block may have the same command specifier.
    pub(crate) fn is_abort(&self, payload: &Payload) -> bool {
        let is_receiving_block = matches!(self.state, State::ReceivingBlock { .. });
        payload[0] >> 5 == 4 && (payload[0] == ABORT || !is_receiving_block)
    }

    /// Returns the next payload to send.
    pub(crate) fn next_payload(&mut self) -> Option<Payload> {
        let waiting = self.outgoing.take();
        waiting.or_else(|| match &mut self.state {
            State::SendingBlock(sender) => sender.next_segment(&self.buffer),
            _ => None,
        })
    }

    /// Checks whether the other side has been silent for too long.
    pub(crate) fn is_overdue(&self, now: Duration) -> bool {
        self.deadline.is_some_and(|deadline| now >= deadline)
    }

    /// Sends the segment at a position; returns whether it is the last.
    pub(crate) fn send_segment(&mut self, toggle: bool, position: usize) -> bool {
        let (payload, is_last) = segment(&self.buffer, position, toggle);
        self.outgoing = Some(payload);
        is_last
    }

    /// Takes a segment; returns whether it is the last.
    ///
    /// # Errors
    /// Another toggle bit, more or less than announced, or more than [`MAX_TRANSFER_BYTES`].
    pub(crate) fn receive_segment(&mut self, payload: &Payload, toggle: bool) -> Accepted<bool> {
        check_toggle(payload, toggle)?;
        let length = SEGMENT_BYTES - usize::from(payload[0] >> 1 & 0b111);
        let total = self.buffer.len() + length;
        if self.announced.is_some_and(|announced| total > announced) {
            return Err(AbortCode::TOO_LONG);
        }
        if total > MAX_TRANSFER_BYTES {
            return Err(AbortCode::OUT_OF_MEMORY);
        }
        self.buffer.extend_from_slice(&payload[1..=length]);
        let is_last = payload[0] & 1 != 0;
        if is_last {
            check_length(total, self.announced)?;
        }
        Ok(is_last)
    }
}

/// Checks the toggle bit of a segment, its request or its confirmation.
///
/// # Errors
/// [`AbortCode::TOGGLE_BIT_NOT_ALTERNATED`].
pub(crate) fn check_toggle(payload: &Payload, expected: bool) -> Accepted {
    if (payload[0] & 0x10 != 0) == expected {
        Ok(())
    } else {
        Err(AbortCode::TOGGLE_BIT_NOT_ALTERNATED)
    }
}

/// Returns the payload of an SDO frame with this identifier; `None` for other identifiers and lengths.
pub(crate) fn payload_with_id(frame: &CanFrame, id: u16) -> Option<Payload> {
    if frame.standard_id() != Some(id) {
        return None;
    }
    frame.data().try_into().ok()
}

/// Returns bytes 4 to 7.
pub(crate) fn data_bytes(payload: &Payload) -> [u8; 4] {
    [payload[4], payload[5], payload[6], payload[7]]
}

/// Returns the length that an initiating request or answer announces in bytes 4 to 7.
///
/// # Errors
/// More than [`MAX_TRANSFER_BYTES`].
pub(crate) fn announced_length(payload: &Payload, is_announced: bool) -> Accepted<Option<usize>> {
    let length = usize::try_from(u32::from_le_bytes(data_bytes(payload)));
    match length {
        _ if !is_announced => Ok(None),
        Ok(length) if length <= MAX_TRANSFER_BYTES => Ok(Some(length)),
        _ => Err(AbortCode::OUT_OF_MEMORY),
    }
}

/// Returns command and data of an expedited transfer; `None` for no bytes or more than four.
pub(crate) fn expedited(command: u8, bytes: &[u8]) -> Option<(u8, [u8; 4])> {
    let unused = match bytes.len() {
        1 => 3,
        2 => 2,
        3 => 1,
        4 => 0,
        _ => return None,
    };
    let mut data = [0; 4];
    data[..bytes.len()].copy_from_slice(bytes);
    Some((command | unused << 2 | 0b11, data))
}

/// Returns how many of the four bytes of an expedited command are used; `None` if the command does not tell.
pub fn expedited_length(command: u8) -> Option<usize> {
    (command & 1 != 0).then_some(4 - usize::from(command >> 2 & 0b11))
}

/// Returns the number that bytes hold, least significant first; `None` for no bytes or more than four.
pub fn little_endian_u32(bytes: &[u8]) -> Option<u32> {
    let mut buffer = [0; 4];
    buffer.get_mut(..bytes.len())?.copy_from_slice(bytes);
    (!bytes.is_empty()).then_some(u32::from_le_bytes(buffer))
}

/// Returns the segment of `data` that begins at `position`, and whether it is the last; the command specifier is 0 in both
/// directions.
pub(crate) fn segment(data: &[u8], position: usize, toggle: bool) -> (Payload, bool) {
    let rest = &data[position.min(data.len())..];
    let length = rest.len().min(SEGMENT_BYTES);
    let is_last = rest.len() <= SEGMENT_BYTES;
    let mut payload = [0; 8];
    payload[0] = u8::from(toggle) << 4 | unused_bytes(length) << 1 | u8::from(is_last);
    payload[1..=length].copy_from_slice(&rest[..length]);
    (payload, is_last)
}

/// Checks the length of a value against that which was announced, or which its type has; `None` if any will do.
///
/// # Errors
/// More or less.
pub(crate) fn check_length(length: usize, expected: Option<usize>) -> Accepted {
    match expected {
        Some(expected) if length > expected => Err(AbortCode::TOO_LONG),
        Some(expected) if length < expected => Err(AbortCode::TOO_SHORT),
        _ => Ok(()),
    }
}

/// Returns how many of a segment's seven bytes `length` leaves unused.
pub(crate) fn unused_bytes(length: usize) -> u8 {
    u8::try_from(SEGMENT_BYTES.saturating_sub(length)).unwrap_or(0)
}

/// Computes the CRC-16 with polynomial x^16 + x^12 + x^5 + 1 and start value 0 (CiA 301, 7.2.4.3.16).
pub(crate) fn crc(bytes: &[u8]) -> u16 {
    let with_bit = |crc: u16, _| match crc & 0x8000 {
        0 => crc << 1,
        _ => crc << 1 ^ 0x1021,
    };
    let with_byte = |crc: u16, byte: &u8| (0..8).fold(crc ^ u16::from(*byte) << 8, with_bit);
    bytes.iter().fold(0, with_byte)
}

/// Returns the bytes of hexadecimal digits.
#[cfg(test)]
pub(crate) fn bytes(digits: &str) -> Vec<u8> {
    (0..digits.len())
        .step_by(2)
        .map(|place| u8::from_str_radix(&digits[place..place + 2], 16).unwrap())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_of_the_check_string_is_the_standards() {
        assert_eq!(crc(b"123456789"), 0x31C3);
        assert_eq!(crc(b""), 0);
    }

    #[test]
    fn segments_carry_toggle_unused_and_last() {
        assert_eq!(segment(b"abcdefgh", 0, false), (*b"\x00abcdefg", false));
        assert_eq!(segment(b"abcdefgh", 7, true), (*b"\x1Dh\0\0\0\0\0\0", true));
        assert_eq!(segment(b"abcdefg", 0, false), (*b"\x01abcdefg", true));
        assert_eq!(segment(b"", 0, false), ([0x0F, 0, 0, 0, 0, 0, 0, 0], true));
    }

    #[test]
    fn expedited_commands_have_their_length() {
        for length in 1..=4 {
            let (command, _) = expedited(0x40, &[1, 2, 3, 4][..length]).unwrap();
            assert_eq!(expedited_length(command), Some(length));
        }
        assert_eq!(expedited(0x40, &[]), None);
        assert_eq!(expedited(0x40, &[0; 5]), None);
        assert_eq!(expedited_length(0x42), None);
    }
}
