//! The current amplifier of the plant.

use scenario::plant;

use crate::objects::rounded_i16;

/// Largest resolution of the digital-to-analogue converter.
pub const RESOLUTION_BITS_MAX: u32 = 24;

/// The amplifier: sources current within its range and follows its command at once.
#[derive(Clone, Debug)]
pub struct Amplifier {
    /// Rated current, to which commands refer (0x6075).
    rated_amperes: f64,
    /// Smallest current, 0 or below it.
    amperes_min: f64,
    /// Largest current.
    amperes_max: f64,
    /// Steps of the converter over the full range; 0 leaves the command's 1 permille.
    steps: f64,
}

impl Amplifier {
    /// An amplifier whose commands are permille of `rated_amperes`.
    #[must_use]
    pub fn new(config: &plant::Amplifier, rated_amperes: f64) -> Self {
        let bits = config.resolution_bits.min(RESOLUTION_BITS_MAX);
        Self {
            rated_amperes,
            amperes_min: config.min,
            amperes_max: config.max,
            steps: f64::from((1_u32 << bits) - 1),
        }
    }

    /// The current that a command gives, clipped to the range and rounded to the converter's steps.
    #[must_use]
    pub fn current_amperes(&self, command_permille: i16) -> f64 {
        let wanted = f64::from(command_permille) / 1e3 * self.rated_amperes;
        let clipped = wanted.clamp(self.amperes_min, self.amperes_max);
        let range = self.amperes_max - self.amperes_min;
        if self.steps == 0.0 || range <= 0.0 {
            return clipped;
        }
        let steps = libm::round((clipped - self.amperes_min) / range * self.steps);
        steps / self.steps * range + self.amperes_min
    }

    /// True when a command lies outside what the amplifier can source.
    #[must_use]
    pub fn clips(&self, command_permille: i16) -> bool {
        let wanted = f64::from(command_permille) / 1e3 * self.rated_amperes;
        !(self.amperes_min..=self.amperes_max).contains(&wanted)
    }

    /// A current in permille of the rated current, as 0x6078 reports it.
    #[must_use]
    pub fn permille(&self, current_amperes: f64) -> i16 {
        rounded_i16(current_amperes / self.rated_amperes * 1e3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn amplifier(max: f64, resolution_bits: u32) -> Amplifier {
        let config = plant::Amplifier {
            max,
            resolution_bits,
            ..plant::Amplifier::default()
        };
        Amplifier::new(&config, 1.0)
    }

    #[test]
    fn every_permille_passes_and_the_range_clips() {
        let amplifier = amplifier(1.0, 0);
        for permille in 0..=1000 {
            let current = amplifier.current_amperes(permille);
            assert!((current - f64::from(permille) / 1000.0).abs() < 1e-15);
            assert_eq!(amplifier.permille(current), permille);
        }
        assert_eq!(amplifier.current_amperes(-5), 0.0);
        assert_eq!(amplifier.current_amperes(i16::MAX), 1.0);
    }

    #[test]
    fn the_maximum_may_differ_from_the_rating() {
        assert_eq!(amplifier(0.8, 0).current_amperes(900), 0.8);
        assert!(amplifier(0.8, 0).clips(900) && !amplifier(0.8, 0).clips(800));
        assert!(amplifier(0.8, 0).clips(-1) && !amplifier(0.8, 0).clips(0));
        assert_eq!(amplifier(0.0, 10).current_amperes(900), 0.0);
    }

    #[test]
    fn an_amplifier_that_drives_both_ways_clips_at_both_ends() {
        let config = plant::Amplifier {
            min: -0.5,
            resolution_bits: 10,
            ..plant::Amplifier::default()
        };
        let amplifier = Amplifier::new(&config, 1.0);
        assert_eq!(amplifier.current_amperes(-900), -0.5);
        assert!(amplifier.clips(-501) && !amplifier.clips(-500));
        let steps = (amplifier.current_amperes(-123) + 0.5) / 1.5 * 1023.0;
        assert!((steps - libm::round(steps)).abs() < 1e-9);
        assert!((amplifier.current_amperes(-123) + 0.123).abs() < 0.75 / 1023.0);
    }

    #[test]
    fn a_converter_of_10_bits_rounds_to_its_steps() {
        let amplifier = amplifier(1.0, 10);
        for permille in 0..=1000 {
            let error = amplifier.current_amperes(permille) - f64::from(permille) / 1000.0;
            assert!(error.abs() <= 0.5 / 1023.0 + 1e-12, "{error}");
        }
        assert_eq!(amplifier.current_amperes(1000), 1.0);
        let steps = amplifier.current_amperes(500) * 1023.0;
        assert!((steps - libm::round(steps)).abs() < 1e-9);
    }
}
