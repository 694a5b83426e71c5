//! Floods: stretches of scenario time in which frames that no loop reads keep the nodes of the run from the bus.

use std::time::Duration;

/// Length of the stretches of time in which the frames that no loop reads are counted.
const FLOOD_WINDOW: Duration = Duration::from_millis(20);
/// Part of the bus that they must occupy in it to keep the nodes of the run from it.
const FLOOD: f64 = 0.5;
/// Largest number of floods that are kept apart; the last one lasts to the end of any later one.
const FLOODS_MAX: usize = 1000;

/// Stretches of scenario time in which the bus is full of frames that no loop reads.
#[derive(Clone, Debug, Default)]
pub(super) struct FloodReader {
    bits_max: f64,
    /// Number of the stretch of time that is counted, and the bits in it so far.
    window: u128,
    bits: u64,
    found: Vec<(f64, f64)>,
}

impl FloodReader {
    pub(super) fn new(bitrate_kilobits_per_second: u32) -> Self {
        let bits = 1e3 * f64::from(bitrate_kilobits_per_second) * FLOOD_WINDOW.as_secs_f64();
        Self {
            bits_max: FLOOD * bits,
            ..Self::default()
        }
    }

    /// The floods so far, in their order.
    pub(super) fn found(&self) -> &[(f64, f64)] {
        &self.found
    }

    pub(super) fn on_frame(&mut self, time: Duration, bits: u32) {
        let window = time.as_nanos() / FLOOD_WINDOW.as_nanos();
        if window != self.window {
            (self.window, self.bits) = (window, 0);
        }
        let before = self.bits as f64;
        self.bits += u64::from(bits);
        let is_full = |bits: f64| bits > self.bits_max;
        if is_full(self.bits as f64) && !is_full(before) {
            self.note(window as f64 * FLOOD_WINDOW.as_secs_f64());
        }
    }

    /// Notes that the bus is full in the stretch of time that starts here. The flood may have begun in the stretch before, and the
    /// frames that it kept back come in the one after: both belong to it.
    fn note(&mut self, from: f64) {
        let length = FLOOD_WINDOW.as_secs_f64();
        let (from, until) = (from - length, from + 2.0 * length);
        let is_full = self.found.len() >= FLOODS_MAX;
        match self.found.last_mut() {
            Some((_, last)) if is_full || from <= *last => *last = until,
            _ => self.found.push((from, until)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends frames of 128 bits at 1 Mbit/s, each this long after the one before, and returns the floods.
    fn floods(stretches: &[(f64, f64, f64)]) -> Vec<(f64, f64)> {
        let mut reader = FloodReader::new(1000);
        for (from, until, each) in stretches {
            let mut time = *from;
            while time < *until {
                reader.on_frame(Duration::from_secs_f64(time), 128);
                time += each;
            }
        }
        let milliseconds = |seconds: f64| (1e3 * seconds).round();
        let found = reader.found().iter();
        found
            .map(|(from, until)| (milliseconds(*from), milliseconds(*until)))
            .collect()
    }

    #[test]
    fn a_flood_is_as_long_as_the_bus_is_full_whatever_came_before() {
        let heartbeats = (0.0, 4.0, 0.02);
        assert_eq!(floods(&[heartbeats]), []);
        // It begins in the stretch before the first full one at the latest, and ends in the one after the last full one.
        let found = floods(&[(0.0, 2.5, 0.02), (2.5, 3.0, 130e-6), (3.0, 4.0, 0.02)]);
        assert_eq!(found, [(2480.0, 3020.0)]);
        let two = floods(&[(1.0, 1.1, 130e-6), (2.0, 2.1, 130e-6)]);
        assert_eq!(two.len(), 2);
        assert_eq!(floods(&[(1.0, 2.0, 300e-6)]), []);
    }
}
