//! `canrig compare`: where two runs diverge.
//!
//! A value differs by its distance from the range of the other run's values a little before and after. So a value that
//! only comes a moment earlier or later does not differ.

use std::collections::BTreeSet;
use std::path::Path;
use std::str::FromStr;

use serde::Serialize;

use super::args::CompareArgs;
use super::{Recorded, RecordedError, refuse};
use crate::console::{complain, say};
use crate::exit::Exit;
use crate::report::comparison;
use crate::timeline::Timeline;
use crate::verdict::{Metric, Verdict};

/// The tolerance of a metric by its value, where that is more than its unit's.
const METRIC_SHARE: f64 = 0.05;
/// Runs that share fewer cycles than this, by the longer one, do not agree.
const SHARED_PERCENT_MIN: f64 = 99.0;

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

/// What the controller tells about itself comes with every tenth cycle only, so it may be that much later.
const TOLD_BY_CONTROLLER: [&str; 2] = ["reference_", "estimated_"];
const CONTROLLER_CYCLES: usize = 10;

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

/// How a signal of two runs differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SignalDifference {
    /// The signal.
    pub name: String,
    /// Its unit in the DBC.
    pub unit: String,
    /// What it may differ by; none for any difference.
    pub tolerance: Option<f64>,
    /// The largest difference; none where one of the runs has no values.
    pub largest: Option<f64>,
    /// When that is.
    pub largest_at_seconds: Option<f64>,
    /// When it first differs by more than the tolerance.
    pub diverges_at_seconds: Option<f64>,
    /// Share of the cycles in which it does.
    pub beyond_percent: f64,
}

impl SignalDifference {
    /// Whether it stays within its tolerance.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.diverges_at_seconds.is_none()
    }

    /// The largest difference by the tolerance, to sort by.
    fn weight(&self) -> f64 {
        match (self.largest, self.tolerance) {
            (Some(0.0), _) => 0.0,
            (Some(largest), Some(tolerance)) => largest / tolerance,
            // What is not judged comes after all that is, and before what is the same.
            (Some(_), None) => f64::MIN_POSITIVE,
            (None, _) => 0.0,
        }
    }
}

/// How a metric of two runs differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricDifference {
    /// The metric.
    pub name: String,
    /// Its value in the first run.
    pub a: Option<f64>,
    /// Its value in the second run.
    pub b: Option<f64>,
    /// What it may differ by.
    pub tolerance: f64,
    /// Whether it stays within that, or is missing in both.
    pub agrees: bool,
}

/// Two runs side by side.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Whether nothing differs by more than its tolerance.
    pub agrees: bool,
    /// What is not a signal and not a metric.
    pub remarks: Vec<String>,
    /// Cycles that both runs have.
    pub shared_cycles: usize,
    /// All signals, what differs most by its tolerance first.
    pub signals: Vec<SignalDifference>,
    /// All metrics.
    pub metrics: Vec<MetricDifference>,
}

/// Compares two recordings; exit code 0 when they agree, 1 when they diverge.
#[must_use]
pub fn compare(args: &CompareArgs) -> Exit {
    match compared(args) {
        Ok((comparison, page)) => {
            if args.json {
                say(&serde_json::to_string_pretty(&comparison).expect("plain data"));
            } else {
                say(&comparison::to_text(&comparison));
            }
            if let Some((place, text)) = page
                && let Err(error) = std::fs::write(place, text)
            {
                complain(&format!(
                    "canrig: {} cannot be written: {error}",
                    place.display()
                ));
                return Exit::BenchFailed;
            }
            if let Some(place) = args.output.as_ref().filter(|_| !args.json) {
                say(&format!("plots  {}", place.display()));
            }
            if comparison.agrees {
                Exit::Pass
            } else {
                Exit::VerdictFailed
            }
        }
        Err(error) => error.tell(),
    }
}

/// Why nothing was compared.
enum CompareError {
    Recorded(RecordedError),
    NoSuchName(String),
}

impl<E: Into<RecordedError>> From<E> for CompareError {
    fn from(error: E) -> Self {
        Self::Recorded(error.into())
    }
}

impl CompareError {
    fn tell(self) -> Exit {
        match self {
            Self::Recorded(error) => refuse(error),
            Self::NoSuchName(name) => {
                complain(&format!(
                    "canrig: --tolerance: no signal, metric or unit is called {name}"
                ));
                Exit::Usage
            }
        }
    }
}

type Page<'a> = Option<(&'a Path, String)>;

fn compared(args: &CompareArgs) -> Result<(Comparison, Page<'_>), CompareError> {
    let [a, b] = [&args.a, &args.b].map(|path| -> Result<_, RecordedError> {
        let recorded = Recorded::load(path, None)?;
        let timeline = recorded.timeline()?;
        let verdict = recorded.judge(&timeline)?;
        Ok((recorded, timeline, verdict))
    });
    let ((a, a_line, a_verdict), (b, b_line, b_verdict)) = (a?, b?);
    let tolerances = Tolerances {
        given: &args.tolerance,
        time_seconds: args.time_tolerance / 1e3,
    };
    tolerances.check(&a_line, [&a_verdict, &b_verdict])?;
    let mut comparison = tolerances.compare((&a_line, &a_verdict), (&b_line, &b_verdict));
    for recorded in [&a, &b] {
        if let Some(broken) = &recorded.log.broken {
            comparison
                .remarks
                .push(format!("{} breaks off: {broken}", recorded.path.display()));
        }
    }
    let page = args.output.as_deref().map(|place| {
        let names = [&a, &b].map(|recorded| recorded.path.display().to_string());
        (
            place,
            comparison::to_html(&comparison, &names, [&a_line, &b_line]),
        )
    });
    Ok((comparison, page))
}

/// What may differ, and by how much.
struct Tolerances<'a> {
    given: &'a [GivenTolerance],
    time_seconds: f64,
}

impl Tolerances<'_> {
    /// A name that nothing has is a slip of the pen.
    fn check(&self, timeline: &Timeline, verdicts: [&Verdict; 2]) -> Result<(), CompareError> {
        let is_known = |name: &str| {
            let has_signal = timeline
                .columns
                .iter()
                .any(|column| column.name == name || column.unit == name);
            let metrics = verdicts.iter().flat_map(|verdict| &verdict.metrics);
            has_signal || name == SET_POINT || metrics.into_iter().any(|metric| metric.name == name)
        };
        match self.given.iter().find(|given| !is_known(&given.name)) {
            Some(unknown) => Err(CompareError::NoSuchName(unknown.name.clone())),
            None => Ok(()),
        }
    }

    fn given(&self, name: &str) -> Option<f64> {
        let given = self.given.iter().rfind(|given| given.name == name);
        given.map(|given| given.value)
    }

    /// The tolerance of a signal: the user's for it, the user's for its unit, or the default.
    fn of_signal(&self, name: &str, unit: &str) -> f64 {
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
        self.given(name).or_else(of_unit).unwrap_or_else(default)
    }

    fn of_metric(&self, name: &str, values: [Option<f64>; 2]) -> f64 {
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

    fn compare(
        &self,
        (a, a_verdict): (&Timeline, &Verdict),
        (b, b_verdict): (&Timeline, &Verdict),
    ) -> Comparison {
        let shared = Shared::of(a, b);
        let mut remarks = shared.remarks(a, b);
        let mut is_whole = remarks.is_empty();
        if a.period_seconds != b.period_seconds {
            remarks.push(format!(
                "the cycles differ: {} s and {} s, so nothing can be compared",
                a.period_seconds, b.period_seconds
            ));
            is_whole = false;
        }
        let mut signals = vec![self.signal(
            SET_POINT,
            "mm",
            &shared,
            &a.set_point_millimetres,
            &b.set_point_millimetres,
        )];
        for column in &a.columns {
            if let Some(other) = b.column(&column.name) {
                signals.push(self.signal(
                    &column.name,
                    &column.unit,
                    &shared,
                    &column.values,
                    &other.values,
                ));
            }
        }
        signals.sort_by(|left, right| right.weight().total_cmp(&left.weight()));
        let metrics = self.metrics(a_verdict, b_verdict);
        Comparison {
            agrees: is_whole
                && signals.iter().all(SignalDifference::agrees)
                && metrics.iter().all(|metric| metric.agrees),
            remarks,
            shared_cycles: shared.rows.len(),
            signals,
            metrics,
        }
    }

    fn signal(
        &self,
        name: &str,
        unit: &str,
        shared: &Shared,
        a: &[f64],
        b: &[f64],
    ) -> SignalDifference {
        let (a, b): (Vec<f64>, Vec<f64>) = shared
            .rows
            .iter()
            .map(|(left, right)| (a[*left], b[*right]))
            .unzip();
        let tolerance = self.of_signal(name, unit);
        let is_told = TOLD_BY_CONTROLLER
            .iter()
            .any(|start| name.starts_with(start));
        let reach = shared.reach(self.time_seconds) + if is_told { CONTROLLER_CYCLES } else { 0 };
        let (one, other) = (outside(&a, &b, reach), outside(&b, &a, reach));
        let differences = one
            .iter()
            .zip(&other)
            .map(|(one, other)| f64::max(*one, *other));
        let mut found = SignalDifference {
            name: name.to_owned(),
            unit: unit.to_owned(),
            tolerance: tolerance.is_finite().then_some(tolerance),
            largest: None,
            largest_at_seconds: None,
            diverges_at_seconds: None,
            beyond_percent: 0.0,
        };
        let (mut compared, mut beyond) = (0.0, 0.0);
        for (difference, time) in differences
            .zip(&shared.time_seconds)
            .filter(|(difference, _)| !difference.is_nan())
        {
            compared += 1.0;
            if found.largest.is_none_or(|largest| difference > largest) {
                (found.largest, found.largest_at_seconds) = (Some(difference), Some(*time));
            }
            if difference > tolerance {
                beyond += 1.0;
                found.diverges_at_seconds.get_or_insert(*time);
            }
        }
        if compared > 0.0 {
            found.beyond_percent = 100.0 * beyond / compared;
        }
        found
    }

    fn metrics(&self, a: &Verdict, b: &Verdict) -> Vec<MetricDifference> {
        let all: BTreeSet<&str> = [a, b]
            .into_iter()
            .flat_map(|verdict| &verdict.metrics)
            .map(|metric| metric.name.as_str())
            .collect();
        let differences = all.into_iter().map(|name| {
            let values = [a, b].map(|verdict| value(&verdict.metrics, name));
            let tolerance = self.of_metric(name, values);
            let agrees = match values {
                [Some(a), Some(b)] => (a - b).abs() <= tolerance,
                [None, None] => true,
                _ => tolerance.is_infinite(),
            };
            let [a, b] = values;
            MetricDifference {
                name: name.to_owned(),
                a,
                b,
                tolerance,
                agrees,
            }
        });
        differences.collect()
    }
}

/// The name under which the set-point is compared; it tells whether both runs wanted the same.
const SET_POINT: &str = "set_point_millimetres";

fn value(metrics: &[Metric], name: &str) -> Option<f64> {
    metrics
        .iter()
        .find(|metric| metric.name == name)
        .and_then(|metric| metric.value)
}

/// The cycles that both runs have, without the last of them.
struct Shared {
    /// Rows of the one and of the other.
    rows: Vec<(usize, usize)>,
    time_seconds: Vec<f64>,
    period_seconds: f64,
}

impl Shared {
    fn of(a: &Timeline, b: &Timeline) -> Self {
        let mut rows = Vec::new();
        let (mut left, mut right) = (0, 0);
        while let (Some(one), Some(other)) = (a.cycle.get(left), b.cycle.get(right)) {
            if one == other {
                rows.push((left, right));
            }
            left += usize::from(one <= other);
            right += usize::from(other <= one);
        }
        // In its last cycle a run is already stopped.
        rows.pop();
        Self {
            time_seconds: rows.iter().map(|(left, _)| a.time_seconds[*left]).collect(),
            rows,
            period_seconds: a.period_seconds,
        }
    }

    fn remarks(&self, a: &Timeline, b: &Timeline) -> Vec<String> {
        #[expect(
            clippy::cast_precision_loss,
            reason = "cycle counts stay far below 2^52"
        )]
        let percent =
            100.0 * self.rows.len() as f64 / a.cycle.len().max(b.cycle.len()).max(1) as f64;
        if percent >= SHARED_PERCENT_MIN {
            return Vec::new();
        }
        vec![format!(
            "the runs share {} cycles only: A has {} and ends at {:.3} s, B has {} and ends at {:.3} s",
            self.rows.len(),
            a.cycle.len(),
            a.end_seconds(),
            b.cycle.len(),
            b.end_seconds()
        )]
    }

    /// Rows before and after that count as the same time.
    fn reach(&self, time_seconds: f64) -> usize {
        let rows = libm::floor(time_seconds / self.period_seconds + 1e-6).clamp(0.0, 100_000.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped"
        )]
        let rows = rows as usize;
        rows
    }
}

/// How far each value lies outside the range of the others within `reach` rows; NaN where either has none.
fn outside(values: &[f64], others: &[f64], reach: usize) -> Vec<f64> {
    let (lows, highs) = (
        running(others, reach, |new, old| new <= old),
        running(others, reach, |new, old| new >= old),
    );
    let ranges = lows.into_iter().zip(highs);
    let distances = values.iter().zip(ranges).map(|(value, (low, high))| {
        // A value is NaN where it or the others are missing, which max would hide.
        if value.is_nan() || low.is_nan() {
            f64::NAN
        } else {
            f64::max(f64::max(low - value, value - high), 0.0)
        }
    });
    distances.collect()
}

/// The best value within `reach` places before and after each, in linear time: a queue holds those that may still win.
fn running(values: &[f64], reach: usize, beats: impl Fn(f64, f64) -> bool) -> Vec<f64> {
    let mut queue = std::collections::VecDeque::new();
    let mut best = Vec::with_capacity(values.len());
    let mut next = 0;
    for place in 0..values.len() {
        while next < values.len() && next <= place.saturating_add(reach) {
            let value = values[next];
            if !value.is_nan() {
                while queue.back().is_some_and(|(_, last)| beats(value, *last)) {
                    queue.pop_back();
                }
                queue.push_back((next, value));
            }
            next += 1;
        }
        while queue
            .front()
            .is_some_and(|(first, _)| first + reach < place)
        {
            queue.pop_front();
        }
        best.push(queue.front().map_or(f64::NAN, |(_, value)| *value));
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_later_value_is_not_a_different_one() {
        let step = |at: usize| -> Vec<f64> {
            (0..100)
                .map(|row| if row < at { 0.0 } else { 1.0 })
                .collect()
        };
        let most = |reach| {
            outside(&step(50), &step(53), reach)
                .into_iter()
                .fold(0.0, f64::max)
        };
        assert_eq!(most(3), 0.0);
        assert_eq!(most(2), 1.0);
    }

    #[test]
    fn missing_values_are_not_compared() {
        let found = outside(&[1.0, f64::NAN, 3.0], &[1.0, 5.0, f64::NAN], 0);
        assert_eq!(found[0], 0.0);
        assert!(found[1].is_nan() && found[2].is_nan());
    }

    #[test]
    fn tolerances_are_the_users_first() {
        let given = ["mm=0.5", "position_millimetres=2"].map(|text| text.parse().unwrap());
        let tolerances = Tolerances {
            given: &given,
            time_seconds: 0.0,
        };
        let of_signal = |name, unit| tolerances.of_signal(name, unit);
        assert_eq!(of_signal("position_millimetres", "mm"), 2.0);
        assert_eq!(of_signal("true_position_millimetres", "mm"), 0.5);
        assert_eq!(of_signal("martensite_fraction", ""), 0.02);
        assert_eq!(of_signal("current_amperes", "A"), f64::INFINITY);
        assert_eq!(of_signal("saturation_on_stop", ""), f64::INFINITY);
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

    proptest! {
        #[test]
        fn the_running_best_is_that_of_each_window(values in prop::collection::vec(prop_oneof![5 => -9.0..9.0f64, 1 => Just(f64::NAN)], 0..60), reach in 0usize..9) {
            let best = running(&values, reach, |new, old| new >= old);
            for (place, best) in best.iter().enumerate() {
                let window = &values[place.saturating_sub(reach)..(place + reach + 1).min(values.len())];
                let expected = window.iter().copied().filter(|value| !value.is_nan()).fold(f64::NAN, f64::max);
                prop_assert!(*best == expected || (best.is_nan() && expected.is_nan()));
            }
        }
    }
}
