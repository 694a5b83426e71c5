//! Currents of an amplifier.

use canopen::add_half;

/// Counts of the rated current: CiA 402 counts currents in thousandths of it (0x6071, 0x6078).
const COUNTS: f64 = 1000.0;
/// Largest number of counts that 16 bits hold.
pub const COUNTS_MAX: f64 = 32_767.0;

/// Range of commands to an amplifier, in amperes: from `min` to `max`, in thousandths of `rated`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentRange {
    /// Rated current (0x6075), to which commands refer.
    pub rated: f64,
    /// Smallest current: 0, or negative for an amplifier that drives both ways.
    pub min: f64,
    /// Largest current.
    pub max: f64,
}

impl Default for CurrentRange {
    fn default() -> Self {
        Self {
            rated: 1.0,
            min: 0.0,
            max: 1.0,
        }
    }
}

impl CurrentRange {
    /// Returns the counts of a command for one ampere.
    pub fn counts_per_ampere(&self) -> f64 {
        COUNTS / self.rated
    }

    /// Returns the largest current in either direction.
    pub fn largest(&self) -> f64 {
        self.max.max(-self.min)
    }

    /// Returns a current as the bus carries it: within the range, and in whole counts. A value that is no number becomes 0.
    #[inline]
    pub fn limited(&self, current_amperes: f64) -> f64 {
        if current_amperes.is_nan() {
            return 0.0;
        }
        let limited = current_amperes.max(self.min).min(self.max);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a whole number of a few thousands"
        )]
        let counts = add_half(limited * self.counts_per_ampere()) as i32;
        f64::from(counts) / self.counts_per_ampere()
    }

    /// Checks whether a current is the largest in its direction.
    pub fn is_at_end(&self, current_amperes: f64) -> bool {
        current_amperes >= self.max || (self.min < 0.0 && current_amperes <= self.min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_current_is_limited_and_in_whole_thousandths_of_the_rated_one() {
        let wire = CurrentRange::default();
        let bridge = CurrentRange {
            rated: 20.0,
            min: -40.0,
            max: 30.0,
        };
        for (range, current, limited) in [
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
            assert_eq!(range.limited(current), limited, "{current}");
        }
        assert_eq!((wire.largest(), bridge.largest()), (1.0, 40.0));
        assert!(wire.is_at_end(1.0) && !wire.is_at_end(0.0));
        assert!(bridge.is_at_end(-40.0) && !bridge.is_at_end(29.9));
    }
}
