//! I²t protection of the drive, which does not measure the wire's temperature.
//!
//! Both numbers are assumed. The amplifier's limit of 1 A alone keeps the wire below 138 °C, Eq. (1) with the paper's
//! data, and the wire reaches that within seconds (its time constant is 0.65 s), so no overload integral can keep the peak
//! lower; the protection limits how long a wire is held there. At 0.9 A it settles at 115 °C, where all of it is austenite:
//! no task needs more for long. At 1 A the protection trips after 10 s, which leaves a ramp 0 → 1 → 0 A in 40 s
//! (overload 0.37 A² s) and any hold inside the span (0.7 A) far from the limit.

/// Current that may flow for ever (assumed).
pub const CONTINUOUS_AMPERES: f64 = 0.9;

/// Overload that trips: `∫ (i² − 0.81 A²) dt`, never below zero (assumed: 10 s at 1 A).
pub const OVERLOAD_SQUARE_AMPERE_SECONDS_MAX: f64 =
    10.0 * (1.0 - CONTINUOUS_AMPERES * CONTINUOUS_AMPERES);

/// The overload integral.
#[derive(Clone, Debug, Default)]
pub struct ThermalProtection {
    overload_square_ampere_seconds: f64,
}

impl ThermalProtection {
    /// Lets a current flow for some time.
    pub fn advance(&mut self, duration_seconds: f64, current_amperes: f64) {
        let excess = current_amperes * current_amperes - CONTINUOUS_AMPERES * CONTINUOUS_AMPERES;
        let overload = self.overload_square_ampere_seconds + excess * duration_seconds;
        self.overload_square_ampere_seconds =
            overload.clamp(0.0, OVERLOAD_SQUARE_AMPERE_SECONDS_MAX);
    }

    /// True while the overload is at its limit.
    #[must_use]
    pub fn is_tripped(&self) -> bool {
        self.overload_square_ampere_seconds >= OVERLOAD_SQUARE_AMPERE_SECONDS_MAX
    }

    /// The overload by its limit, 0 to 1.
    #[must_use]
    pub fn load_factor(&self) -> f64 {
        self.overload_square_ampere_seconds / OVERLOAD_SQUARE_AMPERE_SECONDS_MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds until the protection trips under a constant current.
    fn trip_seconds(current_amperes: f64) -> Option<f64> {
        let mut protection = ThermalProtection::default();
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
        assert_eq!(trip_seconds(CONTINUOUS_AMPERES), None);
    }

    #[test]
    fn the_ramp_to_one_ampere_and_back_does_not_trip() {
        let mut protection = ThermalProtection::default();
        let mut highest: f64 = 0.0;
        for milliseconds in 0..40_000 {
            let seconds = f64::from(milliseconds) * 1e-3;
            protection.advance(0.001, 1.0 - (seconds - 20.0).abs() / 20.0);
            highest = highest.max(protection.load_factor());
        }
        assert!((0.15..0.25).contains(&highest), "{highest}");
        assert_eq!(protection.load_factor(), 0.0);
    }

    #[test]
    fn a_trip_ends_as_soon_as_the_current_is_gone() {
        let mut protection = ThermalProtection::default();
        protection.advance(100.0, 1.0);
        assert!(protection.is_tripped());
        protection.advance(0.001, 0.0);
        assert!(!protection.is_tripped());
    }
}
