//! The length of a frame on the wire, stuff bits included, and the order of arbitration between two frames (ISO 11898-1, 10.4 to
//! 10.8).

use crate::frame::CanFrame;

/// Recessive bits between two frames (intermission).
pub const INTERFRAME_BITS: u32 = 3;

/// Start of frame, identifier, remote request, two reserved bits, length.
const HEADER_BITS: u32 = 1 + 11 + 1 + 2 + 4;

/// Checksum, stuffed like the bits before it.
const CRC_BITS: u32 = 15;

/// CRC delimiter, acknowledge slot and delimiter, end of frame: never stuffed.
const UNSTUFFED_TAIL_BITS: u32 = 1 + 2 + 7;

/// Returns the bits of a frame on the wire from start to end of frame, with the stuff bits that its payload causes.
pub fn frame_bits(frame: &CanFrame) -> u32 {
    // Header, data and checksum. The data begin with a whole byte, so fill bits come before the start of frame, and one after the
    // checksum.
    let mut bytes = [0; BYTES_MAX];
    let (header_bytes, header_bits) = put_header(frame, &mut bytes);
    let data_bytes = if frame.is_remote() {
        0
    } else {
        frame.data().len()
    };
    bytes[header_bytes..][..8].copy_from_slice(&frame.buffer());
    let end = header_bytes + data_bytes;
    let checksum = crc(&bytes[..end]);
    // Fill bits that alternate and end unlike the start of frame cause no stuff bits, nor does one unlike the checksum's last
    // bit.
    bytes[0] |= 0b0101_0101 << (header_bits % 8);
    bytes[end..][..2].copy_from_slice(&(checksum << 1 | !checksum & 1).to_be_bytes());
    let stuffed_bits = stuffed_bits(&bytes[..end + 2]);
    let data_bits = 8 * u32::try_from(data_bytes).unwrap_or(8);
    header_bits + data_bits + CRC_BITS + stuffed_bits + UNSTUFFED_TAIL_BITS
}

/// Returns the bits that a frame takes from the bus: its own and the pause after it.
pub fn occupied_bits(frame: &CanFrame) -> u32 {
    // A driver's message about the bus is no frame of it.
    if frame.is_error() {
        return 0;
    }
    frame_bits(frame) + INTERFRAME_BITS
}

/// Returns the largest number of bits that a data frame with an identifier of 11 bits takes from the bus, whatever its payload: a
/// stuff bit after every fourth bit from the start of frame to the checksum.
pub fn occupied_bits_max(length_bytes: u8) -> u32 {
    let data_bits = 8 * u32::from(length_bytes);
    let stuffed = HEADER_BITS + data_bits + CRC_BITS;
    stuffed + (stuffed - 1) / 4 + UNSTUFFED_TAIL_BITS + INTERFRAME_BITS
}

/// Size of the buffer for a frame's bits: five bytes of header, eight of data, two of checksum, and one more, so that eight bytes
/// can always be copied.
const BYTES_MAX: usize = 16;

/// Writes the bits from the start of frame to the length; returns the number of bytes to their end, and the number of bits.
fn put_header(frame: &CanFrame, bytes: &mut [u8; BYTES_MAX]) -> (usize, u32) {
    let id = u64::from(frame.raw_id());
    // Remote frame or not, two reserved bits, and the length, behind the start of frame and the identifier.
    let control = u64::from(frame.is_remote()) << 6 | frame.data().len() as u64;
    let (header, header_bytes, header_bits) = if frame.is_extended() {
        let identifier = (id >> 18 & 0x7FF) << 20 | 0b11 << 18 | id & 0x3_FFFF;
        ((identifier << 7 | control) << 24, 5, 1 + 11 + 2 + 18 + 7)
    } else {
        (((id & 0x7FF) << 7 | control) << 40, 3, 1 + 11 + 7)
    };
    bytes[..8].copy_from_slice(&header.to_be_bytes());
    (header_bytes, header_bits)
}

/// Computes the CRC of ISO 11898-1, 10.4.2.6. It is linear: the sum of the contributions of each byte at its place, counted from
/// the end. Zeros in front add nothing.
fn crc(bytes: &[u8]) -> u16 {
    const TABLE: [[u16; 256]; BYTES_MAX] = crc_table();
    let adds = bytes.iter().rev().zip(&TABLE);
    adds.fold(0, |crc, (byte, table)| crc ^ table[usize::from(*byte)])
}

/// Counts the stuff bits: after five equal bits comes one of the other kind, which counts for the next five.
fn stuffed_bits(bytes: &[u8]) -> u32 {
    const TABLE: [[i8; Stuffed::STATES as usize]; 256] = Stuffed::table();
    let stuffed = bytes.iter().fold(0, |stuffed: u32, byte| {
        let state = stuffed % Stuffed::ONE;
        let change = TABLE[usize::from(*byte)][state as usize];
        stuffed.wrapping_add_signed(i32::from(change))
    });
    stuffed / Stuffed::ONE
}

/// Number of stuff bits, and the state on which the next ones depend: twice the number of equal bits so far, plus their kind.
/// There may be no bit yet, or one to four equal bits of either kind.
#[derive(Clone, Copy)]
struct Stuffed {
    bits: u8,
    state: u8,
}

impl Stuffed {
    /// Number of states in the table, of which ten are in use.
    const STATES: u8 = 16;
    const STATES_IN_USE: u8 = 10;
    /// One stuff bit in a number that holds both fields.
    const ONE: u32 = Self::STATES as u32;

    const fn after(state: u8, bit: u8) -> Self {
        let (run, kind) = (state / 2, state % 2);
        let run = if run > 0 && bit == kind { run + 1 } else { 1 };
        if run == 5 {
            Self {
                bits: 1,
                state: 2 + (1 - bit),
            }
        } else {
            Self {
                bits: 0,
                state: 2 * run + bit,
            }
        }
    }

    /// Returns the change by each byte in each state, both fields in one number.
    const fn table() -> [[i8; Self::STATES as usize]; 256] {
        let mut table = [[0; Self::STATES as usize]; 256];
        let mut state: u8 = 0;
        while state < Self::STATES_IN_USE {
            let mut byte: u16 = 0;
            while byte < 256 {
                let mut stuffed = Self { bits: 0, state };
                let mut place = 8;
                while place > 0 {
                    place -= 1;
                    let is_set = byte >> place & 1 == 1;
                    let next = Self::after(stuffed.state, is_set as u8);
                    stuffed.bits += next.bits;
                    stuffed.state = next.state;
                }
                let after = (stuffed.bits * Self::STATES + stuffed.state) as i8;
                table[byte as usize][state as usize] = after - state as i8;
                byte += 1;
            }
            state += 1;
        }
        table
    }
}

/// Returns the contribution of each byte to the CRC with the polynomial 0x4599, by the number of bytes behind it.
const fn crc_table() -> [[u16; 256]; 16] {
    let mut table = [[0; 256]; 16];
    let mut byte: u16 = 0;
    while byte < 256 {
        let mut crc = byte << 7;
        let mut behind = 0;
        while behind < 16 {
            let mut bit = 0;
            while bit < 8 {
                let feedback = crc & 0x4000 != 0;
                crc = (crc << 1) & 0x7FFF;
                if feedback {
                    crc ^= 0x4599;
                }
                bit += 1;
            }
            table[behind][byte as usize] = crc;
            behind += 1;
        }
        byte += 1;
    }
    table
}

/// Returns the bits that arbitration compares; the lowest value wins.
#[inline]
pub fn arbitration_key(frame: &CanFrame) -> u32 {
    let id = frame.raw_id();
    let remote = u32::from(frame.is_remote());
    if frame.is_extended() {
        ((id >> 18) & 0x7FF) << 21 | 0b11 << 19 | (id & 0x3_FFFF) << 1 | remote
    } else {
        (id & 0x7FF) << 21 | remote << 20
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{EXTENDED_FLAG, REMOTE_FLAG};

    /// Parses a frame in the notation of candump's log.
    fn parse(text: &str) -> CanFrame {
        let (id, data) = text.split_once('#').unwrap();
        let mut flags = if id.len() > 3 { EXTENDED_FLAG } else { 0 };
        let (data, is_remote) = data
            .strip_prefix('R')
            .map_or((data, false), |rest| (rest, true));
        flags |= if is_remote { REMOTE_FLAG } else { 0 };
        let mut bytes = [0; 8];
        for (place, byte) in bytes.iter_mut().enumerate().take(data.len() / 2) {
            *byte = u8::from_str_radix(&data[2 * place..][..2], 16).unwrap();
        }
        let length = u8::try_from(data.len() / 2).unwrap();
        let id = u32::from_str_radix(id, 16).unwrap();
        CanFrame::from_raw(id | flags, length, bytes).unwrap()
    }

    /// The lengths that can-utils computes, see the head of the file.
    #[test]
    fn no_payload_takes_more_than_the_most() {
        assert_eq!([0, 4, 8].map(occupied_bits_max), [55, 95, 135]);
        for length in 0..=8_u8 {
            for byte in [0x00, 0xFF, 0x1F, 0xF0, 0x87] {
                let data = [byte; 8];
                let frame = CanFrame::new(0x078, &data[..usize::from(length)]);
                assert!(occupied_bits(&frame) <= occupied_bits_max(length));
            }
        }
    }

    #[test]
    fn frames_are_as_long_as_can_utils_says() {
        let table = include_str!("../../../tests/data/frame_lengths.csv");
        let rows = table.lines().filter(|line| !line.starts_with('/'));
        let mut checked = 0;
        for row in rows {
            let (frame, bits) = row.split_once(',').unwrap();
            let bits: u32 = bits.parse().unwrap();
            assert_eq!(occupied_bits(&parse(frame)), bits, "{frame}");
            checked += 1;
        }
        assert_eq!(checked, 512);
    }

    #[test]
    fn an_empty_frame_without_stuffing_has_47_bits() {
        // 34 bits subject to stuffing + 10 unstuffed + 3 interframe = 47 (ISO 11898-1); 0x555 alternates.
        let bits = frame_bits(&CanFrame::new(0x555, &[]));
        assert!((44..=46).contains(&bits), "{bits}");
    }

    #[test]
    fn the_worst_case_never_exceeds_the_known_bound() {
        // 8n + 44 + floor((34 + 8n - 1) / 4) bits without interframe space.
        for byte in [0x00, 0xFF, 0x78, 0x0F] {
            let bits = frame_bits(&CanFrame::new(0x078, &[byte; 8]));
            assert!((108..=132).contains(&bits), "{byte:#x}: {bits}");
        }
    }

    #[test]
    fn zeros_are_stuffed_after_five() {
        // SOF, identifier, control and a zero CRC: 34 zeros, so a stuff bit after each five.
        assert_eq!(
            frame_bits(&CanFrame::new(0, &[])),
            34 + 6 + UNSTUFFED_TAIL_BITS
        );
    }

    #[test]
    fn the_lowest_identifier_wins_and_data_beats_remote() {
        let data = CanFrame::new(0x100, &[]);
        let remote = CanFrame::from_raw(0x100 | REMOTE_FLAG, 0, [0; 8]).unwrap();
        let extended = CanFrame::from_raw(0x100 << 18 | EXTENDED_FLAG, 0, [0; 8]).unwrap();
        assert!(arbitration_key(&data) < arbitration_key(&remote));
        assert!(arbitration_key(&remote) < arbitration_key(&extended));
        assert!(arbitration_key(&extended) < arbitration_key(&CanFrame::new(0x101, &[])));
    }
}
