//! Two runs, compared signal by signal and metric by metric.
//!
//! A value differs by its distance from the range of the other run's values a little before and after. A value that only comes a
//! moment earlier or later does not differ.

mod difference;
mod shared;
mod tolerance;

use std::collections::BTreeSet;

use crate::verdict::Verdict;
use recording::timeline::{Column, Series, Timeline};
use recording::work::Pass;
use shared::{Shared, deviation, outside, reach};

pub use difference::{Comparison, MetricDifference, SignalDifference};
pub use tolerance::{GivenTolerance, Scale, Tolerances};

/// Cycles by which a term of a law may be late: it comes with every tenth cycle only.
const CONTROLLER_CYCLES: usize = 10;
/// Time to compare all signals, in passes over the frames.
pub const SIGNAL_PASSES: u64 = 4;

/// Compares two runs, each with its loops. The names in the tolerances have been checked already.
///
/// # Panics
/// A run has no loop.
pub fn compare_runs(
    tolerances: &Tolerances<'_>,
    (a, a_verdict): (&[Timeline], &Verdict),
    (b, b_verdict): (&[Timeline], &Verdict),
) -> Comparison {
    // The loops of a run share its cycles.
    let (one, other) = (&a[0], &b[0]);
    let shared = Shared::of(one, other);
    let mut remarks = Vec::from_iter(shared.remark(one, other));
    if one.period_seconds != other.period_seconds {
        remarks.push(format!(
            "the cycles differ: {} s and {} s, so nothing can be compared",
            one.period_seconds, other.period_seconds
        ));
    }
    remarks.extend(remark_on_loops(a, b));
    let is_whole = remarks.is_empty();
    let mut signals = Vec::new();
    let columns = a.iter().map(|timeline| timeline.columns.len() as u64);
    let pass = |_| Pass::new(columns.clone().sum());
    let mut passes = Vec::from_iter((0..SIGNAL_PASSES).map(pass));
    for one in a {
        if let Some(other) = b.iter().find(|other| other.loop_name == one.loop_name) {
            let done = || passes.iter_mut().for_each(|pass| pass.advance(1));
            let found = signals_of_loop(tolerances, &shared, [one, other], done);
            signals.extend(found);
        }
    }
    signals.sort_by(|left, right| right.weight().total_cmp(&left.weight()));
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

/// Returns a remark if the runs do not have the same loops.
fn remark_on_loops(a: &[Timeline], b: &[Timeline]) -> Option<String> {
    let [a, b] = [a, b].map(|loops| {
        let names = loops.iter().map(|timeline| match &*timeline.loop_name {
            "" => "one",
            name => name,
        });
        Vec::from_iter(names).join(", ")
    });
    (a != b).then(|| format!("the runs have not the same loops: A has {a}, B has {b}"))
}

/// Compares the signals that both runs have of a loop.
fn signals_of_loop(
    tolerances: &Tolerances<'_>,
    shared: &Shared,
    [a, b]: [&Timeline; 2],
    mut done: impl FnMut(),
) -> Vec<SignalDifference> {
    let prefix = &a.prefix();
    let mut signals = Vec::new();
    for column in &a.columns {
        if let Some(other) = b.column(&column.name) {
            signals.push(signal(tolerances, prefix, shared, [column, other]));
        }
        done();
    }
    signals
}

fn signal(
    tolerances: &Tolerances<'_>,
    prefix: &str,
    shared: &Shared,
    [column, other]: [&Column; 2],
) -> SignalDifference {
    let [a, b] = shared.values(&column.values, &other.values);
    let (name, unit) = (&column.name, &column.unit);
    let tolerance = tolerances.for_signal(prefix, name, unit);
    let later = if column.is_term { CONTROLLER_CYCLES } else { 0 };
    let reach = reach(tolerances.time_seconds, shared.period_seconds) + later;
    let (one, other) = (outside(&a, &b, reach), outside(&b, &a, reach));
    let pairs = one.iter().zip(&other);
    let differences = pairs.map(|(one, other)| one.abs().max(other.abs()));
    let (rms, lag_seconds) = deviation(&a, &b, shared.period_seconds).unzip();
    let mut difference = SignalDifference {
        name: format!("{prefix}{name}"),
        unit: unit.clone(),
        tolerance: tolerance.is_finite().then_some(tolerance),
        rms,
        lag_seconds,
        reach,
        ..SignalDifference::default()
    };
    difference.judge(differences.zip(&shared.time_seconds), tolerance);
    difference
}

/// Returns the times of the shared cycles, and the differences that are judged: that of a value of B from those of A a little before
/// and after, or that of a value of A from those of B, whichever is larger; positive where B is above A.
pub fn distances(
    signal: &SignalDifference,
    [a, b]: [&Timeline; 2],
    [a_values, b_values]: [&Series<f64>; 2],
) -> (Series<f64>, Series<f64>) {
    let shared = Shared::of(a, b);
    let [a, b] = shared.values(a_values, b_values);
    let (of_b, of_a) = (outside(&b, &a, signal.reach), outside(&a, &b, signal.reach));
    let larger = of_b.iter().zip(&of_a).map(|(of_b, of_a)| {
        if of_b.is_nan() || of_a.abs() > of_b.abs() {
            -of_a
        } else {
            of_b
        }
    });
    (shared.time_seconds, larger.collect())
}

fn metrics(tolerances: &Tolerances<'_>, a: &Verdict, b: &Verdict) -> Vec<MetricDifference> {
    let all = a.metrics.iter().chain(&b.metrics);
    let names = BTreeSet::from_iter(all.map(|metric| metric.name.as_str()));
    let differences = names.into_iter().map(|name| {
        let value = |verdict: &Verdict| {
            let mut metrics = verdict.metrics.iter();
            metrics.find(|metric| metric.name == name)?.value
        };
        let (a, b) = (value(a), value(b));
        let tolerance = tolerances.for_metric(name, [a, b]);
        MetricDifference {
            name: name.to_owned(),
            a,
            b,
            tolerance,
            agrees: match (a, b) {
                (Some(a), Some(b)) => (a - b).abs() <= tolerance,
                (None, None) => true,
                _ => tolerance.is_infinite(),
            },
        }
    });
    differences.collect()
}

#[cfg(test)]
mod tests {
    use std::slice;

    use super::*;
    use crate::tests::{frames, step_plan};
    use crate::verdict::Metric;
    use recording::timeline::{Column, decode};

    #[test]
    fn runs_of_different_length_do_not_agree() {
        let plan = step_plan("");
        let timelines = decode(&frames(500, |_| Some(10.0)).into(), &plan).unwrap();
        let whole = &timelines[0];
        let verdict = Verdict::incomplete("compared", 1, "");
        let tolerances = Tolerances {
            given: &[],
            time_seconds: 0.0,
            scales: vec![Scale::of(plan.only_loop().unwrap())],
        };
        let compared = |a: &Timeline, b: &Timeline| {
            let [a, b] = [a, b].map(slice::from_ref);
            compare_runs(&tolerances, (a, &verdict), (b, &verdict))
        };
        let same = compared(whole, whole);
        assert_eq!((same.agrees, same.remarks.len()), (true, 0));
        // One cycle more or less is no difference, but half of the run is.
        let (shorter, half) = (whole.piece(0..498), whole.piece(0..250));
        assert!(compared(whole, &shorter).agrees);
        for (a, b) in [(whole, &half), (&half, whole)] {
            let different = compared(a, b);
            assert!(!different.agrees);
            let remark = &different.remarks[0];
            assert!(
                remark.starts_with("the runs share 249 cycles only"),
                "{remark}"
            );
            assert!(different.signals.iter().all(SignalDifference::agrees));
        }
    }

    #[test]
    fn a_term_may_be_ten_cycles_late_since_it_comes_with_every_tenth() {
        let plan = step_plan("");
        let timelines = decode(&frames(500, |_| Some(10.0)).into(), &plan).unwrap();
        let tolerances = Tolerances {
            given: &[],
            time_seconds: 0.0,
            scales: vec![Scale::of(plan.only_loop().unwrap())],
        };
        let verdict = Verdict::incomplete("compared", 1, "");
        let largest = |is_term: bool, late_cycles: usize| {
            let [a, b] = [200, 200 + late_cycles].map(|begin| {
                let mut timeline = timelines[0].clone();
                let values = (0..timeline.cycle.len()).map(|row| f64::from(u8::from(row >= begin)));
                timeline.columns.push(Column {
                    name: "of_a_law".to_owned(),
                    unit: String::new(),
                    is_term,
                    values: values.collect(),
                });
                [timeline]
            });
            let compared = compare_runs(&tolerances, (&a, &verdict), (&b, &verdict));
            let mut signals = compared.signals.iter();
            signals.find(|one| one.name == "of_a_law").unwrap().largest
        };
        assert_eq!(
            [largest(true, 10), largest(true, 11)],
            [Some(0.0), Some(1.0)]
        );
        assert_eq!(
            [largest(false, 0), largest(false, 1)],
            [Some(0.0), Some(1.0)]
        );
    }

    #[test]
    fn a_difference_is_positive_where_the_second_run_is_above_the_first() {
        let plan = step_plan("");
        let run = |position: fn(u32) -> Option<f64>| {
            decode(&frames(501, position).into(), &plan).unwrap()
        };
        let a = run(|cycle| match cycle {
            100 => Some(13.0),
            300 => Some(11.0),
            _ => Some(10.0),
        });
        let b = run(|cycle| match cycle {
            200 => Some(12.0),
            300 => None,
            _ => Some(10.0),
        });
        let tolerances = Tolerances {
            given: &[],
            time_seconds: 0.001,
            scales: vec![Scale::of(plan.only_loop().unwrap())],
        };
        let verdict = Verdict::incomplete("compared", 1, "");
        let compared = compare_runs(&tolerances, (&a, &verdict), (&b, &verdict));
        let mut signals = compared.signals.iter();
        let signal = signals.find(|one| one.name == "position_millimetres");
        let signal = signal.unwrap();
        let found = (signal.largest, signal.largest_at_seconds);
        assert_eq!(found, (Some(3.0), Some(0.1)));
        // 3 of 500 cycles.
        assert!((signal.beyond_percent - 0.6).abs() < 1e-9);
        let values = [a[0].position(), b[0].position()];
        let (times, differences) = distances(signal, [&a[0], &b[0]], values);
        let all = times.iter().zip(&differences);
        let others = all.filter(|(_, difference)| *difference != 0.0);
        let expected = [(0.1, -3.0), (0.2, 2.0), (0.3, -1.0)];
        assert_eq!(Vec::from_iter(others), expected);
    }

    #[test]
    fn metrics_of_either_run_are_compared_by_their_tolerances() {
        let plan = step_plan("");
        let tolerances = Tolerances {
            given: &[],
            time_seconds: 0.0,
            scales: vec![Scale::of(plan.only_loop().unwrap())],
        };
        let verdict = |rows: &[(&str, Option<f64>)]| {
            let row = |(name, value): &(&str, Option<f64>)| {
                Metric::new(*name, value.ok_or_else(|| "none".to_owned()), None)
            };
            Verdict {
                metrics: rows.iter().map(row).collect(),
                ..Verdict::incomplete("compared", 1, "")
            }
        };
        let a = verdict(&[
            ("settling_time_seconds", Some(0.2)),
            ("overshoot_percent", Some(4.0)),
            ("sine_gain", None),
        ]);
        let b = verdict(&[
            ("settling_time_seconds", Some(0.21)),
            ("overshoot_percent", Some(4.6)),
            ("bandwidth_hertz", Some(2.0)),
        ]);
        let differences = metrics(&tolerances, &a, &b);
        let found = differences
            .iter()
            .map(|one| (&*one.name, one.a, one.b, one.agrees));
        let expected = [
            ("bandwidth_hertz", None, Some(2.0), false),
            ("overshoot_percent", Some(4.0), Some(4.6), false),
            ("settling_time_seconds", Some(0.2), Some(0.21), true),
            ("sine_gain", None, None, true),
        ];
        assert_eq!(Vec::from_iter(found), expected);
    }
}
