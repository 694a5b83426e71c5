//! `canrig compare`: where two runs diverge.
//!
//! A value differs by its distance from the range of the other run's values a little before and after. So a value that
//! only comes a moment earlier or later does not differ.

mod difference;
mod page;
mod shared;
mod tolerance;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;

use self::difference::{Comparison, MetricDifference, SignalDifference};
use self::shared::{Deviation, Shared, outside};
use self::tolerance::Tolerances;
use super::{Recorded, RecordedError, refuse};
use crate::console::{complain, say};
use crate::exit::Exit;
use judge::verdict::{Metric, Verdict};
use recording::timeline::Timeline;
use worlds::catalogue::catalogue;

pub use tolerance::GivenTolerance;

/// The name under which the set-point is compared; it tells whether both runs wanted the same.
const SET_POINT: &str = "set_point_millimetres";

/// What the controller tells about itself comes with every tenth cycle only, so it may be that much later.
const TOLD_BY_CONTROLLER: [&str; 2] = ["reference_", "estimated_"];
const CONTROLLER_CYCLES: usize = 10;

/// Arguments of `compare`.
#[derive(Args, Debug)]
pub struct CompareArgs {
    /// A run folder, or a log beside its scenario.toml
    pub a: PathBuf,
    /// Another one
    pub b: PathBuf,
    /// How far a signal, a metric, or all signals of a unit may differ: `position_millimetres=0.5`, `degC=2`, `A=0.1`;
    /// `inf` for not judged. Without it: 0.25 mm, 1 degC, 0.02 for fractions and states; currents, velocities and the
    /// parts of the law are shown only, since they swing
    #[arg(long, value_name = "NAME=VALUE", value_delimiter = ',')]
    pub tolerance: Vec<GivenTolerance>,
    /// How much earlier or later a value may come
    #[arg(long, value_name = "MILLISECONDS", default_value_t = 5.0, value_parser = milliseconds)]
    pub time_tolerance: f64,
    /// Write a page with plots of what differs
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Print the comparison as JSON
    #[arg(long)]
    pub json: bool,
}

/// A time from 0 to 10 s.
fn milliseconds(text: &str) -> Result<f64, String> {
    let value: f64 = text
        .parse()
        .map_err(|_| "a number of milliseconds is expected")?;
    if (0.0..=10_000.0).contains(&value) {
        Ok(value)
    } else {
        Err("0 to 10000 ms are possible".to_owned())
    }
}

/// Compares two recordings; exit code 0 when they agree, 1 when they diverge.
#[must_use]
pub fn compare(args: &CompareArgs) -> Exit {
    match compared(args) {
        Ok((comparison, page)) => {
            if args.json {
                say(&serde_json::to_string_pretty(&comparison).expect("plain data"));
            } else {
                say(&page::to_text(&comparison));
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
        let recorded = Recorded::load(path, None, catalogue())?;
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
            page::to_html(&comparison, &names, [&a_line, &b_line]),
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
