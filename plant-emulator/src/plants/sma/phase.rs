//! Phase transformation with its hysteresis.

use scenario::plant;

/// Largest argument of an exponential here, so that every product of Eq. (2) stays finite.
const EXPONENT_MAX: f64 = 300.0;

/// The branch of the hysteresis that the wire is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Branch {
    /// The wire grows warmer: martensite turns into austenite.
    Heating,
    /// The wire grows colder: austenite turns into martensite.
    Cooling,
}

/// One branch of Eq. (2): the phase that vanishes along it is `amplitude / (1 + exp(slope (T − centre)))`.
#[derive(Clone, Copy, Debug)]
struct Sigmoid {
    /// `aA = 6.2 / (Af − As)` while heating, `−aM = −6.2 / (Ms − Mf)` while cooling, 1/K.
    slope: f64,
    /// `bA = (As + Af) / 2` or `bM = (Ms + Mf) / 2`, °C.
    centre_celsius: f64,
}

impl Sigmoid {
    fn new(start_celsius: f64, finish_celsius: f64) -> Self {
        Self {
            slope: 6.2 / (finish_celsius - start_celsius),
            centre_celsius: 0.5 * (start_celsius + finish_celsius),
        }
    }

    /// `1 + exp(slope (T − centre))`.
    #[inline]
    fn denominator(&self, temperature_celsius: f64) -> f64 {
        let exponent = self.slope * (temperature_celsius - self.centre_celsius);
        1.0 + libm::exp(exponent.clamp(-EXPONENT_MAX, EXPONENT_MAX))
    }
}

/// The branch memory of Eq. (2): where the last turn was decides the curve that is followed now.
#[derive(Clone, Debug)]
pub(super) struct Transformation {
    heating: Sigmoid,
    cooling: Sigmoid,
    branch: Branch,
    /// `ξm` on the heating branch, `1 − ξA` on the cooling branch; above 1 after an inner turn (PAPER E2).
    amplitude: f64,
}

impl Transformation {
    /// All martensite, on the heating branch with `ξm = 1`.
    pub(super) fn new(config: &plant::Phase) -> Self {
        Self {
            heating: Sigmoid::new(
                config.austenite_start_celsius,
                config.austenite_finish_celsius,
            ),
            cooling: Sigmoid::new(
                config.martensite_start_celsius,
                config.martensite_finish_celsius,
            ),
            branch: Branch::Heating,
            amplitude: 1.0,
        }
    }

    pub(super) fn branch(&self) -> Branch {
        self.branch
    }

    /// `ξ` on the present branch, Eq. (2).
    ///
    /// Heating: `ξ = ξm / (1 + exp(aA (T − bA)))`.
    /// Cooling, with the slope of Eq. (10) (PAPER E1): `ξ = (1 − ξA) / (1 + e) + ξA` with `e = exp(aM (T − bM))`,
    /// written as `1 − ξ = (1 − ξA) / (1 + 1/e)`, which loses no digits in the cold.
    #[inline]
    pub(super) fn martensite_fraction(&self, temperature_celsius: f64) -> f64 {
        let fraction = match self.branch {
            Branch::Heating => self.amplitude / self.heating.denominator(temperature_celsius),
            Branch::Cooling => 1.0 - self.amplitude / self.cooling.denominator(temperature_celsius),
        };
        fraction.clamp(0.0, 1.0)
    }

    /// Follows the sign of `dT/dt`; zero keeps the branch. On a turn at `(Tr, ξr)` the new branch goes through that
    /// point (PAPER E2): `ξm = ξr (1 + exp(aA (Tr − bA)))`, and `ξA = (ξr (1 + e) − 1) / e`, that is
    /// `1 − ξA = (1 − ξr) (1 + 1/e)`. True on a turn.
    pub(super) fn follow(&mut self, rate_kelvin_per_second: f64, temperature_celsius: f64) -> bool {
        let branch = if rate_kelvin_per_second > 0.0 {
            Branch::Heating
        } else if rate_kelvin_per_second < 0.0 {
            Branch::Cooling
        } else {
            return false;
        };
        if branch == self.branch {
            return false;
        }
        let fraction = self.martensite_fraction(temperature_celsius);
        self.amplitude = match branch {
            Branch::Heating => fraction * self.heating.denominator(temperature_celsius),
            Branch::Cooling => (1.0 - fraction) * self.cooling.denominator(temperature_celsius),
        };
        self.branch = branch;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transformation() -> Transformation {
        Transformation::new(&plant::Phase::default())
    }

    #[test]
    fn the_centre_of_the_heating_branch_is_half_martensite() {
        assert!((transformation().martensite_fraction(73.0) - 0.5).abs() < 1e-15);
    }

    #[test]
    fn cooling_matches_the_paper_with_the_sign_of_equation_10() {
        let mut phase = transformation();
        phase.follow(-1.0, 80.0);
        let fraction = phase.martensite_fraction(80.0);
        // ξA from PAPER E2 and ξ from Eq. (2), literally.
        let exponential = |t: f64| libm::exp(6.2 / (66.0 - 34.0) * (t - 50.0));
        let e = exponential(80.0);
        let xi_a = (fraction * (1.0 + e) - 1.0) / e;
        for temperature in [80.0, 66.0, 50.0, 34.0, 15.0] {
            let expected = (1.0 - xi_a) / (1.0 + exponential(temperature)) + xi_a;
            let found = phase.martensite_fraction(temperature);
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
        assert!(phase.martensite_fraction(15.0) > phase.martensite_fraction(50.0));
    }

    #[test]
    fn turns_are_continuous_and_a_zero_rate_keeps_the_branch() {
        let mut phase = transformation();
        for (rate, temperature) in [(-1.0, 75.0), (1.0, 45.0), (-1.0, 70.0), (1.0, 62.0)] {
            let before = phase.martensite_fraction(temperature);
            phase.follow(rate, temperature);
            assert!((phase.martensite_fraction(temperature) - before).abs() < 1e-15);
            let branch = phase.branch();
            phase.follow(0.0, temperature);
            assert_eq!(phase.branch(), branch);
        }
    }

    /// PAPER E2: loops between two temperatures close to 1e-3 after about ten cycles.
    #[test]
    fn minor_loops_converge() {
        let mut phase = transformation();
        let mut tops = Vec::new();
        for _ in 0..12 {
            phase.follow(1.0, 55.0);
            tops.push(phase.martensite_fraction(75.0));
            phase.follow(-1.0, 75.0);
        }
        assert!((tops[1] - tops[0]).abs() > 1e-3, "{tops:?}");
        assert!((tops[11] - tops[10]).abs() < 1e-3, "{tops:?}");
    }

    #[test]
    fn extreme_temperatures_stay_finite() {
        let mut phase = Transformation::new(&plant::Phase {
            austenite_start_celsius: 72.999,
            austenite_finish_celsius: 73.0,
            ..plant::Phase::default()
        });
        for temperature in [1e9, -1e9, 73.0, 1e9, 20.0] {
            for rate in [1.0, -1.0] {
                phase.follow(rate, temperature);
                let fraction = phase.martensite_fraction(temperature);
                assert!((0.0..=1.0).contains(&fraction), "{fraction}");
            }
        }
    }
}
