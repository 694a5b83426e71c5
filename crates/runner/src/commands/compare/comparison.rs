//! Two runs, compared signal by signal and metric by metric.

use std::collections::BTreeSet;

use super::difference::{Comparison, MetricDifference, SignalDifference};
use super::shared::{Shared, SignalDeviation, outside};
use super::tolerance::{SET_POINT, Tolerances};
use judge::verdict::{Metric, Verdict};
use recording::timeline::Timeline;

/// What the controller publishes of itself comes with every tenth cycle only, so it may be that much later.
const PUBLISHED_BY_CONTROLLER: [&str; 2] = ["reference_", "estimated_"];
const CONTROLLER_CYCLES: usize = 10;

/// Compares two runs. The names in the tolerances were checked before.
pub(super) fn compare_runs(
    tolerances: &Tolerances<'_>,
    (a, a_verdict): (&Timeline, &Verdict),
    (b, b_verdict): (&Timeline, &Verdict),
) -> Comparison {
    let shared = Shared::of(a, b);
    let mut remarks = shared.remarks(a, b);
    if a.period_seconds != b.period_seconds {
        remarks.push(format!(
            "the cycles differ: {} s and {} s, so nothing can be compared",
            a.period_seconds, b.period_seconds
        ));
    }
    let is_whole = remarks.is_empty();
    let signals = signals(tolerances, &shared, a, b);
    let metrics = metrics(tolerances, a_verdict, b_verdict);
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

/// The signals that both runs have, what differs most by its tolerance first.
fn signals(
    tolerances: &Tolerances<'_>,
    shared: &Shared,
    a: &Timeline,
    b: &Timeline,
) -> Vec<SignalDifference> {
    let (a_set_point, b_set_point) = (&a.set_point_millimetres, &b.set_point_millimetres);
    let set_point = signal(
        tolerances,
        (SET_POINT, "mm"),
        shared,
        a_set_point,
        b_set_point,
    );
    let mut signals = vec![set_point];
    for column in &a.columns {
        if let Some(other) = b.column(&column.name) {
            let what = (column.name.as_str(), column.unit.as_str());
            let (a, b) = match column.is_used() == other.is_used() {
                true => (&column.values, &other.values),
                // Zeros that stand for no value are not compared with values.
                false => (&column.values, &vec![f64::NAN; other.values.len()]),
            };
            signals.push(signal(tolerances, what, shared, a, b));
        }
    }
    signals.sort_by(|left, right| right.weight().total_cmp(&left.weight()));
    signals
}

fn signal(
    tolerances: &Tolerances<'_>,
    (name, unit): (&str, &str),
    shared: &Shared,
    a: &[f64],
    b: &[f64],
) -> SignalDifference {
    let (a, b): (Vec<f64>, Vec<f64>) = shared
        .rows
        .iter()
        .map(|(left, right)| (a[*left], b[*right]))
        .unzip();
    let tolerance = tolerances.of_signal(name, unit);
    let is_published = PUBLISHED_BY_CONTROLLER
        .iter()
        .any(|start| name.starts_with(start));
    let later = if is_published { CONTROLLER_CYCLES } else { 0 };
    let reach = shared.reach(tolerances.time_seconds) + later;
    let (one, other) = (outside(&a, &b, reach), outside(&b, &a, reach));
    let differences = one.iter().zip(&other).map(|(one, other)| one.max(*other));
    let deviation = SignalDeviation::of(&a, &b, shared.period_seconds);
    let mut difference = SignalDifference {
        name: name.to_owned(),
        unit: unit.to_owned(),
        tolerance: tolerance.is_finite().then_some(tolerance),
        largest: None,
        largest_at_seconds: None,
        rms: deviation.as_ref().map(|deviation| deviation.rms),
        lag_seconds: deviation.map(|deviation| deviation.lag_seconds),
        diverges_at_seconds: None,
        beyond_percent: 0.0,
    };
    difference.judge(
        differences.zip(shared.time_seconds.iter().copied()),
        tolerance,
    );
    difference
}

fn metrics(tolerances: &Tolerances<'_>, a: &Verdict, b: &Verdict) -> Vec<MetricDifference> {
    let names: BTreeSet<&str> = [a, b]
        .into_iter()
        .flat_map(|verdict| &verdict.metrics)
        .map(|metric| metric.name.as_str())
        .collect();
    let differences = names.into_iter().map(|name| {
        let values = [a, b].map(|verdict| value(&verdict.metrics, name));
        let tolerance = tolerances.of_metric(name, values);
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

fn value(metrics: &[Metric], name: &str) -> Option<f64> {
    metrics
        .iter()
        .find(|metric| metric.name == name)
        .and_then(|metric| metric.value)
}
