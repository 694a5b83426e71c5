//! Ranges of the commands that a drive takes, as its bus carries them.

use canopen::add_half;

/// Counts of the rated value: CiA 402 counts targets of an amplifier in thousandths of it (0x6071, 0x6078).
const COUNTS_OF_RATED: f64 = 1000.0;
/// Largest number of counts that 16 bits hold.
pub const COUNTS_MAX: f64 = 32_767.0;

/// Range of the commands to a drive, in the unit of its target, and their resolution on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandRange {
    /// Smallest command: 0, or negative for a drive that acts both ways.
    pub min: f64,
    /// Largest command.
    pub max: f64,
    /// Counts of the target object for one unit.
    pub counts_per_unit: f64,
}

impl Default for CommandRange {
    fn default() -> Self {
        Self::of_rated(1.0, 0.0, 1.0)
    }
}

impl CommandRange {
    /// Returns the range of an amplifier whose target object counts thousandths of `rated` (0x6075).
    pub fn of_rated(rated: f64, min: f64, max: f64) -> Self {
        Self {
            min,
            max,
            counts_per_unit: COUNTS_OF_RATED / rated,
        }
    }

    /// Returns the largest command in either direction.
    pub fn largest(&self) -> f64 {
        self.max.max(-self.min)
    }

    /// Returns a command as the bus carries it: within the range, and in whole counts. A value that is not a number becomes 0.
    #[inline]
    pub fn limited(&self, command: f64) -> f64 {
        if command.is_nan() {
            return 0.0;
        }
        let limited = command.max(self.min).min(self.max);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a whole number of a few thousands"
        )]
        let counts = add_half(limited * self.counts_per_unit) as i32;
        f64::from(counts) / self.counts_per_unit
    }

    /// Checks whether a command is the largest in its direction.
    pub fn is_at_end(&self, command: f64) -> bool {
        command >= self.max || (self.min < 0.0 && command <= self.min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_limited_and_in_whole_thousandths_of_the_rated_value() {
        let wire = CommandRange::default();
        let bridge = CommandRange::of_rated(20.0, -40.0, 30.0);
        for (range, command, limited) in [
            (wire, f64::NAN, 0.0),
            (wire, -1.0, 0.0),
            (wire, f64::INFINITY, 1.0),
            (wire, 0.56789, 0.568),
            (bridge, f64::NAN, 0.0),
            (bridge, f64::NEG_INFINITY, -40.0),
            (bridge, 31.0, 30.0),
            (bridge, -12.349, -12.34),
            (bridge, 0.011, 0.02),
        ] {
            assert_eq!(range.limited(command), limited, "{command}");
        }
        assert_eq!((wire.largest(), bridge.largest()), (1.0, 40.0));
        assert!(wire.is_at_end(1.0) && !wire.is_at_end(0.0));
        assert!(bridge.is_at_end(-40.0) && !bridge.is_at_end(29.9));
    }
}
