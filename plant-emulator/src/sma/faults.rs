//! Faults of wire and mechanics.

use scenario::fault::{Fault, Faults};

use super::condition::Condition;

/// Wire and mechanics at a scenario time.
pub(super) fn condition(faults: &Faults, time_seconds: f64) -> Condition {
    let aged = |factor: &str| {
        let factors = faults.of("ageing").map(|ageing| {
            let progress = progress(ageing, time_seconds);
            1.0 + progress * (ageing.number(factor) - 1.0)
        });
        factors.product()
    };
    Condition {
        resistance_factor: aged("resistance_factor"),
        recoverable_strain_factor: aged("recoverable_strain_factor"),
        is_wire_broken: faults.any_acts("broken_wire", time_seconds),
        is_pulley_jammed: faults.any_acts("jammed_pulley", time_seconds),
        is_load_dropped: faults.any_acts("dropped_load", time_seconds),
    }
}

/// From 0 at the start of the ageing to 1 at its end, and so for ever.
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
            let condition = condition(&faults, time);
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
