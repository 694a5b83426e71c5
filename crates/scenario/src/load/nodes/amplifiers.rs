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
            let output = node.commanded_quantity();
            let is_current = output == Quantity::current();
            let path = format!("node.{name}.amplifier");
            if output.is_ambiguous() {
                let message = format!(
                    "`{}` is the name of something else of a recording",
                    output.key()
                );
                let label = "an amplifier cannot drive a port of this name and unit";
                self.at(&format!("{path}.port"), message, label);
            }
            if !is_current && !node.is_ours() {
                let message = format!(
                    "the amplifier of the external drive `{name}` gives `{}`, not a current",
                    output.words()
                );
                let label = "an external drive must give a current, because a real drive's limits are in amperes";
                let path = format!("{path}.port");
                self.at(&path, message, label);
            }
            if !is_current && amplifier.i2t.is_some() {
                let message = format!(
                    "the amplifier of `{name}` gives `{}`, not a current",
                    output.words()
                );
                let label =
                    "remove `i2t`: only an amplifier that gives a current has I²t protection";
                self.at_key(&format!("{path}.i2t"), message, label);
            }
            let range = amplifier.range();
            let (symbol, rated) = (output.unit.symbol(), amplifier.rated());
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
