//! Tolerances within which two runs agree.

use std::str::FromStr;

use crate::verdict::Verdict;
use dbc::names::SET_POINT;
use dbc::{Quantities, UNIT, symbol_of};
use plan::ControlLoop;
use recording::timeline::Timeline;
use scenario::metrics::METRICS;

/// Relative tolerance of a metric, if that is more than the tolerance of its unit.
const METRIC_SHARE: f64 = 0.05;
/// Tolerance of the set-point, which follows from the scenario and differs only if the scenarios do.
const SET_POINT_TOLERANCE: f64 = 1e-3;

/// Tolerance of signals in a loop's unit, as a part of the sensor's range: about four steps of a 10-bit converter.
const SHARE_OF_RANGE: f64 = 1.0 / 240.0;
/// Tolerance of metrics in a loop's unit, as a part of the sensor's range.
const METRIC_SHARE_OF_RANGE: f64 = 1.0 / 1000.0;

/// Tolerances of other units: the uncertainty of measurement and cycle time. Signals in further units are shown and not judged:
/// currents, velocities and the parts of the law swing about their means, each run with a phase of its own, and their effect is
/// judged by temperature, position and metrics.
const UNIT_TOLERANCES: [(&str, f64); 3] = [("degC", 1.0), ("g", 0.1), ("", PLAIN_TOLERANCE)];
/// Prefix of signals that are not judged either, since they follow the current.
const SATURATION: &str = "saturation_";

/// Part of the names of metrics of several loops together.
const CONTOUR: &str = "contour_error_";
/// Prefix of the names of metrics of the true position.
const TRUE: &str = "true_";

/// Tolerance of numbers without a unit.
const PLAIN_TOLERANCE: f64 = 0.02;

/// Tolerances of metrics, by the unit in their names.
const METRIC_TOLERANCES: [(&str, f64); 4] = [
    ("milliseconds", 0.5),
    ("seconds", 0.01),
    ("percent", 0.5),
    ("amperes", 0.01),
];

/// Tolerance that the user gave.
#[derive(Clone, Debug, PartialEq)]
pub struct GivenTolerance {
    name: String,
    value: f64,
}

impl FromStr for GivenTolerance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, value) = text.split_once('=').ok_or("expected: name=value")?;
        let value: f64 = value.parse().map_err(|_| format!("{value} is no number"))?;
        // A comparison that is never true would let everything pass.
        if value.is_nan() || value < 0.0 {
            return Err("a tolerance is 0 or more; inf for any difference".to_owned());
        }
        Ok(Self {
            name: name.to_owned(),
            value,
        })
    }
}

/// Unit of a loop, and range of its sensor.
pub struct Scale {
    /// Prefix of the names of the loop; empty if there is only one.
    prefix: String,
    quantities: Quantities,
    range: f64,
}

impl Scale {
    /// Returns the scale of a loop.
    pub fn of(one: &ControlLoop) -> Self {
        let wiring = &one.trial.wiring;
        let [min, max] = wiring.feedback.range();
        Self {
            prefix: one.prefix(),
            quantities: wiring.quantities.clone(),
            range: max - min,
        }
    }
}

/// Tolerances of a comparison.
pub struct Tolerances<'a> {
    /// Tolerances that the user gave; the last one for the same name counts.
    pub given: &'a [GivenTolerance],
    /// Time by which a value may come earlier or later.
    pub time_seconds: f64,
    /// Scale of each loop.
    pub scales: Vec<Scale>,
}

impl Tolerances<'_> {
    /// Returns the first name that neither run has, since it is mistyped.
    pub fn unknown_name(&self, timelines: &[Timeline], verdicts: [&Verdict; 2]) -> Option<String> {
        let has_signal = |timeline: &Timeline, name: &str| {
            let in_loop = name.strip_prefix(&timeline.prefix()).unwrap_or(name);
            let unit = symbol_of(name);
            let mut columns = timeline.columns.iter();
            columns.any(|column| column.name == in_loop || column.unit == unit)
        };
        let is_known = |name: &str| {
            let mut metrics = verdicts.iter().flat_map(|verdict| &verdict.metrics);
            timelines.iter().any(|one| has_signal(one, name))
                || metrics.any(|metric| metric.name == name)
        };
        let unknown = self.given.iter().find(|given| !is_known(&given.name));
        unknown.map(|unknown| unknown.name.clone())
    }

    fn given(&self, name: &str) -> Option<f64> {
        let given = self.given.iter().rfind(|given| given.name == name);
        given.map(|given| given.value)
    }

    /// Returns the user's tolerance for a unit, named by its word or as the DBC writes it.
    fn given_for(&self, unit: &str) -> Option<f64> {
        let mut given = self.given.iter().filter(|_| !unit.is_empty());
        let given = given.rfind(|given| symbol_of(&given.name) == unit);
        given.map(|given| given.value)
    }

    /// Returns the tolerance of a signal: the user's for it, or for it in all loops, the user's for its unit, or the default.
    pub(super) fn for_signal(&self, prefix: &str, name: &str, unit: &str) -> f64 {
        let in_loop = self.given(&format!("{prefix}{name}"));
        let given = in_loop
            .or_else(|| self.given(name))
            .or_else(|| self.given_for(unit));
        given.unwrap_or_else(|| self.signal_default(prefix, name, unit))
    }

    fn signal_default(&self, prefix: &str, name: &str, unit: &str) -> f64 {
        let scale = self.scales.iter().find(|scale| scale.prefix == prefix);
        match scale {
            Some(scale) if name == scale.quantities.name(SET_POINT) => SET_POINT_TOLERANCE,
            _ if name.starts_with(SATURATION) => f64::INFINITY,
            Some(scale) if unit == scale.quantities.feedback.unit.symbol() => {
                SHARE_OF_RANGE * scale.range
            }
            _ => {
                let known = UNIT_TOLERANCES.iter().find(|(known, _)| *known == unit);
                known.map_or(f64::INFINITY, |(_, tolerance)| *tolerance)
            }
        }
    }

    /// Returns the default for a metric in the unit of its loop, by the sensor's range; for a contour, by the largest range of
    /// its loops.
    fn position_metric_default(&self, name: &str) -> Option<f64> {
        let scales = self.scales.iter();
        let ranges = scales.filter(|scale| {
            let of_loop = name.strip_prefix(&scale.prefix);
            let in_loop = of_loop.map(|row| row.strip_prefix(TRUE).unwrap_or(row));
            let contour = format!("{CONTOUR}{}_", scale.quantities.feedback.unit.word());
            name.contains(&contour)
                || METRICS.iter().any(|metric| {
                    let is_in_unit = metric.name.contains(UNIT);
                    is_in_unit && in_loop == Some(scale.quantities.name(metric.name).as_str())
                })
        });
        let range = ranges.map(|scale| scale.range).reduce(f64::max);
        range.map(|range| METRIC_SHARE_OF_RANGE * range)
    }

    pub(super) fn for_metric(&self, name: &str, values: [Option<f64>; 2]) -> f64 {
        self.given(name).unwrap_or_else(|| {
            let parts: Vec<&str> = name.split(['_', ' ']).collect();
            let mut by_unit = METRIC_TOLERANCES.iter();
            let of_unit = by_unit.find(|(unit, _)| parts.contains(unit));
            let default = self.position_metric_default(name);
            let default = default.or(of_unit.map(|(_, tolerance)| *tolerance));
            let sizes = values.into_iter().flatten().map(f64::abs);
            let share = METRIC_SHARE * sizes.fold(0.0, f64::max);
            f64::max(default.unwrap_or(PLAIN_TOLERANCE), share)
        })
    }
}

#[cfg(test)]
mod tests {
    use dbc::Unit;

    use super::*;

    fn scale(prefix: &str, unit: Unit, range: f64) -> Scale {
        Scale {
            prefix: prefix.to_owned(),
            quantities: Quantities::of_position(unit),
            range,
        }
    }

    #[test]
    fn what_is_in_a_loop_s_unit_is_judged_by_its_sensor_s_range() {
        let of = |given: &[GivenTolerance]| {
            let celsius = Unit::Other("celsius".to_owned());
            let tolerances = Tolerances {
                given,
                time_seconds: 0.0,
                scales: vec![
                    scale("lift.", Unit::Millimetres, 60.0),
                    scale("oven.", celsius, 240.0),
                    scale("turn.", Unit::Degrees, 120.0),
                ],
            };
            let signal = |prefix, name, unit| tolerances.for_signal(prefix, name, unit);
            let metric = |name| tolerances.for_metric(name, [None, None]);
            [
                signal("lift.", "position_millimetres", "mm"),
                signal("oven.", "position_celsius", "degC"),
                signal("turn.", "position_degrees", "deg"),
                signal("turn.", "set_point_degrees", "deg"),
                signal("turn.", "wire_temperature_celsius", "degC"),
                // A further length is not judged.
                signal("turn.", "travel_millimetres", "mm"),
                metric("lift.tracking_error_millimetres_rms"),
                metric("turn.tracking_error_degrees_rms"),
                metric("turn.true_tracking_error_degrees_rms"),
                metric("turn.sine_phase_degrees"),
                metric("turn_swing.contour_error_degrees_max"),
            ]
        };
        let unjudged = f64::INFINITY;
        let default = [
            0.25, 1.0, 0.5, 0.001, 1.0, unjudged, 0.06, 0.12, 0.12, 0.02, 0.12,
        ];
        let same = |found: [f64; 11], wanted: [f64; 11]| {
            let pairs = found.into_iter().zip(wanted);
            let is_same = |(a, b): (f64, f64)| a == b || (a - b).abs() < 1e-12;
            assert!(pairs.clone().all(is_same), "{found:?}");
        };
        same(of(&[]), default);
        let mut wanted = default;
        (wanted[2], wanted[3]) = (2.0, 2.0);
        for given in ["deg=2", "degrees=2"] {
            same(of(&[given.parse().unwrap()]), wanted);
        }
        wanted[3] = default[3];
        same(of(&["turn.position_degrees=2".parse().unwrap()]), wanted);
    }

    #[test]
    fn tolerances_are_the_users_first() {
        let given = ["mm=0.5", "position_millimetres=2"].map(|text| text.parse().unwrap());
        let tolerances = Tolerances {
            given: &given,
            time_seconds: 0.0,
            scales: vec![scale("", Unit::Millimetres, 60.0)],
        };
        let for_signal = |name, unit| tolerances.for_signal("", name, unit);
        assert_eq!(for_signal("position_millimetres", "mm"), 2.0);
        assert_eq!(for_signal("true_position_millimetres", "mm"), 0.5);
        assert_eq!(for_signal("martensite_fraction", ""), 0.02);
        assert_eq!(for_signal("current_amperes", "A"), f64::INFINITY);
        assert_eq!(for_signal("saturation_on_stop", ""), f64::INFINITY);
        let given = ["position_millimetres=2", "x.position_millimetres=3"]
            .map(|text| text.parse().unwrap());
        let two_loops = Tolerances {
            given: &given,
            time_seconds: 0.0,
            scales: Vec::new(),
        };
        let in_loop = |prefix| two_loops.for_signal(prefix, "position_millimetres", "mm");
        assert_eq!([in_loop("x."), in_loop("y.")], [3.0, 2.0]);
        assert_eq!(
            tolerances.for_metric("settling_time_seconds", [Some(0.1), None]),
            0.01
        );
        assert_eq!(
            tolerances.for_metric("settling_time_seconds", [Some(1.0), Some(2.0)]),
            0.1
        );
        for bad in ["mm", "mm=x", "mm=-1", "mm=nan"] {
            assert!(bad.parse::<GivenTolerance>().is_err(), "{bad}");
        }
    }
}
