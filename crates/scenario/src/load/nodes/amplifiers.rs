//! Checks the ranges of amplifiers, and which amplifiers may have a protection or are external.

use crate::check::Check;
use dbc::Quantity;
use dbc::command_range::COUNTS_MAX;

impl Check<'_> {
    /// Checks that 16 bits hold the commands, in thousandths of the rated value.
    pub(super) fn amplifiers(&mut self) {
        for (name, node) in &self.rig.node {
            let Some(amplifier) = &node.amplifier else {
                continue;
            };
            let given = node.commanded_quantity();
            let is_current = given == Quantity::current();
            let path = format!("node.{name}.amplifier");
            if !is_current && !node.is_ours() {
                let message = format!("`{name}` is external and would give a {}", given.words());
                let label = "the limits of a real drive are those of a current";
                let path = format!("{path}.port");
                self.at(&path, message, label);
            }
            if !is_current && amplifier.i2t.is_some() {
                let message = format!("`{name}` gives a {}", given.words());
                let label = "i2t is the protection of an amplifier that gives a current";
                self.at_key(&format!("{path}.i2t"), message, label);
            }
            let range = amplifier.range();
            let (symbol, rated) = (given.unit.symbol(), amplifier.rated());
            let most = COUNTS_MAX / range.counts_per_unit;
            for (key, command) in [("min", range.min), ("max", range.max)] {
                // The schema has refused a rated value of 0.
                if command.abs() <= most || rated <= 0.0 {
                    continue;
                }
                let path = format!("{path}.{key}");
                let message = format!(
                    "a command of {command} {symbol} does not fit its frame, which counts thousandths of {rated} {symbol}"
                );
                // In thousandths, as in 0x6075, so that the suggested value is large enough.
                let rated = libm::ceil(command.abs() / COUNTS_MAX * 1e6) / 1e3;
                let label = format!("write rated = {rated:.3} or more");
                self.at(&path, message, label);
            }
        }
    }
}
