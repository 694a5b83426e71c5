//! I²t protection of the drive (0x2110), which does not measure the wire's temperature.
//!
//! The limits come from the rig; those of the shipped ones are assumed. The amplifier's maximum of 1 A alone keeps the
//! wire below 138 °C, Eq. (1) with data. The wire gets there within seconds (its time constant is 0.65 s), so no
//! overload integral can keep the peak lower: the protection limits the time at this temperature. The continuous 0.9 A
//! settle at 115 °C, where all of it is austenite: no position needs more. 1.9 A² s above it allow 1 A for 10 s from
//! cold; a ramp 0 → 1 → 0 A in 40 s takes 0.37 A² s.

use scenario::plant::I2t;

/// The overload integral. It never falls below zero and never exceeds its limit.
#[derive(Clone, Debug)]
pub struct ThermalProtection {
    /// 0x2110:01 and 0x2110:02; a peak of 0 is no protection.
    limits: I2t,
    overload_square_ampere_seconds: f64,
}

impl ThermalProtection {
    /// Makes a protection without load.
    pub fn new(limits: I2t) -> Self {
        Self {
            limits,
            overload_square_ampere_seconds: 0.0,
        }
    }

    /// Changes the limits; the load stays.
    pub fn set_limits(&mut self, limits: I2t) {
        self.limits = limits;
    }

    /// Adds the effect of a current over some time.
    pub fn advance(&mut self, duration_seconds: f64, current_amperes: f64) {
        let continuous = self.limits.continuous;
        let excess = current_amperes * current_amperes - continuous * continuous;
        self.overload_square_ampere_seconds = (self.overload_square_ampere_seconds
            + excess * duration_seconds)
            .clamp(0.0, self.limits.peak_square_seconds.max(0.0));
    }

    /// Returns whether the overload is at its limit.
    pub fn is_tripped(&self) -> bool {
        let most = self.limits.peak_square_seconds;
        most > 0.0 && self.overload_square_ampere_seconds >= most
    }

    /// Returns the overload relative to its limit, 0 to 1 (0x2110:03).
    pub fn utilisation(&self) -> f64 {
        let most = self.limits.peak_square_seconds;
        if most > 0.0 {
            (self.overload_square_ampere_seconds / most).min(1.0)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: I2t = I2t {
        continuous: 0.9,
        peak_square_seconds: 1.9,
    };

    /// Returns the seconds until the protection trips under a constant current.
    fn trip_seconds(current_amperes: f64) -> Option<f64> {
        let mut protection = ThermalProtection::new(LIMITS);
        (1..100_000)
            .find(|_| {
                protection.advance(0.001, current_amperes);
                protection.is_tripped()
            })
            .map(|milliseconds| f64::from(milliseconds) * 1e-3)
    }

    #[test]
    fn one_ampere_trips_after_ten_seconds_and_the_continuous_current_never() {
        let seconds = trip_seconds(1.0).unwrap();
        assert!((seconds - 10.0).abs() < 0.01, "{seconds}");
        assert_eq!(trip_seconds(LIMITS.continuous), None);
    }

    #[test]
    fn the_ramp_to_one_ampere_and_back_does_not_trip() {
        let mut protection = ThermalProtection::new(LIMITS);
        let mut highest: f64 = 0.0;
        for milliseconds in 0..40_000 {
            let seconds = f64::from(milliseconds) * 1e-3;
            protection.advance(0.001, 1.0 - (seconds - 20.0).abs() / 20.0);
            highest = highest.max(protection.utilisation());
        }
        assert!((0.15..0.25).contains(&highest), "{highest}");
        assert_eq!(protection.utilisation(), 0.0);
    }

    #[test]
    fn without_limits_nothing_trips() {
        let mut protection = ThermalProtection::new(I2t {
            continuous: 0.0,
            peak_square_seconds: 0.0,
        });
        protection.advance(1e6, 1.0);
        assert!(!protection.is_tripped() && protection.utilisation() == 0.0);
    }

    #[test]
    fn a_trip_ends_as_soon_as_the_current_is_gone() {
        let mut protection = ThermalProtection::new(LIMITS);
        protection.advance(100.0, 1.0);
        assert!(protection.is_tripped());
        protection.advance(0.001, 0.0);
        assert!(!protection.is_tripped());
    }
}
