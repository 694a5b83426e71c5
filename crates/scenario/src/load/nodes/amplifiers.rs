//! Checks the currents of amplifiers, and which amplifiers may have a protection or are external.

use crate::check::Check;
use dbc::Command;
use dbc::current::COUNTS_MAX;

impl Check<'_> {
    /// Checks that 16 bits hold the currents, in thousandths of the rated one.
    pub(super) fn amplifiers(&mut self) {
        for (name, node) in &self.rig.node {
            let Some(amplifier) = &node.amplifier else {
                continue;
            };
            let command = node.command_quantity();
            let is_current = command == Command::Current;
            let path = format!("node.{name}.amplifier");
            if !is_current && !node.is_ours() {
                let message = format!("`{name}` is external and would give a {}", command.signal());
                let label = "the limits of a real drive are those of a current";
                let path = format!("{path}.port");
                self.at(&path, message, label);
            }
            if !is_current && amplifier.i2t.is_some() {
                let message = format!("`{name}` gives a {}", command.signal());
                let label = "i2t is the protection of an amplifier that gives a current";
                self.at_key(&format!("{path}.i2t"), message, label);
            }
            let range = amplifier.range();
            let symbol = command.symbol();
            let most = COUNTS_MAX / range.counts_per_ampere();
            for (key, current) in [("min", range.min), ("max", range.max)] {
                // The schema has refused a rated current of 0.
                if current.abs() <= most || range.rated <= 0.0 {
                    continue;
                }
                let path = format!("{path}.{key}");
                let message = format!(
                    "a command of {current} {symbol} does not fit its frame, which counts thousandths of {} {symbol}",
                    range.rated
                );
                // In milliamperes, as in 0x6075, so that the suggested current is large enough.
                let rated = libm::ceil(current.abs() / COUNTS_MAX * 1e6) / 1e3;
                let label = format!("write rated = {rated:.3} or more");
                self.at(&path, message, label);
            }
        }
    }
}
