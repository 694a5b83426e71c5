//! By how much two runs may differ and still agree.

use std::str::FromStr;

use judge::verdict::Verdict;
use recording::timeline::OfLoop;

/// The name under which the set-point is compared; it shows whether both runs wanted the same.
pub(super) const SET_POINT: &str = "set_point_millimetres";

/// The tolerance of a metric by its value, where that is more than its unit's.
const METRIC_SHARE: f64 = 0.05;
/// The set-point follows from the scenario, so it differs only where the scenarios do.
const SET_POINT_TOLERANCE: f64 = 1e-3;

/// Tolerances by unit: what measurement and cycle time leave unknown. Signals of other units are shown and not judged:
/// currents, velocities and the parts of the law swing round their means, each run with a phase of its own, and what
/// comes of them is judged by temperature, position and metrics.
const UNIT_TOLERANCES: [(&str, f64); 4] = [
    // Four steps of the 10-bit converter over 60 mm.
    ("mm", 0.25),
    ("degC", 1.0),
    ("g", 0.1),
    ("", PLAIN_TOLERANCE),
];
/// Not judged either, since they follow the current.
const SATURATION: &str = "saturation_";

/// For numbers without a unit.
const PLAIN_TOLERANCE: f64 = 0.02;

/// Tolerances of metrics by the unit in their names.
const METRIC_TOLERANCES: [(&str, f64); 5] = [
    ("milliseconds", 0.5),
    ("seconds", 0.01),
    ("millimetres", 0.06),
    ("percent", 0.5),
    ("amperes", 0.01),
];

/// A tolerance that the user gave.
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

/// A tolerance for what neither run has.
pub(super) struct UnknownName(pub(super) String);

/// What may differ, and by how much.
pub(super) struct Tolerances<'a> {
    pub(super) given: &'a [GivenTolerance],
    pub(super) time_seconds: f64,
}

impl Tolerances<'_> {
    /// Refuses a name that nothing has: it is mistyped.
    pub(super) fn check(
        &self,
        loops: &[OfLoop<'_>],
        verdicts: [&Verdict; 2],
    ) -> Result<(), UnknownName> {
        let has_signal = |(prefix, timeline): &OfLoop<'_>, name: &str| {
            let own = name.strip_prefix(prefix).unwrap_or(name);
            let mut columns = timeline.columns.iter();
            own == SET_POINT || columns.any(|column| column.name == own || column.unit == name)
        };
        let is_known = |name: &str| {
            let mut metrics = verdicts.iter().flat_map(|verdict| &verdict.metrics);
            loops.iter().any(|one| has_signal(one, name))
                || metrics.any(|metric| metric.name == name)
        };
        match self.given.iter().find(|given| !is_known(&given.name)) {
            Some(unknown) => Err(UnknownName(unknown.name.clone())),
            None => Ok(()),
        }
    }

    fn given(&self, name: &str) -> Option<f64> {
        let given = self.given.iter().rfind(|given| given.name == name);
        given.map(|given| given.value)
    }

    /// The tolerance of a signal: the user's for it, or for it in all loops, the user's for its unit, or the default.
    pub(super) fn of_signal(&self, prefix: &str, name: &str, unit: &str) -> f64 {
        let of_loop = self.given(&format!("{prefix}{name}"));
        let of_unit = || {
            let named = Some(unit).filter(|unit| !unit.is_empty());
            named.and_then(|unit| self.given(unit))
        };
        let default = || match name {
            SET_POINT => SET_POINT_TOLERANCE,
            name if name.starts_with(SATURATION) => f64::INFINITY,
            _ => {
                let known = UNIT_TOLERANCES.iter().find(|(known, _)| *known == unit);
                known.map_or(f64::INFINITY, |(_, tolerance)| *tolerance)
            }
        };
        let given = of_loop.or_else(|| self.given(name));
        given.or_else(of_unit).unwrap_or_else(default)
    }

    pub(super) fn of_metric(&self, name: &str, values: [Option<f64>; 2]) -> f64 {
        self.given(name).unwrap_or_else(|| {
            let words: Vec<&str> = name.split(['_', ' ']).collect();
            let unit = METRIC_TOLERANCES
                .iter()
                .find(|(unit, _)| words.contains(unit));
            let largest = values
                .into_iter()
                .flatten()
                .map(f64::abs)
                .fold(0.0, f64::max);
            f64::max(
                unit.map_or(PLAIN_TOLERANCE, |(_, tolerance)| *tolerance),
                METRIC_SHARE * largest,
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_the_users_first() {
        let given = ["mm=0.5", "position_millimetres=2"].map(|text| text.parse().unwrap());
        let tolerances = Tolerances {
            given: &given,
            time_seconds: 0.0,
        };
        let of_signal = |name, unit| tolerances.of_signal("", name, unit);
        assert_eq!(of_signal("position_millimetres", "mm"), 2.0);
        assert_eq!(of_signal("true_position_millimetres", "mm"), 0.5);
        assert_eq!(of_signal("martensite_fraction", ""), 0.02);
        assert_eq!(of_signal("current_amperes", "A"), f64::INFINITY);
        assert_eq!(of_signal("saturation_on_stop", ""), f64::INFINITY);
        let given = ["position_millimetres=2", "x.position_millimetres=3"];
        let given = given.map(|text| text.parse().unwrap());
        let of_loops = Tolerances {
            given: &given,
            time_seconds: 0.0,
        };
        let of_loop = |prefix| of_loops.of_signal(prefix, "position_millimetres", "mm");
        assert_eq!([of_loop("x."), of_loop("y.")], [3.0, 2.0]);
        assert_eq!(
            tolerances.of_metric("settling_time_seconds", [Some(0.1), None]),
            0.01
        );
        assert_eq!(
            tolerances.of_metric("settling_time_seconds", [Some(1.0), Some(2.0)]),
            0.1
        );
        for bad in ["mm", "mm=x", "mm=-1", "mm=nan"] {
            assert!(bad.parse::<GivenTolerance>().is_err(), "{bad}");
        }
    }
}
