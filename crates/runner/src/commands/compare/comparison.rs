//! Two runs, compared signal by signal and metric by metric.

use std::collections::BTreeSet;
use std::iter;

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
            let none;
            let other = match column.is_used() == other.is_used() {
                true => &other.values,
                // Zeros that stand for no value are not compared with values.
                false => {
                    none = iter::repeat_n(f64::NAN, other.values.len()).collect();
                    &none
                }
            };
            signals.push(signal(tolerances, what, shared, &column.values, other));
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
    let [a, b] = shared.values(a, b);
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

#[cfg(test)]
mod tests {
    use super::*;
    use dbc::scenario_clock::ScenarioClock;
    use recording::capture::{Capture, Watch};
    use recording::timeline::decode;
    use rig::setup::Setup;
    use scenario::Scenario;
    use worlds::catalogue::catalogue;
    use worlds::lockstep;

    fn simulated() -> Timeline {
        let text = "schema = 1\nname = \"compared\"\nduration_seconds = 0.5\n[controller.pid]\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        let scenario = Scenario::parse(text, "c.toml", |_| unreachable!("no table")).unwrap();
        let setup = Setup::new(scenario, catalogue());
        let (watch, clock) = (Watch::default(), ScenarioClock::new(&setup.database));
        let mut capture = Capture::in_memory(clock.unwrap(), &watch);
        lockstep::simulate(&setup, &mut capture).unwrap();
        decode(&capture.finish().unwrap().0, &setup).unwrap()
    }

    #[test]
    fn runs_of_different_length_do_not_agree() {
        let whole = simulated();
        let verdict = Verdict::incomplete("compared", 1, "");
        let tolerances = Tolerances {
            given: &[],
            time_seconds: 0.0,
        };
        let compared = |a, b| compare_runs(&tolerances, (a, &verdict), (b, &verdict));
        let same = compared(&whole, &whole);
        assert_eq!((same.agrees, same.remarks.len()), (true, 0));
        // One cycle more or less is no difference, half of the run is.
        let (shorter, half) = (whole.before(0.498), whole.before(0.25));
        assert!(compared(&whole, &shorter).agrees);
        for (a, b) in [(&whole, &half), (&half, &whole)] {
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
}
