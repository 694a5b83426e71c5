//! Model of a CAN bus in virtual time: the end of each frame and the earliest start of the next (ISO 11898-1, 10.4 to 10.8).

pub(crate) mod error_state;
pub(crate) mod faults;
mod hit_notes;

use std::time::Duration;

use can::CanFrame;
use can::frame_bits::{INTERFRAME_BITS, occupied_bits};

/// Bits of an active error flag and of the other stations' flags, which see an error six bits later because of it.
const ACTIVE_FLAGS_BITS: u32 = 6 + 6;
/// Bits of a transmitter's passive error flag, which no other station sees.
const PASSIVE_FLAG_BITS: u32 = 6;
/// Recessive bits after error flags.
const ERROR_DELIMITER_BITS: u32 = 8;
/// Bits for which an error passive station waits after its own frame.
pub(crate) const SUSPEND_BITS: u32 = 8;

/// Upper bound of the bits of a frame, disturbed or not.
const FRAME_BITS_END: usize = 256;

/// Wire, with at most one frame at a time.
#[derive(Debug)]
pub(crate) struct BusModel {
    nanoseconds_per_bit: f64,
    /// Durations by number of bits, for the lengths of frames, since each frame asks twice.
    frame_times: [Duration; FRAME_BITS_END],
    /// Time at which the next frame may start.
    pub(crate) free_at: Duration,
}

impl BusModel {
    /// Makes an idle bus.
    pub(crate) fn new(bitrate_kilobits_per_second: u32) -> Self {
        let nanoseconds_per_bit = 1e6 / f64::from(bitrate_kilobits_per_second);
        let mut frame_times = [Duration::ZERO; FRAME_BITS_END];
        for (bits, time) in (0..).zip(&mut frame_times) {
            *time = bit_time(bits, nanoseconds_per_bit);
        }
        Self {
            nanoseconds_per_bit,
            frame_times,
            free_at: Duration::ZERO,
        }
    }

    /// Puts a frame on the idle bus. Returns the time of its last bit, and the number of bits that it takes, as
    /// [`occupied_bits`].
    pub(crate) fn transmit(&mut self, start: Duration, frame: &CanFrame) -> (Duration, u32) {
        let occupied = occupied_bits(frame);
        let end = start + self.bit_time(occupied - INTERFRAME_BITS);
        self.free_at = start + self.bit_time(occupied);
        (end, occupied)
    }

    /// Disturbs a transmission after some bits: error flags and delimiter follow. Returns the time at which they have passed.
    pub(crate) fn disturb(&mut self, start: Duration, bits: u32, is_passive: bool) -> Duration {
        let flags = if is_passive {
            PASSIVE_FLAG_BITS
        } else {
            ACTIVE_FLAGS_BITS
        };
        let occupied = bits + flags + ERROR_DELIMITER_BITS;
        self.free_at = start + self.bit_time(occupied + INTERFRAME_BITS);
        start + self.bit_time(occupied)
    }

    /// Returns the duration of a number of bits.
    pub(crate) fn bit_time(&self, bits: u32) -> Duration {
        let known = self.frame_times.get(bits as usize);
        known.map_or_else(|| bit_time(bits, self.nanoseconds_per_bit), |time| *time)
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a positive number of at most 200 000 bits x 1e6 ns"
)]
fn bit_time(bits: u32, nanoseconds_per_bit: f64) -> Duration {
    Duration::from_nanos((f64::from(bits) * nanoseconds_per_bit).round() as u64)
}
