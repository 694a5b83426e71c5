//! The verdict of several loops that were played at once.

use plan::{Plan, each_once};
use scenario::contour::Contour;
use scenario::expect::{ExpectedRow, Limit};
use scenario::metrics::is_bus_metric;

use crate::metric::{Metric, Unstored};
use crate::verdict::{Outcome, Verdict};

/// Returns the rows of a verdict that have limits, in their order, each once. Rows of several loops begin with the loop's name. Those
/// on timing come last if `is_timed`, for a run in real time; a run in virtual time has none.
pub fn expected_rows(plan: &Plan, is_timed: bool) -> Vec<ExpectedRow> {
    let of_loops = plan.loops.iter().flat_map(|one| {
        let mut rows = one.trial.expected_rows();
        let own = rows.iter_mut().filter(|row| !is_bus_metric(&row.name));
        own.for_each(|row| row.name.insert_str(0, &one.prefix()));
        rows
    });
    let of_contours = plan.shared.contours.iter().flat_map(Contour::rows);
    let limited = of_contours.filter(|row| row.limit.is_some());
    let of_run = &plan.shared.run.expect;
    let timing = of_run.timing.limits().filter(|_| is_timed);
    let named = of_run.timing.rows().zip(timing);
    let timing = named.map(|(row, (_, limit))| of_run.row(row, Some(limit)));
    each_once(of_loops.chain(limited).chain(timing))
}

/// Returns the rows of a verdict that have limits, with their limits, except for those on timing.
pub fn limits(plan: &Plan) -> Vec<(String, Limit)> {
    let rows = expected_rows(plan, false).into_iter();
    rows.filter_map(|row| Some((row.name, row.limit?)))
        .collect()
}

/// Returns the verdict of a plan: that of the only loop, or those of several joined.
pub(crate) fn whole(plan: &Plan, verdicts: Vec<Verdict>) -> Verdict {
    let names = Vec::from_iter(plan.loops.iter().map(|one| one.name().to_owned()));
    if names == [""] {
        return verdicts.into_iter().next().expect("one for each loop");
    }
    let contours = plan.shared.contours.iter().flat_map(Contour::rows);
    let contours = Vec::from_iter(contours.map(|row| row.name));
    joined(names.into_iter().zip(verdicts).collect(), &contours)
}

/// Joins the verdicts of loops, each with the loop's name. Rows begin with the name of their loop, except for those of contours,
/// which `contour_rows` names. Rows that all loops share appear once.
///
/// # Panics
/// There is no loop.
fn joined(loops: Vec<(String, Verdict)>, contour_rows: &[String]) -> Verdict {
    let outcome = loops.iter().map(|(_, verdict)| verdict.outcome).max();
    let first = first_cause(&loops, outcome);
    let cause = first.and_then(|(_, verdict)| verdict.cause.clone());
    let reason = joined_reason(&loops, first);
    let mut verdicts = loops.iter().map(|(_, verdict)| verdict);
    let is_open_for_stalls = verdicts
        .clone()
        .filter(|verdict| verdict.outcome == Outcome::Inconclusive)
        .all(|verdict| verdict.is_open_for_stalls.0);
    let has_unexplained_breach = verdicts.any(|verdict| verdict.has_unexplained_breach.0);
    let mut shared: Vec<Metric> = Vec::new();
    let mut metrics = Vec::new();
    let mut contours = Vec::new();
    let mut whole = None;
    for (name, verdict) in loops {
        for metric in verdict.metrics.iter().cloned() {
            if contour_rows.contains(&metric.name) {
                contours.push(metric);
            } else if !is_bus_metric(&metric.name) {
                let name = format!("{name}.{}", metric.name);
                metrics.push(Metric { name, ..metric });
            } else if let Some(known) = shared.iter_mut().find(|one| one.name == metric.name) {
                // That a limit was missed counts more than that it is open or met, and these more than none.
                let open = |row: &Metric| [row.passed != Some(false), row.passed.is_some()];
                let rank = |row: &Metric| (row.limit.is_none(), open(row));
                if rank(&metric) < rank(known) {
                    *known = metric;
                }
            } else {
                shared.push(metric);
            }
        }
        whole.get_or_insert(verdict);
    }
    contours.sort_by_key(|metric| contour_rows.iter().position(|row| *row == metric.name));
    metrics.extend(contours);
    metrics.extend(shared);
    Verdict {
        outcome: outcome.expect("there is a loop"),
        reason,
        cause,
        metrics,
        is_open_for_stalls: Unstored(is_open_for_stalls),
        has_unexplained_breach: Unstored(has_unexplained_breach),
        // The loops share the facts of the run.
        ..whole.expect("there is a loop")
    }
}

/// Returns the loop with the earliest cause among those that decide.
fn first_cause(
    loops: &[(String, Verdict)],
    outcome: Option<Outcome>,
) -> Option<&(String, Verdict)> {
    let decides = |verdict: &Verdict| Some(verdict.outcome) == outcome && verdict.cause.is_some();
    let at = |verdict: &Verdict| verdict.cause.as_ref()?.at_seconds;
    let begin = |verdict: &Verdict| at(verdict).unwrap_or(f64::INFINITY);
    let causes = loops.iter().filter(|(_, verdict)| decides(verdict));
    causes.min_by(|(_, one), (_, other)| begin(one).total_cmp(&begin(other)))
}

/// Joins the reasons of the verdicts, that of one loop first. A reason of all loops appears once; others appear with the names of
/// their loops.
fn joined_reason(loops: &[(String, Verdict)], first: Option<&(String, Verdict)>) -> Option<String> {
    let mut reasons: Vec<(&str, Vec<&str>)> = Vec::new();
    let is_first = |name: &str| first.is_some_and(|(first, _)| first == name);
    let others = loops.iter().filter(|(name, _)| !is_first(name));
    for (name, verdict) in first.into_iter().chain(others) {
        let Some(reason) = verdict.reason.as_deref() else {
            continue;
        };
        match reasons.iter_mut().find(|(other, _)| *other == reason) {
            Some((_, names)) => names.push(name),
            None => reasons.push((reason, vec![name])),
        }
    }
    let told = reasons.into_iter().map(|(reason, names)| {
        if names.len() == loops.len() {
            reason.to_owned()
        } else {
            format!("{}: {reason}", names.join(", "))
        }
    });
    let told = Vec::from_iter(told);
    (!told.is_empty()).then(|| told.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(outcome: Outcome, metrics: &[(&str, f64)]) -> Verdict {
        let limit = Some(Limit {
            min: None,
            max: Some(10.0),
        });
        let rows = metrics
            .iter()
            .map(|(name, value)| Metric::new(*name, Ok(*value), limit));
        Verdict {
            outcome,
            reason: (outcome != Outcome::Pass).then(|| "because".to_owned()),
            metrics: rows.collect(),
            ..Verdict::incomplete("two", 1, "")
        }
    }

    fn two(x: Outcome, y: Outcome) -> Vec<(String, Verdict)> {
        let metrics = [("overshoot_percent", 1.0), ("bus_load_percent", 9.0)];
        [("x", x), ("y", y)]
            .map(|(name, outcome)| (name.to_owned(), verdict(outcome, &metrics)))
            .into()
    }

    #[test]
    fn rows_have_the_names_of_their_loops_and_those_of_the_bus_stand_once() {
        let whole = joined(two(Outcome::Pass, Outcome::Pass), &[]);
        let names = Vec::from_iter(whole.metrics.iter().map(|metric| metric.name.as_str()));
        assert_eq!(
            names,
            [
                "x.overshoot_percent",
                "y.overshoot_percent",
                "bus_load_percent"
            ]
        );
        assert_eq!((whole.outcome, whole.reason), (Outcome::Pass, None));
    }

    #[test]
    fn a_row_of_the_bus_is_that_of_the_loop_with_a_limit() {
        let load = |limit| Metric::new("bus_load_percent", Ok(9.0), limit);
        let limit = Some(Limit {
            min: None,
            max: Some(10.0),
        });
        let joined_rows = |x, y| {
            let mut loops = two(Outcome::Pass, Outcome::Pass);
            for ((_, verdict), row) in loops.iter_mut().zip([x, y]) {
                verdict.metrics = vec![row];
            }
            joined(loops, &[]).metrics
        };
        let joined_row = |x, y| joined_rows(load(x), load(y));
        assert_eq!(joined_row(None, None), [load(None)]);
        assert_eq!(joined_row(limit, None), [load(limit)]);
        assert_eq!(joined_row(None, limit), [load(limit)]);
        // That one loop missed it counts more than that the other one met it.
        let missed = Metric::new("bus_load_percent", Ok(11.0), limit);
        for (x, y) in [(load(limit), missed.clone()), (missed.clone(), load(limit))] {
            assert_eq!(joined_rows(x, y), std::slice::from_ref(&missed));
        }
    }

    #[test]
    fn one_loop_fails_all() {
        use Outcome::{Fail, Incomplete, Inconclusive, Pass};
        for (x, y, all) in [
            (Pass, Fail, Fail),
            (Fail, Inconclusive, Fail),
            (Inconclusive, Pass, Inconclusive),
            (Inconclusive, Incomplete, Incomplete),
        ] {
            assert_eq!(joined(two(x, y), &[]).outcome, all);
        }
        let reason = joined(two(Pass, Fail), &[]).reason;
        assert_eq!(reason.as_deref(), Some("y: because"));
        let reason = joined(two(Fail, Fail), &[]).reason;
        assert_eq!(reason.as_deref(), Some("because"));
    }

    #[test]
    fn contours_stand_behind_the_loops_in_the_order_of_the_scenario() {
        let rows = ["y_x.contour", "x_y.contour"].map(str::to_owned);
        let mut loops = two(Outcome::Pass, Outcome::Pass);
        for ((_, verdict), row) in loops.iter_mut().zip(rows.iter().rev()) {
            verdict.metrics.push(Metric::new(row, Ok(0.1), None));
        }
        let whole = joined(loops, &rows);
        let names = Vec::from_iter(whole.metrics.iter().map(|metric| metric.name.as_str()));
        let expected = [
            "x.overshoot_percent",
            "y.overshoot_percent",
            "y_x.contour",
            "x_y.contour",
            "bus_load_percent",
        ];
        assert_eq!(names, expected);
    }
}
