//! `canrig compare`: where two runs diverge.
//!
//! A value differs by its distance from the range of the other run's values a little before and after. So a value that
//! only comes a moment earlier or later does not differ.

mod shared;
mod tolerance;

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;

use self::shared::{Deviation, Shared, outside};
use self::tolerance::Tolerances;
use super::args::CompareArgs;
use super::{Recorded, RecordedError, refuse};
use crate::console::{complain, say};
use crate::exit::Exit;
use crate::report::comparison;
use crate::timeline::Timeline;
use crate::verdict::{Metric, Verdict};

pub use tolerance::GivenTolerance;

/// The name under which the set-point is compared; it tells whether both runs wanted the same.
const SET_POINT: &str = "set_point_millimetres";

/// What the controller tells about itself comes with every tenth cycle only, so it may be that much later.
const TOLD_BY_CONTROLLER: [&str; 2] = ["reference_", "estimated_"];
const CONTROLLER_CYCLES: usize = 10;

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
    /// Root mean square of the differences, cycle by cycle; none where the runs have no values in common.
    pub rms: Option<f64>,
    /// By how much the second run comes later, where a shift explains a part of the differences; 0 where none does.
    pub lag_seconds: Option<f64>,
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

impl Tolerances<'_> {
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
            rms: None,
            lag_seconds: None,
            diverges_at_seconds: None,
            beyond_percent: 0.0,
        };
        if let Some(deviation) = Deviation::of(&a, &b, shared.period_seconds) {
            found.rms = Some(deviation.rms);
            found.lag_seconds = Some(deviation.lag_seconds);
        }
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

fn value(metrics: &[Metric], name: &str) -> Option<f64> {
    metrics
        .iter()
        .find(|metric| metric.name == name)
        .and_then(|metric| metric.value)
}
