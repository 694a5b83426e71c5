//! Tension of the wire and motion of the load.

use scenario::plant::{self, StressStrain};

use crate::plants::GRAVITY;

/// Coefficients of wire mechanics and motion, Eq. (3)-(9).
#[derive(Clone, Debug)]
pub(super) struct Mechanics {
    law: StressStrain,
    /// Section of the wire, `Awire`, m².
    section_square_metres: f64,
    /// Stiffness as austenite, `EA · Awire`, N.
    austenite_stiffness: f64,
    /// Stiffness as martensite, `EM · Awire`, N.
    martensite_stiffness: f64,
    /// Yield strain of martensite, `ε_my`.
    yield_strain: f64,
    /// Recoverable elongation `Δ`, m.
    recoverable_elongation: f64,
    /// Inverse of the length as austenite, `1 / l0` with `l0 = l_wire − Δ`, 1/m.
    inverse_austenite_length: f64,
    /// Inverse of the transmission, `1 / n` with `n = r2 / r1`.
    inverse_transmission: f64,
    /// Inertia of the pulley as a mass at the load, `J / r2²`, kg.
    pulley_mass: f64,
    /// Mass of the load, `mL`, kg.
    load: f64,
    /// Viscous friction `c`, N s/m.
    damping: f64,
}

/// Load of the wire.
#[derive(Clone, Copy, Debug)]
pub(super) struct Load {
    /// Weight `mL g`, N.
    weight_newtons: f64,
    /// Inertia of pulley and load, `J / r2² + mL`, kg.
    inertia_kilograms: f64,
}

impl Mechanics {
    pub(super) fn new(config: &plant::Mechanics) -> Self {
        let radius = 0.5 * config.wire_diameter_metres;
        let section = std::f64::consts::PI * radius * radius;
        let elongation = config.recoverable_strain * config.wire_length_metres;
        let outer = config.outer_pulley_radius_metres;
        Self {
            law: config.stress_strain,
            section_square_metres: section,
            austenite_stiffness: config.austenite_modulus_pascals * section,
            martensite_stiffness: config.martensite_modulus_pascals * section,
            yield_strain: config.martensite_yield_strain,
            recoverable_elongation: elongation,
            inverse_austenite_length: 1.0 / (config.wire_length_metres - elongation),
            inverse_transmission: config.inner_pulley_radius_metres / outer,
            pulley_mass: config.pulley_inertia_kilogram_square_metres / (outer * outer),
            load: config.load_kilograms,
            damping: config.damping_newton_seconds_per_metre,
        }
    }

    /// Returns `ε = (Δ − x/n) / l0`; ageing reduces `Δ`.
    #[inline]
    fn strain(&self, position_metres: f64, strain_factor: f64) -> f64 {
        (self.recoverable_elongation * strain_factor - position_metres * self.inverse_transmission)
            * self.inverse_austenite_length
    }

    /// Returns the load with the added mass; it is never negative.
    #[inline]
    pub(super) fn load(&self, added_load_kilograms: f64) -> Load {
        let load = (self.load + added_load_kilograms).max(0.0);
        Load {
            weight_newtons: load * GRAVITY,
            inertia_kilograms: self.pulley_mass + load,
        }
    }

    /// Returns `T2 = Awire σ` in N. Eq. (9) reduces `σ` to `(1 − ξ) EA ε`; the full law, Eq. (3)-(5), adds the
    /// martensite's `ξ EM min(ε, ε_my)`. A wire cannot push (PAPER E6).
    #[inline]
    pub(super) fn tension_newtons(
        &self,
        martensite_fraction: f64,
        position_metres: f64,
        strain_factor: f64,
    ) -> f64 {
        self.tension_at(
            martensite_fraction,
            self.strain(position_metres, strain_factor),
        )
    }

    #[inline]
    fn tension_at(&self, martensite_fraction: f64, strain: f64) -> f64 {
        let strain = strain.max(0.0);
        let austenite = (1.0 - martensite_fraction) * self.austenite_stiffness * strain;
        match self.law {
            StressStrain::AusteniteOnly => austenite,
            StressStrain::Full => {
                let elastic = strain.min(self.yield_strain);
                austenite + martensite_fraction * self.martensite_stiffness * elastic
            }
        }
    }

    /// Returns `σ` in Pa.
    fn stress_pascals(&self, martensite_fraction: f64, strain: f64) -> f64 {
        self.tension_at(martensite_fraction, strain) / self.section_square_metres
    }

    /// Returns `K0 = EA Awire / l0`, Eq. (9): the stiffness of the wire as austenite.
    pub(super) fn stiffness_newtons_per_metre(&self) -> f64 {
        self.austenite_stiffness * self.inverse_austenite_length
    }

    /// Returns the fastest rate of Eq. (7), with the load removed and the wire at its stiffest. It is the natural
    /// frequency `sqrt(K / n² / m)` or the damping's `c / m`, whichever is higher.
    pub(super) fn fastest_rate_per_second(&self) -> f64 {
        let stiffness = self.austenite_stiffness.max(self.martensite_stiffness)
            * self.inverse_austenite_length
            * self.inverse_transmission
            * self.inverse_transmission;
        let natural = libm::sqrt(stiffness / self.pulley_mass);
        natural.max(self.damping / self.pulley_mass)
    }

    /// Returns `ẍ` in m/s², Eq. (7): `(J/r2² + mL) ẍ + c ẋ = −mL g + T2/n`, without the stop.
    #[inline]
    pub(super) fn acceleration(
        &self,
        tension_newtons: f64,
        velocity_metres_per_second: f64,
        load: &Load,
    ) -> f64 {
        let force = tension_newtons * self.inverse_transmission
            - load.weight_newtons
            - self.damping * velocity_metres_per_second;
        force / load.inertia_kilograms
    }
}

/// Returns the stress `σ` in Pa at a strain `ε`, by Eq. (3)-(5) or by Eq. (9).
pub fn stress_pascals(config: &plant::Mechanics, martensite_fraction: f64, strain: f64) -> f64 {
    Mechanics::new(config).stress_pascals(martensite_fraction, strain)
}

/// Returns whether the load rests on its stop at `x = 0` (PAPER E6).
#[inline]
pub(super) fn is_resting(position_metres: f64, velocity: f64, acceleration: f64) -> bool {
    position_metres <= 0.0 && velocity <= 0.0 && acceleration <= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mechanics(law: StressStrain) -> Mechanics {
        Mechanics::new(&plant::Mechanics {
            stress_strain: law,
            ..plant::Mechanics::default()
        })
    }

    /// `K0 = EA Awire / l0` = 16 362 N/m and `K = K0 (1 − ξ)`, Eq. (9).
    #[test]
    fn stiffness_is_that_of_equation_9() {
        let mechanics = mechanics(StressStrain::AusteniteOnly);
        for fraction in [0.0, 0.25, 0.9] {
            let pulled = mechanics.tension_newtons(fraction, 0.0, 1.0);
            let stiffness = pulled / mechanics.recoverable_elongation;
            assert!((stiffness - 16_362.46 * (1.0 - fraction)).abs() < 0.01);
        }
    }

    /// Eq. (5) inverts the full law on both sides of `ε_my`.
    #[test]
    fn the_full_law_is_the_inverse_of_equation_5() {
        let mechanics = mechanics(StressStrain::Full);
        let section = std::f64::consts::PI * 1e-8;
        let (ea, em, yield_strain, fraction) = (75e9, 28e9, 0.0025, 0.4);
        for position in [0.0, 0.03, 0.055, 0.0575, 0.0599] {
            let stress = mechanics.tension_newtons(fraction, position, 1.0) / section;
            let strain = (0.006 - position / 10.0) / 0.144;
            let expected = if strain <= yield_strain {
                stress / (fraction * em + (1.0 - fraction) * ea)
            } else {
                (stress - fraction * em * yield_strain) / ((1.0 - fraction) * ea)
            };
            assert!((strain - expected).abs() < 1e-12, "{strain} {expected}");
        }
    }

    #[test]
    fn a_slack_wire_does_not_push() {
        for law in [StressStrain::AusteniteOnly, StressStrain::Full] {
            assert_eq!(mechanics(law).tension_newtons(0.3, 0.061, 1.0), 0.0);
        }
    }

    #[test]
    fn a_load_cannot_weigh_less_than_nothing() {
        let mechanics = mechanics(StressStrain::AusteniteOnly);
        let load = mechanics.load(-1.0);
        assert_eq!(mechanics.acceleration(0.0, 0.0, &load), 0.0);
    }
}
