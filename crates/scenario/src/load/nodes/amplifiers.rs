//! What an amplifier can be commanded.

use super::Check;
use crate::current::COUNTS_MAX;
use crate::error::Problem;

impl Check<'_> {
    /// Currents that 16 bits hold in thousandths of the rated one.
    pub(super) fn amplifiers(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        for (name, node) in &self.rig.node {
            let Some(amplifier) = &node.amplifier else {
                continue;
            };
            let range = amplifier.range();
            let most = COUNTS_MAX / range.counts_per_ampere();
            for (key, current) in [("min", range.min), ("max", range.max)] {
                // A rated current of nothing was found by the schema.
                if current.abs() <= most || range.rated <= 0.0 {
                    continue;
                }
                let path = format!("node.{name}.amplifier.{key}");
                let message = format!(
                    "a command of {current} A does not fit its frame, which counts thousandths of {} A",
                    range.rated
                );
                // In milliamperes, as 0x6075 has it, so that what is written is enough.
                let rated = libm::ceil(current.abs() / COUNTS_MAX * 1e6) / 1e3;
                let label = format!("write rated = {rated:.3} or more");
                problems.push(self.document.problem(&path, message, label));
            }
        }
        problems
    }
}
