//! Random numbers that are the same on every machine.

use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::fault::Fault;

/// Stream of random numbers.
#[derive(Clone, Debug)]
pub struct Stream(Pcg64Mcg);

impl Stream {
    /// Makes the stream of a seed.
    pub fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    /// Makes the stream of one fault of a scenario, independent of other faults.
    pub fn for_fault(seed: u64, fault: &Fault) -> Self {
        Self::named(seed, &fault.path())
    }

    /// Makes the stream of a name.
    pub fn named(seed: u64, name: &str) -> Self {
        // FNV-1a; any hash is suitable that differs between names and never changes.
        let hash = name.bytes().fold(0xCBF2_9CE4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
        });
        Self::new(seed ^ hash)
    }

    /// Returns 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Returns a uniform number in (0, 1]: 53 bits, never 0.
    pub fn uniform(&mut self) -> f64 {
        const SCALE: f64 = 1.0 / (1_u64 << 53) as f64;
        ((self.bits() >> 11) + 1) as f64 * SCALE
    }

    /// Returns a uniform number in `0..count`; 0 for a count of 0.
    pub fn below(&mut self, count: u64) -> u64 {
        // The bias is below count / 2^64.
        self.bits().checked_rem(count).unwrap_or_default()
    }

    /// Returns true with a probability.
    pub fn happens(&mut self, probability: f64) -> bool {
        self.uniform() <= probability
    }

    /// Returns a number of the standard normal distribution, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(self.uniform()));
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_has_another_stream() {
        let noise = "[[fault.sensor.noise]]\nfrom_seconds = 1.0\nnoise_millimetres_rms = 0.1\n";
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n{noise}{noise}"
        );
        let trial = testing::part(&text, "drive");
        let faults = Vec::from_iter(trial.run.faults.iter().cloned());
        let draw = |seed, index: usize| Stream::for_fault(seed, &faults[index]).bits();
        assert_eq!(draw(1, 0), draw(1, 0));
        assert_ne!(draw(1, 0), draw(1, 1));
        assert_ne!(draw(1, 0), draw(2, 0));
    }

    #[test]
    fn what_never_happens_never_happens_and_what_always_does_always() {
        let mut stream = Stream::new(7);
        assert!((0..10_000).all(|_| !stream.happens(0.0)));
        assert!((0..10_000).all(|_| stream.happens(1.0)));
        let half = (0..10_000).filter(|_| stream.happens(0.5)).count();
        assert!((4800..5200).contains(&half), "{half}");
    }
}
