//! A CAN bus in virtual time: how long a frame takes and who may send next (ISO 11898-1, 10.4 to 10.8).

use std::time::Duration;

use canopen::CanFrame;

/// Recessive bits between two frames (intermission).
const INTERFRAME_BITS: u32 = 3;

/// CRC delimiter, acknowledge slot and delimiter, end of frame: never stuffed.
const UNSTUFFED_TAIL_BITS: u32 = 1 + 2 + 7;

/// Bits of a frame on the wire from start to end of frame, with the stuff bits that its payload causes.
#[must_use]
pub fn frame_bits(frame: &CanFrame) -> u32 {
    let mut bits = Bits::default();
    bits.push(0, 1);
    let id = frame.raw_id();
    let remote = u32::from(frame.is_remote());
    if frame.is_extended() {
        bits.push((id >> 18) & 0x7FF, 11);
        bits.push(0b11, 2);
        bits.push(id & 0x3_FFFF, 18);
        bits.push(remote, 1);
        bits.push(0, 2);
    } else {
        bits.push(id & 0x7FF, 11);
        bits.push(remote, 1);
        bits.push(0, 2);
    }
    let data = frame.data();
    bits.push(u32::try_from(data.len()).unwrap_or(8), 4);
    if !frame.is_remote() {
        for byte in data {
            bits.push(u32::from(*byte), 8);
        }
    }
    bits.push(u32::from(crc(bits.bits)), 15);
    bits.count + bits.stuff_bits() + UNSTUFFED_TAIL_BITS
}

/// Bits that a frame takes from the bus: its own and the pause after it.
#[must_use]
pub fn occupied_bits(frame: &CanFrame) -> u32 {
    frame_bits(frame) + INTERFRAME_BITS
}

/// The stuffed part of a frame before stuffing, at most 118 bits; the last one is the lowest.
#[derive(Default)]
struct Bits {
    bits: u128,
    count: u32,
}

impl Bits {
    fn push(&mut self, value: u32, width: u32) {
        self.bits = self.bits << width | u128::from(value);
        self.count += width;
    }

    /// After five equal bits comes one of the other kind, which counts for the next five.
    fn stuff_bits(&self) -> u32 {
        const TABLE: [[Stuffed; 256]; Stuffed::STATES] = Stuffed::table();
        let bytes = self.bits.to_be_bytes();
        let whole = (self.count / 8) as usize;
        let mut stuffed = Stuffed { bits: 0, state: 0 };
        // The first bits do not fill a byte.
        for place in (0..self.count % 8).rev() {
            let byte = bytes[bytes.len() - whole - 1];
            stuffed = stuffed.and(Stuffed::after(stuffed.state, byte >> place & 1));
        }
        for byte in &bytes[bytes.len() - whole..] {
            stuffed = stuffed.and(TABLE[usize::from(stuffed.state)][usize::from(*byte)]);
        }
        u32::from(stuffed.bits)
    }
}

/// How many bits were stuffed, and what the next ones depend on: twice the number of equal bits so far, plus their kind.
#[derive(Clone, Copy)]
struct Stuffed {
    bits: u8,
    state: u8,
}

impl Stuffed {
    /// No bit yet, or one to four equal bits of either kind.
    const STATES: usize = 10;

    const fn and(self, next: Self) -> Self {
        Self {
            bits: self.bits + next.bits,
            state: next.state,
        }
    }

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

    /// For each state, what each byte does.
    const fn table() -> [[Self; 256]; Self::STATES] {
        let mut table = [[Self { bits: 0, state: 0 }; 256]; Self::STATES];
        let mut state: u8 = 0;
        while (state as usize) < Self::STATES {
            let mut byte: u16 = 0;
            while byte < 256 {
                let mut stuffed = Self { bits: 0, state };
                let mut place = 8;
                while place > 0 {
                    place -= 1;
                    let is_set = byte >> place & 1 == 1;
                    stuffed = stuffed.and(Self::after(stuffed.state, is_set as u8));
                }
                table[state as usize][byte as usize] = stuffed;
                byte += 1;
            }
            state += 1;
        }
        table
    }
}

/// The CRC of ISO 11898-1, 10.4.2.6, byte by byte; zeros in front leave it zero.
fn crc(bits: u128) -> u16 {
    const TABLE: [u16; 256] = crc_table();
    let bytes = bits.to_be_bytes();
    bytes.into_iter().fold(0, |crc, byte| {
        let [_, high] = (crc >> 7).to_be_bytes();
        (crc << 8 ^ TABLE[usize::from(high ^ byte)]) & 0x7FFF
    })
}

/// What each byte adds to the CRC with the polynomial 0x4599.
const fn crc_table() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte: u16 = 0;
    while byte < 256 {
        let mut crc = byte << 7;
        let mut bit = 0;
        while bit < 8 {
            let feedback = crc & 0x4000 != 0;
            crc = (crc << 1) & 0x7FFF;
            if feedback {
                crc ^= 0x4599;
            }
            bit += 1;
        }
        table[byte as usize] = crc;
        byte += 1;
    }
    table
}

/// The bits that arbitration compares; the lowest value wins.
#[must_use]
pub fn arbitration_key(frame: &CanFrame) -> u32 {
    let id = frame.raw_id();
    let remote = u32::from(frame.is_remote());
    if frame.is_extended() {
        ((id >> 18) & 0x7FF) << 21 | 0b11 << 19 | (id & 0x3_FFFF) << 1 | remote
    } else {
        (id & 0x7FF) << 21 | remote << 20
    }
}

/// The wire: at most one frame at a time.
#[derive(Debug)]
pub struct BusModel {
    nanoseconds_per_bit: f64,
    free_at: Duration,
    busy: Duration,
}

impl BusModel {
    /// An idle bus.
    #[must_use]
    pub fn new(bitrate_kilobits_per_second: u32) -> Self {
        let nanoseconds_per_bit = 1e6 / f64::from(bitrate_kilobits_per_second);
        Self {
            nanoseconds_per_bit,
            free_at: Duration::ZERO,
            busy: Duration::ZERO,
        }
    }

    /// When the next frame may start.
    #[must_use]
    pub fn free_at(&self) -> Duration {
        self.free_at
    }

    /// Puts a frame on the idle bus and returns when its last bit has passed.
    pub fn transmit(&mut self, start: Duration, frame: &CanFrame) -> Duration {
        let bits = frame_bits(frame);
        let end = start + self.bit_time(bits);
        self.free_at = start + self.bit_time(bits + INTERFRAME_BITS);
        self.busy += self.free_at - start;
        end
    }

    /// How long frames have occupied the bus.
    #[must_use]
    pub fn busy(&self) -> Duration {
        self.busy
    }

    fn bit_time(&self, bits: u32) -> Duration {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a positive number of at most 200 000 bits x 1e6 ns"
        )]
        let nanoseconds = (f64::from(bits) * self.nanoseconds_per_bit).round() as u64;
        Duration::from_nanos(nanoseconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lengths that can-utils computes, see the head of the file.
    #[test]
    fn frames_are_as_long_as_can_utils_says() {
        let table = include_str!("../../tests/data/frame_lengths.csv");
        let rows = table.lines().filter(|line| !line.starts_with('/'));
        let mut checked = 0;
        for row in rows {
            let (frame, bits) = row.split_once(',').unwrap();
            let line = format!("(0000000000.000000) can0 {frame}");
            let stamped: crate::recording::Stamped = line.parse().unwrap();
            let bits: u32 = bits.parse().unwrap();
            assert_eq!(occupied_bits(&stamped.frame), bits, "{frame}");
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
        let remote =
            CanFrame::from_raw(0x100 | canopen::frame::REMOTE_FLAG, 0, [0; 8]).expect("0 bytes");
        let extended = CanFrame::from_raw(0x100 << 18 | canopen::frame::EXTENDED_FLAG, 0, [0; 8])
            .expect("0 bytes");
        assert!(arbitration_key(&data) < arbitration_key(&remote));
        assert!(arbitration_key(&remote) < arbitration_key(&extended));
        assert!(arbitration_key(&extended) < arbitration_key(&CanFrame::new(0x101, &[])));
    }
}
