//! The segments of an SDO block transfer (CiA 301, 7.2.4.3.9 to 7.2.4.3.17), the same in both directions.

use crate::object_dictionary::{AbortCode, Accepted};
use crate::sdo::{
    MAX_TRANSFER_BYTES, Payload, SEGMENT_BYTES, State, Step, Transfer, check_length, crc, segment,
    unused_bytes,
};

/// Segments per block that a receiver of this crate grants: the standard's maximum.
pub(crate) const BLOCK_SIZE: u8 = 127;

/// Largest number of acknowledgements in a row that confirm no segment; then the transfer is given up.
const MAX_FRUITLESS_ACKNOWLEDGEMENTS: u8 = 3;

/// Flag of the last segment.
const LAST: u8 = 0x80;

/// Checks that a block size is one of the standard, 1 to 127.
fn check_block_size(block_size: u8) -> Accepted {
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
    pub(crate) fn new(block_size: u8) -> Accepted<Self> {
        check_block_size(block_size)?;
        Ok(Self {
            confirmed: 0,
            sent: 0,
            block_size,
            fruitless: 0,
        })
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
}

/// Returns the end of a block transfer: its command with the unused bytes of the last segment, and the CRC.
fn end(data: &[u8], with_crc: bool) -> Payload {
    let last_length = match data.len() % SEGMENT_BYTES {
        0 if !data.is_empty() => SEGMENT_BYTES,
        length => length,
    };
    let crc = if with_crc { crc(data) } else { 0 };
    let [low, high] = crc.to_le_bytes();
    let command = 0xC1 | unused_bytes(last_length) << 2;
    [command, low, high, 0, 0, 0, 0, 0]
}

/// Handles the end of a block transfer: cuts the padding off the received data, and checks CRC and size.
pub(crate) fn check_end(transfer: &mut Transfer, end: &Payload) -> Accepted {
    let buffer = &mut transfer.buffer;
    let unused = usize::from(end[0] >> 2 & 0b111);
    buffer.truncate(buffer.len().saturating_sub(unused));
    if transfer.with_crc && crc(buffer) != u16::from_le_bytes([end[1], end[2]]) {
        return Err(AbortCode::CRC_ERROR);
    }
    // The receiver stores whole segments, so the padding may hide up to six bytes too many.
    if buffer.len() > MAX_TRANSFER_BYTES {
        return Err(AbortCode::OUT_OF_MEMORY);
    }
    check_length(buffer.len(), transfer.announced)
}

impl Transfer {
    /// Handles the receiver's acknowledgement of a block. If the receiver has everything, the end is sent.
    pub(crate) fn acknowledge_block(
        &mut self,
        payload: &Payload,
        mut sender: BlockSender,
    ) -> Accepted {
        let [_, sequence, block_size, ..] = *payload;
        if sequence > sender.sent {
            return Err(AbortCode::INVALID_SEQUENCE_NUMBER);
        }
        sender.confirmed += SEGMENT_BYTES * usize::from(sequence);
        sender.sent = 0;
        if sender.confirmed >= self.buffer.len().max(1) {
            self.outgoing = Some(end(&self.buffer, self.with_crc));
            self.state = State::BlockSent;
            return Ok(());
        }
        check_block_size(block_size)?;
        sender.block_size = block_size;
        sender.fruitless = if sequence == 0 {
            sender.fruitless + 1
        } else {
            0
        };
        if sender.fruitless > MAX_FRUITLESS_ACKNOWLEDGEMENTS {
            return Err(AbortCode::INVALID_SEQUENCE_NUMBER);
        }
        self.state = State::SendingBlock(sender);
        Ok(())
    }

    /// Accepts a segment of a block, the last one with its padding, after this number of stored ones, and acknowledges the block
    /// at its end. A segment out of sequence is dropped; the acknowledgement will ask for it again.
    pub(crate) fn receive_block_segment(
        &mut self,
        payload: &Payload,
        mut stored: u8,
    ) -> Accepted<Step> {
        let sequence = payload[0] & !LAST;
        let is_last = payload[0] & LAST != 0;
        if sequence == 0 || sequence > BLOCK_SIZE {
            return Err(AbortCode::INVALID_SEQUENCE_NUMBER);
        }
        let is_next = sequence == stored + 1;
        if is_next {
            if self.buffer.len() >= MAX_TRANSFER_BYTES {
                return Err(AbortCode::OUT_OF_MEMORY);
            }
            self.buffer.extend_from_slice(&payload[1..]);
            stored += 1;
        }
        let ends_block = is_last || sequence == BLOCK_SIZE;
        if ends_block {
            self.outgoing = Some([0xA2, stored, BLOCK_SIZE, 0, 0, 0, 0, 0]);
            stored = 0;
        }
        self.state = if is_next && is_last {
            State::BlockReceived
        } else {
            State::ReceivingBlock { stored }
        };
        let advances = is_next || ends_block;
        Ok(if advances { Step::Forward } else { Step::Stale })
    }
}
