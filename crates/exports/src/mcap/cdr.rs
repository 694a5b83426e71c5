//! OMG's Common Data Representation, as ROS 2 serialises its messages: every value at a multiple of its size.

use std::time::Duration;

/// Header for little-endian values, without options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Serialised message.
pub(super) struct Cdr {
    bytes: Vec<u8>,
}

impl Cdr {
    pub(super) fn new() -> Self {
        Self {
            bytes: HEADER.to_vec(),
        }
    }

    /// Begins a new message in the same memory.
    pub(super) fn clear(&mut self) {
        self.bytes.truncate(HEADER.len());
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub(super) fn push_u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub(super) fn push_u32(&mut self, value: u32) {
        self.push(value.to_le_bytes());
    }

    pub(super) fn push_f64(&mut self, value: f64) {
        self.push(value.to_le_bytes());
    }

    /// Appends a `builtin_interfaces/Time`, which ends in 2038.
    pub(super) fn push_time(&mut self, time: Duration) {
        let seconds = i32::try_from(time.as_secs()).unwrap_or(i32::MAX);
        self.push(seconds.to_le_bytes());
        self.push_u32(time.subsec_nanos());
    }

    pub(super) fn push_text(&mut self, text: &str) {
        let bytes = text.len() + 1;
        self.push_u32(u32::try_from(bytes).expect("a text is shorter than 4 GiB"));
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    fn push<const N: usize>(&mut self, bytes: [u8; N]) {
        // Alignment does not count the header.
        let end = (self.bytes.len() - HEADER.len()).next_multiple_of(N);
        self.bytes.resize(HEADER.len() + end, 0);
        self.bytes.extend_from_slice(&bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stand_at_multiples_of_their_size() {
        let mut cdr = Cdr::new();
        cdr.push_u8(1);
        cdr.push_text("ab");
        cdr.push_f64(1.0);
        let expected = [
            0, 1, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
            0xF0, 0x3F,
        ];
        assert_eq!(cdr.bytes(), expected);
    }
}
