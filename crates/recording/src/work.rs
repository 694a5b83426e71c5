//! Progress of work on long recordings: how often the process has done through one, from its first frame or cycle to its last.

use std::io::{self, Read};
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of parts of one pass through a recording.
pub const PARTS: u64 = 1_000_000;

/// Number of parts that are done.
static DONE: AtomicU64 = AtomicU64::new(0);

/// Returns the number of parts that the process has done so far, for all recordings together.
pub fn parts_done() -> u64 {
    DONE.load(Ordering::Relaxed)
}

/// One pass through a recording.
#[derive(Debug)]
pub struct Pass {
    length: u64,
    pub(crate) done: u64,
    parts: u64,
}

impl Pass {
    /// Makes a pass of `length` steps, none of which is done.
    pub fn new(length: u64) -> Self {
        Self {
            length: length.max(1),
            done: 0,
            parts: 0,
        }
    }

    /// Adds steps that are done.
    pub fn advance(&mut self, steps: usize) {
        self.reach(self.done + u64::try_from(steps).unwrap_or(0));
    }

    /// Sets how many steps are done, if these are more than before.
    pub(crate) fn reach(&mut self, steps: u64) {
        self.done = self.done.max(steps);
        let parts =
            u128::from(PARTS) * u128::from(self.done.min(self.length)) / u128::from(self.length);
        let parts = u64::try_from(parts).unwrap_or(PARTS);
        DONE.fetch_add(parts - self.parts, Ordering::Relaxed);
        self.parts = parts;
    }
}

/// File whose bytes measure a pass.
#[derive(Debug)]
pub(crate) struct Measured<R> {
    input: R,
    pass: Pass,
}

impl<R> Measured<R> {
    pub(crate) fn new(input: R, bytes: u64) -> Self {
        Self {
            input,
            pass: Pass::new(bytes),
        }
    }
}

impl<R: Read> Read for Measured<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.input.read(bytes)?;
        self.pass.advance(read);
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Other tests make passes too, so only the least is known.
    #[test]
    fn a_pass_is_done_once_whatever_its_steps() {
        let before = parts_done();
        let mut file = Measured::new(&[0; 1000][..], 1000);
        let mut bytes = [0; 7];
        while file.read(&mut bytes).unwrap() > 0 {}
        assert_eq!((file.pass.done, file.pass.parts), (1000, PARTS));
        assert!(parts_done() - before >= PARTS);
        file.pass.advance(500);
        assert_eq!(file.pass.parts, PARTS);
    }
}
