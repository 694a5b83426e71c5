//! Progress of work on long recordings: how often the process has gone through one, from its first frame or cycle to its last.

use std::io::{self, Read};
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of parts of one pass through a recording.
pub const PARTS: u64 = 1_000_000;

/// Number of parts that are done.
static DONE: AtomicU64 = AtomicU64::new(0);

/// Returns the number of parts that the process has done so far, for all recordings together.
#[must_use]
pub fn parts_done() -> u64 {
    DONE.load(Ordering::Relaxed)
}

/// One pass through a recording.
#[derive(Debug)]
pub struct Way {
    length: u64,
    gone: u64,
    parts: u64,
}

impl Way {
    /// Makes a pass of `length` steps, none of which is done.
    #[must_use]
    pub fn new(length: u64) -> Self {
        Self {
            length: length.max(1),
            gone: 0,
            parts: 0,
        }
    }

    /// Adds steps that are done.
    pub fn go(&mut self, steps: usize) {
        self.gone += u64::try_from(steps).unwrap_or(0);
        let parts =
            u128::from(PARTS) * u128::from(self.gone.min(self.length)) / u128::from(self.length);
        let parts = u64::try_from(parts).unwrap_or(PARTS);
        DONE.fetch_add(parts - self.parts, Ordering::Relaxed);
        self.parts = parts;
    }
}

/// File whose bytes measure a pass.
#[derive(Debug)]
pub(crate) struct Measured<R> {
    input: R,
    way: Way,
}

impl<R> Measured<R> {
    pub(crate) fn new(input: R, bytes: u64) -> Self {
        Self {
            input,
            way: Way::new(bytes),
        }
    }
}

impl<R: Read> Read for Measured<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.input.read(bytes)?;
        self.way.go(read);
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Other tests make passes too, so only the least is known.
    #[test]
    fn a_way_is_done_once_however_it_is_gone() {
        let before = parts_done();
        let mut file = Measured::new(&[0; 1000][..], 1000);
        let mut bytes = [0; 7];
        while file.read(&mut bytes).unwrap() > 0 {}
        assert_eq!((file.way.gone, file.way.parts), (1000, PARTS));
        assert!(parts_done() - before >= PARTS);
        file.way.go(500);
        assert_eq!(file.way.parts, PARTS);
    }
}
