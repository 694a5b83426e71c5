//! Faults of wire and mechanics.

use scenario::fault::any_acts;
use scenario::fault::plant::{Ageing, PlantFaults};

use super::condition::Condition;

/// Wire and mechanics at a scenario time.
pub(super) fn condition(faults: &PlantFaults, time_seconds: f64) -> Condition {
    let aged = |factor: fn(&Ageing) -> f64| {
        let factors = faults.ageing.iter().map(|ageing| {
            let progress = progress(ageing, time_seconds);
            1.0 + progress * (factor(ageing) - 1.0)
        });
        factors.product()
    };
    Condition {
        resistance_factor: aged(|ageing| ageing.resistance_factor),
        recoverable_strain_factor: aged(|ageing| ageing.recoverable_strain_factor),
        is_wire_broken: any_acts(&faults.broken_wire, time_seconds),
        is_pulley_jammed: any_acts(&faults.jammed_pulley, time_seconds),
        is_load_dropped: any_acts(&faults.dropped_load, time_seconds),
    }
}

/// From 0 at the start of the ageing to 1 at its end, and so for ever.
fn progress(ageing: &Ageing, time_seconds: f64) -> f64 {
    let Some(until_seconds) = ageing.until_seconds else {
        return 0.0;
    };
    let elapsed = time_seconds - ageing.from_seconds;
    (elapsed / (until_seconds - ageing.from_seconds)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ageing_is_even_and_stays() {
        let faults = PlantFaults {
            ageing: vec![Ageing {
                from_seconds: 1.0,
                until_seconds: Some(3.0),
                resistance_factor: 2.0,
                recoverable_strain_factor: 0.5,
            }],
            ..PlantFaults::default()
        };
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
