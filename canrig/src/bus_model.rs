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
    let mut bits = BitCounter::default();
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
    bits.push_crc();
    bits.count + UNSTUFFED_TAIL_BITS
}

/// Counts bits, computes the CRC and inserts a stuff bit after five equal bits.
#[derive(Default)]
struct BitCounter {
    count: u32,
    crc: u16,
    last: u32,
    run: u32,
}

impl BitCounter {
    /// Appends the lowest `width` bits of `value`, most significant first.
    fn push(&mut self, value: u32, width: u32) {
        for position in (0..width).rev() {
            let bit = (value >> position) & 1;
            let feedback = bit ^ u32::from(self.crc >> 14 & 1);
            self.crc = (self.crc << 1) & 0x7FFF;
            if feedback == 1 {
                self.crc ^= 0x4599;
            }
            self.stuff(bit);
        }
    }

    fn push_crc(&mut self) {
        let crc = u32::from(self.crc);
        for position in (0..15).rev() {
            self.stuff((crc >> position) & 1);
        }
    }

    fn stuff(&mut self, bit: u32) {
        self.count += 1;
        if self.run > 0 && bit == self.last {
            self.run += 1;
        } else {
            (self.last, self.run) = (bit, 1);
        }
        if self.run == 5 {
            self.count += 1;
            (self.last, self.run) = (1 - bit, 1);
        }
    }
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
