//! The amplifier's faults.

use scenario::fault::Lasting;
use scenario::fault::amplifier::AmplifierFaults;

/// The current that flows when some is commanded: dead before stuck on before saturated.
pub(super) fn current_amperes(
    faults: &AmplifierFaults,
    time_seconds: f64,
    commanded_amperes: f64,
) -> f64 {
    if faults.dead.iter().any(|fault| fault.acts_at(time_seconds)) {
        return 0.0;
    }
    let mut stuck = faults.stuck_on.iter();
    if let Some(stuck) = stuck.find(|fault| fault.acts_at(time_seconds)) {
        return stuck.current_amperes;
    }
    let saturated = faults
        .saturated
        .iter()
        .filter(|fault| fault.acts_at(time_seconds));
    saturated
        .map(|fault| fault.current_amperes_max)
        .fold(commanded_amperes, f64::min)
}

#[cfg(test)]
mod tests {
    use scenario::fault::amplifier::{Dead, Saturated, StuckOn};

    use super::*;

    #[test]
    fn dead_wins_over_stuck_on_over_saturated() {
        let window = (1.0, Some(2.0));
        let mut faults = AmplifierFaults {
            saturated: vec![Saturated {
                from_seconds: window.0,
                until_seconds: window.1,
                current_amperes_max: 0.3,
            }],
            ..AmplifierFaults::default()
        };
        let current = |faults: &AmplifierFaults, time| current_amperes(faults, time, 0.7);
        assert_eq!(current(&faults, 0.5), 0.7);
        assert_eq!(current(&faults, 1.0), 0.3);
        assert_eq!(current(&faults, 2.0), 0.7);
        faults.stuck_on.push(StuckOn {
            from_seconds: window.0,
            until_seconds: window.1,
            current_amperes: 0.9,
        });
        assert_eq!(current(&faults, 1.5), 0.9);
        faults.dead.push(Dead {
            from_seconds: window.0,
            until_seconds: window.1,
        });
        assert_eq!(current(&faults, 1.5), 0.0);
    }
}
