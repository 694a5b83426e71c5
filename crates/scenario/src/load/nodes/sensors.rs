//! Checks the sensors, and the plausibility of their positions.

use crate::check::Check;
use crate::error::Problem;
use crate::rig::nodes::{RigNode, Sensor};
use dbc::names::is_name;
use dbc::{Quantity, Unit};

/// Largest number of converter steps in a count of the position: 16 bits over 60 mm are steps of 0.9 micrometres.
const STEPS_OF_A_COUNT: f64 = 2.0;

impl Check<'_> {
    /// Checks that ranges begin below their ends, and that units are known.
    pub(super) fn sensors(&mut self) {
        for (name, node) in &self.rig.node {
            let Some(sensor) = &node.sensor else {
                continue;
            };
            let path = |key: &str| format!("node.{name}.{key}");
            let quantity = node.measured_quantity();
            let Quantity { name: signal, unit } = &quantity;
            if !is_name(unit.word()) {
                let message = format!("`{unit}` is no unit");
                let label = "a word, as names of ports end in: degrees";
                self.at(&path("sensor.unit"), message, label);
                continue;
            }
            let path_of_signal = path("sensor.signal");
            if !is_name(signal) {
                let message = format!("`{signal}` is not the name of a signal");
                let label = "a word, as in signal = \"speed\"";
                self.at(&path_of_signal, message, label);
            } else if quantity.is_ambiguous() {
                let message = format!("`{signal}` is the name of something else of a loop");
                let label = "another word, as in signal = \"speed\"";
                self.at(&path_of_signal, message, label);
            }
            if *unit != Unit::Millimetres && (sensor.min.is_none() || sensor.max.is_none()) {
                let message = format!("the sensor of `{name}` has no range");
                let label = format!("`min` and `max` are missing, in {unit}");
                self.at_key(&path("sensor"), message, label);
                continue;
            }
            self.add(self.increment(name, node, sensor));
            let plausible = node.plausible.unwrap_or_default();
            let [lowest, highest] = sensor.range();
            for (part, min, max) in [
                ("sensor", Some(lowest), Some(highest)),
                ("plausible", plausible.min, plausible.max),
            ] {
                let (Some(min), Some(max)) = (min, max) else {
                    continue;
                };
                // The schema has refused a value that is no number.
                if max <= min {
                    let message = format!("the range of `{name}` ends where it has not begun");
                    let label = format!("must be above {min}, its lowest");
                    let problem =
                        self.document
                            .problem(&path(&format!("{part}.max")), message, label);
                    let lowest = path(&format!("{part}.min"));
                    self.problems.push(if self.document.has(&lowest) {
                        problem.with_place(self.document.span(&lowest), "the lowest")
                    } else {
                        problem
                    });
                }
            }
        }
    }

    /// Checks the count of the drive's position: its 32 bits must hold the ends of the range, and it must resolve the converter's
    /// steps.
    fn increment(&self, name: &str, node: &RigNode, sensor: &Sensor) -> Option<Problem> {
        if !node.is_ours() {
            let path = format!("node.{name}.sensor.position_increment");
            return sensor.position_increment.map(|increment| {
                let message = format!("the counts of `{name}` are its maker's");
                let label = format!("write position.increments_per_unit = {}", 1.0 / increment);
                self.document.problem(&path, message, label)
            });
        }
        let unit = node.measured_quantity().unit;
        let increment = sensor.position_increment.unwrap_or(1.0 / unit.counts());
        let [lowest, highest] = sensor.range();
        let step = (highest - lowest) / libm::exp2(sensor.resolution_bits().into());
        let farthest = lowest.abs().max(highest.abs());
        let too_many = farthest / increment > f64::from(i32::MAX);
        // A range that ends before it begins is another problem.
        if step <= 0.0 || step >= increment / STEPS_OF_A_COUNT && !too_many {
            return None;
        }
        let path = match sensor.position_increment {
            Some(_) => format!("node.{name}.sensor.position_increment"),
            None => format!("node.{name}.sensor"),
        };
        let message = if too_many {
            format!("{farthest} {unit} are more counts of {increment} than 32 bits hold")
        } else {
            format!(
                "one step of the sensor of `{name}` is {step:.3e} {unit}, and a count of its position {increment}"
            )
        };
        let right = libm::pow(10.0, libm::floor(libm::log10(step)));
        let label = format!("write position_increment = {right}");
        Some(self.document.problem(&path, message, label))
    }
}
