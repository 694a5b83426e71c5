//! The amplifier of a drive: it gives a current, or another quantity, to an input of the plant.

use dbc::CommandRange;
use scenario::rig::nodes;

use crate::objects::{SIGNED_16, rounded_16};

/// Largest resolution of the digital-to-analogue converter.
pub const RESOLUTION_BITS_MAX: u32 = 24;

/// An amplifier. It gives what is commanded at once, within its range.
#[derive(Clone, Debug)]
pub struct Amplifier {
    /// Rated value, of which commands are in permille.
    rated: f64,
    range: CommandRange,
    /// Steps of the converter over the full range; 0 for the command's resolution of 1 permille.
    steps: f64,
}

impl Amplifier {
    /// Makes an amplifier.
    pub fn new(config: &nodes::Amplifier) -> Self {
        let bits = config.resolution_bits().min(RESOLUTION_BITS_MAX);
        Self {
            rated: config.rated(),
            range: config.range(),
            steps: f64::from((1_u32 << bits) - 1),
        }
    }

    /// Returns the output of a command before its limitation.
    fn wanted(&self, command_permille: i16) -> f64 {
        f64::from(command_permille) / 1e3 * self.rated
    }

    /// Returns the output of a command, clipped to the range and rounded to the converter's steps.
    pub fn output(&self, command_permille: i16) -> f64 {
        let CommandRange { min, max, .. } = self.range;
        let clipped = self.wanted(command_permille).clamp(min, max);
        let span = max - min;
        if self.steps == 0.0 || span <= 0.0 {
            return clipped;
        }
        let steps = libm::round((clipped - min) / span * self.steps);
        steps / self.steps * span + min
    }

    /// Returns whether a command is outside the amplifier's range.
    pub fn clips(&self, command_permille: i16) -> bool {
        let CommandRange { min, max, .. } = self.range;
        !(min..=max).contains(&self.wanted(command_permille))
    }

    /// Returns the amplifier's range in permille of the rated value.
    pub(crate) fn range_permille(&self) -> [f64; 2] {
        [self.range.min, self.range.max].map(|end| end / self.rated * 1e3)
    }

    /// Returns an output in permille of the rated value, as in 0x6078.
    pub fn permille(&self, output: f64) -> i16 {
        i16::from_le_bytes(rounded_16(output / self.rated * 1e3, SIGNED_16))
    }

    /// Returns the largest tolerated deviation of the output from its command (assumed: a fifth of the rated value).
    pub fn deviation_max(&self) -> f64 {
        self.rated / 5.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn amplifier(max: f64, resolution_bits: u32) -> Amplifier {
        let config = nodes::Amplifier {
            max: Some(max),
            resolution_bits: Some(resolution_bits),
            ..nodes::Amplifier::default()
        };
        Amplifier::new(&config)
    }

    #[test]
    fn every_permille_passes_and_the_range_clips() {
        let amplifier = amplifier(1.0, 0);
        for permille in 0..=1000 {
            let current = amplifier.output(permille);
            assert!((current - f64::from(permille) / 1000.0).abs() < 1e-15);
            assert_eq!(amplifier.permille(current), permille);
        }
        assert_eq!(amplifier.output(-5), 0.0);
        assert_eq!(amplifier.output(i16::MAX), 1.0);
    }

    #[test]
    fn the_maximum_may_differ_from_the_rating() {
        assert_eq!(amplifier(0.8, 0).output(900), 0.8);
        assert!(amplifier(0.8, 0).clips(900) && !amplifier(0.8, 0).clips(800));
        assert!(amplifier(0.8, 0).clips(-1) && !amplifier(0.8, 0).clips(0));
        assert_eq!(amplifier(0.0, 10).output(900), 0.0);
    }

    #[test]
    fn an_amplifier_that_drives_both_ways_clips_at_both_ends() {
        let config = nodes::Amplifier {
            min: Some(-0.5),
            resolution_bits: Some(10),
            ..nodes::Amplifier::default()
        };
        let amplifier = Amplifier::new(&config);
        assert_eq!(amplifier.output(-900), -0.5);
        assert!(amplifier.clips(-501) && !amplifier.clips(-500));
        let steps = (amplifier.output(-123) + 0.5) / 1.5 * 1023.0;
        assert!((steps - libm::round(steps)).abs() < 1e-9);
        assert!((amplifier.output(-123) + 0.123).abs() < 0.75 / 1023.0);
    }

    #[test]
    fn a_converter_of_10_bits_rounds_to_its_steps() {
        let amplifier = amplifier(1.0, 10);
        for permille in 0..=1000 {
            let error = amplifier.output(permille) - f64::from(permille) / 1000.0;
            assert!(error.abs() <= 0.5 / 1023.0 + 1e-12, "{error}");
        }
        assert_eq!(amplifier.output(1000), 1.0);
        let steps = amplifier.output(500) * 1023.0;
        assert!((steps - libm::round(steps)).abs() < 1e-9);
    }
}
