//! What a sensor and the plausibility of its positions can be.

use super::Check;
use crate::error::Problem;
use crate::own::is_name;
use crate::port::{Measurand, Unit};

impl Check<'_> {
    /// Ranges that begin below where they end, and units that are words.
    pub(super) fn sensors(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        let drives = self.rig.node.iter();
        let drives = drives.filter_map(|(name, node)| Some((name, node, node.sensor.as_ref()?)));
        for (name, node, sensor) in drives {
            let path = |key: &str| format!("node.{name}.{key}");
            let measurand = node.measurand();
            let Measurand { signal, unit } = &measurand;
            if !is_name(unit.word()) {
                let message = format!("`{unit}` is no unit");
                let label = "a word, as names of ports end in: degrees";
                problems.push(self.document.problem(&path("sensor.unit"), message, label));
                continue;
            }
            let path_of_signal = path("sensor.signal");
            if !is_name(signal) {
                let message = format!("`{signal}` is not the name of a signal");
                let label = "a word, as in signal = \"speed\"";
                problems.push(self.document.problem(&path_of_signal, message, label));
            } else if measurand.is_ambiguous() {
                let message = format!("`{signal}` is the name of something else of a loop");
                let label = "another word, as in signal = \"speed\"";
                problems.push(self.document.problem(&path_of_signal, message, label));
            }
            if *unit != Unit::Millimetres && (sensor.min.is_none() || sensor.max.is_none()) {
                let message = format!("the sensor of `{name}` has no range");
                let label = format!("`min` and `max` are missing, in {unit}");
                problems.push(self.problem(&path("sensor"), message, label));
                continue;
            }
            let plausible = node.plausible.unwrap_or_default();
            for (part, min, max) in [
                ("sensor", sensor.min.or(Some(0.0)), sensor.max),
                ("plausible", plausible.min, plausible.max),
            ] {
                let (Some(min), Some(max)) = (min, max) else {
                    continue;
                };
                // What is no number was refused before.
                if max <= min {
                    let message = format!("the range of `{name}` ends where it has not begun");
                    let label = format!("must be above {min}, its lowest");
                    let problem =
                        (self.document).problem(&path(&format!("{part}.max")), message, label);
                    let lowest = path(&format!("{part}.min"));
                    problems.push(match self.document.has(&lowest) {
                        true => problem.with_place(self.document.span(&lowest), "the lowest"),
                        false => problem,
                    });
                }
            }
        }
        problems
    }
}
