//! Condition of a plant: of its wire or motor, and of its mechanics.

use scenario::fault::Fault;

use crate::plant::{Faults, Inputs};

/// Condition of a plant; sound by default. A motor has no wire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Condition {
    /// Factor of `R`.
    pub(super) resistance_factor: f64,
    /// Factor of `Δ`.
    pub(super) recoverable_strain_factor: f64,
    /// Whether the wire is broken, and carries neither load nor current.
    pub(super) is_wire_broken: bool,
    /// Whether the load cannot move.
    pub(super) is_pulley_jammed: bool,
    /// Whether the load has fallen off the pulley.
    pub(super) is_load_dropped: bool,
}

impl Default for Condition {
    fn default() -> Self {
        Self {
            resistance_factor: 1.0,
            recoverable_strain_factor: 1.0,
            is_wire_broken: false,
            is_pulley_jammed: false,
            is_load_dropped: false,
        }
    }
}

impl Condition {
    /// Returns the condition at a scenario time.
    pub(super) fn at(faults: &Faults, time_seconds: f64) -> Self {
        let aged = |factor: &str| {
            let factors = faults.of("ageing").map(|ageing| {
                let progress = progress(ageing, time_seconds);
                1.0 + progress * (ageing.number(factor) - 1.0)
            });
            factors.product()
        };
        Self {
            resistance_factor: aged("resistance_factor"),
            recoverable_strain_factor: aged("recoverable_strain_factor"),
            is_wire_broken: faults.any_acts("broken_wire", time_seconds),
            is_pulley_jammed: faults.any_acts("jammed_pulley", time_seconds),
            is_load_dropped: faults.any_acts("dropped_load", time_seconds),
        }
    }

    /// Returns the current that heats a sound wire as much as this one.
    pub(super) fn heating_amperes(&self, current_amperes: f64) -> f64 {
        match self.resistance_factor {
            1.0 => current_amperes,
            factor => current_amperes * libm::sqrt(factor),
        }
    }

    /// Returns the mass that is added to the load, or that removes all of it.
    pub(super) fn added_load_kilograms(&self, inputs: &Inputs) -> f64 {
        if self.is_load_dropped {
            f64::NEG_INFINITY
        } else {
            inputs.added_load_kilograms
        }
    }
}

/// Returns the progress of the ageing: 0 at its start, 1 from its end on.
fn progress(ageing: &Fault, time_seconds: f64) -> f64 {
    let (Some(from), Some(until)) = (ageing.from_seconds, ageing.until_seconds) else {
        return 0.0;
    };
    ((time_seconds - from) / (until - from)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::tests::faults;

    #[test]
    fn ageing_is_even_and_stays() {
        let faults = faults(
            "[[fault.plant.ageing]]\nfrom_seconds = 1.0\nuntil_seconds = 3.0\nresistance_factor = 2.0\n\
             recoverable_strain_factor = 0.5\n",
        );
        let factors = |time| {
            let condition = Condition::at(&faults, time);
            (
                condition.resistance_factor,
                condition.recoverable_strain_factor,
            )
        };
        assert_eq!(factors(0.5), (1.0, 1.0));
        assert_eq!(factors(2.0), (1.5, 0.75));
        assert_eq!(factors(9.0), (2.0, 0.5));
    }
}
