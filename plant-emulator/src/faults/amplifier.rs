//! Faults of the amplifier.

use scenario::fault::Faults;

/// Returns the output for a command. The fault "dead" has priority over "stuck on", and that over "saturated".
pub(super) fn output(faults: &Faults, time_seconds: f64, commanded: f64) -> f64 {
    if faults.any_acts("dead", time_seconds) {
        return 0.0;
    }
    let mut stuck = faults.of("stuck_on");
    if let Some(stuck) = stuck.find(|fault| fault.acts_at(time_seconds)) {
        return stuck.number("{command}_{command_unit}");
    }
    let saturated = faults
        .of("saturated")
        .filter(|fault| fault.acts_at(time_seconds));
    saturated
        .map(|fault| fault.number("{command}_{command_unit}_max"))
        .fold(commanded, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::tests::faults;

    #[test]
    fn dead_wins_over_stuck_on_over_saturated() {
        let window = "from_seconds = 1.0\nuntil_seconds = 2.0\n";
        let saturated =
            format!("[[fault.amplifier.saturated]]\n{window}current_amperes_max = 0.3\n");
        let stuck =
            format!("{saturated}[[fault.amplifier.stuck_on]]\n{window}current_amperes = 0.9\n");
        let dead = format!("{stuck}[[fault.amplifier.dead]]\n{window}");
        let current = |tables: &str, time| output(&faults(tables), time, 0.7);
        assert_eq!(current(&saturated, 0.5), 0.7);
        assert_eq!(current(&saturated, 1.0), 0.3);
        assert_eq!(current(&saturated, 2.0), 0.7);
        assert_eq!(current(&stuck, 1.5), 0.9);
        assert_eq!(current(&dead, 1.5), 0.0);
    }
}
