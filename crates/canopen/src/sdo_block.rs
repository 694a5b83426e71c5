//! The segments of an SDO block transfer (CiA 301, 7.2.4.3.9 to 7.2.4.3.17), the same in both directions.

use crate::object_dictionary::AbortCode;
use crate::sdo::{MAX_TRANSFER_BYTES, Payload, SEGMENT_BYTES, crc, segment, unused_bytes};

/// Segments per block that a receiver of this crate grants: the standard's maximum.
pub(crate) const BLOCK_SIZE: u8 = 127;

/// Largest number of acknowledgements in a row that confirm no segment; then the transfer is given up.
const MAX_FRUITLESS_ACKNOWLEDGEMENTS: u8 = 3;

/// Flag of the last segment.
const LAST: u8 = 0x80;

/// Checks that a block size is one of the standard, 1 to 127.
pub(crate) fn check_block_size(block_size: u8) -> Result<(), AbortCode> {
    if (1..=127).contains(&block_size) {
        Ok(())
    } else {
        Err(AbortCode::INVALID_BLOCK_SIZE)
    }
}

/// Sender of segments.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockSender {
    /// Number of bytes that the receiver has confirmed.
    confirmed: usize,
    /// Number of segments of this block that were sent.
    sent: u8,
    block_size: u8,
    fruitless: u8,
}

impl BlockSender {
    /// Makes a sender before its first block.
    pub(crate) fn new(block_size: u8) -> Self {
        Self {
            confirmed: 0,
            sent: 0,
            block_size,
            fruitless: 0,
        }
    }

    /// Returns the next segment of the block; `None` if an acknowledgement is due.
    pub(crate) fn next_segment(&mut self, data: &[u8]) -> Option<Payload> {
        let start = self.confirmed + SEGMENT_BYTES * usize::from(self.sent);
        // An empty value still takes one segment.
        if self.sent == self.block_size || start >= data.len().max(1) {
            return None;
        }
        self.sent += 1;
        let (mut payload, is_last) = segment(data, start, false);
        payload[0] = self.sent | if is_last { LAST } else { 0 };
        Some(payload)
    }

    /// Handles the receiver's acknowledgement of a block; true if the receiver has everything.
    pub(crate) fn acknowledge(
        &mut self,
        data: &[u8],
        sequence: u8,
        block_size: u8,
    ) -> Result<bool, AbortCode> {
        if sequence > self.sent {
            return Err(AbortCode::INVALID_SEQUENCE_NUMBER);
        }
        self.confirmed += SEGMENT_BYTES * usize::from(sequence);
        self.sent = 0;
        if self.confirmed >= data.len().max(1) {
            return Ok(true);
        }
        check_block_size(block_size)?;
        self.block_size = block_size;
        self.fruitless = if sequence == 0 { self.fruitless + 1 } else { 0 };
        if self.fruitless > MAX_FRUITLESS_ACKNOWLEDGEMENTS {
            return Err(AbortCode::INVALID_SEQUENCE_NUMBER);
        }
        Ok(false)
    }
}

/// Returns the end of a block transfer: `command` with the unused bytes of the last segment, and the CRC.
pub(crate) fn end(command: u8, data: &[u8], with_crc: bool) -> Payload {
    let last_length = match data.len() % SEGMENT_BYTES {
        0 if !data.is_empty() => SEGMENT_BYTES,
        length => length,
    };
    let crc = if with_crc { crc(data) } else { 0 };
    let [low, high] = crc.to_le_bytes();
    let command = command | unused_bytes(last_length) << 2;
    [command, low, high, 0, 0, 0, 0, 0]
}

/// Cuts the padding off received data and checks CRC and size.
pub(crate) fn check_end(
    end: &Payload,
    buffer: &mut Vec<u8>,
    with_crc: bool,
) -> Result<(), AbortCode> {
    let unused = usize::from(end[0] >> 2 & 0b111);
    buffer.truncate(buffer.len().saturating_sub(unused));
    if with_crc && crc(buffer) != u16::from_le_bytes([end[1], end[2]]) {
        return Err(AbortCode::CRC_ERROR);
    }
    // The receiver stores whole segments, so the padding may hide up to six bytes too many.
    if buffer.len() > MAX_TRANSFER_BYTES {
        return Err(AbortCode::OUT_OF_MEMORY);
    }
    Ok(())
}

/// Result of a received segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Received {
    /// It is out of sequence; the acknowledgement will ask for it again.
    Dropped,
    /// It was stored.
    Stored,
    /// It ends the block: acknowledge up to this sequence number.
    BlockEnded(u8),
}

/// Receiver of segments.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BlockReceiver {
    /// Number of segments of this block that were stored.
    stored: u8,
    is_complete: bool,
}

impl BlockReceiver {
    /// Checks whether the last segment was stored.
    pub(crate) fn is_complete(&self) -> bool {
        self.is_complete
    }

    /// Accepts a segment; the last one is stored with its padding.
    pub(crate) fn accept(
        &mut self,
        payload: &Payload,
        buffer: &mut Vec<u8>,
    ) -> Result<Received, AbortCode> {
        let sequence = payload[0] & !LAST;
        let is_last = payload[0] & LAST != 0;
        if sequence == 0 || sequence > BLOCK_SIZE {
            return Err(AbortCode::INVALID_SEQUENCE_NUMBER);
        }
        let is_next = sequence == self.stored + 1;
        if is_next {
            if buffer.len() >= MAX_TRANSFER_BYTES {
                return Err(AbortCode::OUT_OF_MEMORY);
            }
            buffer.extend_from_slice(&payload[1..]);
            self.stored += 1;
            self.is_complete = is_last;
        }
        if is_last || sequence == BLOCK_SIZE {
            return Ok(Received::BlockEnded(std::mem::take(&mut self.stored)));
        }
        Ok(if is_next {
            Received::Stored
        } else {
            Received::Dropped
        })
    }
}
