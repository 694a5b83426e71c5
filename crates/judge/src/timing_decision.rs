//! Checks the timing of a run in real time against its limits, and decides the outcome again.

use recording::stalls::Stall;
use scenario::expect::Expect;
use scenario::metrics::{Metric as Row, without_loop};

use crate::duties::MISSED_COMMANDS;
use crate::metric::{Metric, leave_open, not_judged};
use crate::timing::Timing;
use crate::verdict::{Outcome, Verdict};

/// Adds the timing of a run in real time and judges its limits. If the timing is not trusted, they are neither met nor missed,
/// and the run cannot pass. If the machine stalled at all, none is missed. A command that did not come is later than any
/// limit.
pub fn judge_timing(verdict: &mut Verdict, timing: Timing, expect: &Expect, stalls: &[Stall]) {
    let unavailable = not_judged(&verdict.metrics);
    let mut metrics = timing.metrics(&expect.timing);
    let missed_percent = missed_commands_percent(verdict);
    for metric in &mut metrics {
        if metric.passed == Some(true)
            && is_to_command(metric)
            && let Some(why) = why_not_met(metric, missed_percent)
        {
            *metric = Metric::new(metric.name.clone(), Err(why), metric.limit);
        }
        let named = expect.requirements.get(&metric.name);
        metric.requirements = named.cloned().unwrap_or_default();
        let is_missed = metric.passed == Some(false);
        if !timing.distrust.is_empty() || is_missed && !stalls.is_empty() {
            leave_open(metric);
        }
    }
    verdict.metrics.extend(metrics);
    if is_open(verdict, unavailable.as_ref()) {
        decide(verdict, &timing, stalls, unavailable);
    }
    verdict.timing = Some(timing);
}

/// Returns the largest share of cycles without a command over all loops.
fn missed_commands_percent(verdict: &Verdict) -> f64 {
    let metrics = verdict.metrics.iter();
    let rows = metrics.filter(|row| without_loop(&row.name) == MISSED_COMMANDS);
    rows.filter_map(|row| row.value).fold(0.0, f64::max)
}

/// Returns the reason why the commands that came do not meet a limit on the time to the command.
fn why_not_met(metric: &Metric, missed_percent: f64) -> Option<String> {
    let limit = Row::named(MISSED_COMMANDS).and_then(|row| row.default_max)?;
    if missed_percent > limit {
        return Some(format!(
            "no command in {missed_percent:.2} % of the cycles (limit {limit} %)"
        ));
    }
    let is_measured = metric.value.is_some_and(|value| value > 0.0);
    (!is_measured).then(|| "no cycle had its command before the next SYNC".to_owned())
}

/// Returns whether a metric is a time that ends with a command.
fn is_to_command(metric: &Metric) -> bool {
    let latencies = ["position_to_command", "round_trip"];
    latencies
        .iter()
        .any(|latency| metric.name.starts_with(latency))
}

/// Returns whether the timing can change the outcome.
fn is_open(verdict: &Verdict, unavailable: Option<&String>) -> bool {
    match verdict.outcome {
        Outcome::Pass => true,
        // The outcome is open only because no node on the bus sends a value; a limit on timing may still fail.
        Outcome::Inconclusive => unavailable.is_some() && verdict.reason.as_ref() == unavailable,
        Outcome::Fail | Outcome::Incomplete => false,
    }
}

fn decide(verdict: &mut Verdict, timing: &Timing, stalls: &[Stall], unavailable: Option<String>) {
    let metrics = verdict.metrics.iter();
    let limited = metrics.filter(|metric| metric.limit.is_some());
    let results: Vec<Option<bool>> = limited.map(|metric| metric.passed).collect();
    if results.contains(&Some(false)) {
        (verdict.outcome, verdict.reason) = (Outcome::Fail, None);
    } else if results.contains(&None) {
        let late = (not_judged(&verdict.metrics) != unavailable).then(|| {
            let longest = stalls
                .iter()
                .max_by_key(|stall| stall.length())
                .filter(|_| timing.distrust.is_empty());
            let distrust = timing.distrust.iter().cloned();
            let why: Vec<String> = distrust.chain(longest.map(ToString::to_string)).collect();
            format!("the timing cannot be judged: {}", why.join("; "))
        });
        let reasons: Vec<String> = unavailable.into_iter().chain(late).collect();
        verdict.outcome = Outcome::Inconclusive;
        verdict.reason = Some(reasons.join("; "));
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use recording::latency::{NodeReport, Quantiles};
    use recording::stalls::{What, Who};
    use scenario::expect::Limit;

    use super::*;

    fn timing(p99: f64, distrust: &[&str]) -> Timing {
        Timing {
            controller: Some(NodeReport::default()),
            plant_emulator: Some(NodeReport::default()),
            sync_to_position_microseconds: Quantiles::default(),
            position_to_command_microseconds: Quantiles::default(),
            round_trip_microseconds: Quantiles {
                p99,
                ..Quantiles::default()
            },
            on_this_machine: Vec::new(),
            distrust: distrust.iter().map(ToString::to_string).collect(),
        }
    }

    fn max(max: f64) -> Option<Limit> {
        let limit = Limit {
            min: None,
            max: Some(max),
        };
        Some(limit)
    }

    #[test]
    fn a_command_that_did_not_come_is_late() {
        let mut limits = Expect::default();
        limits.timing.round_trip_microseconds.p99 = max(800.0);
        limits.timing.frames_delayed = max(0.0);
        let judged = |missed_percent: f64, p99| {
            let mut verdict = Verdict::incomplete("hold", 1, "");
            (verdict.outcome, verdict.reason) = (Outcome::Pass, None);
            let missed = Metric::new("x.missed_commands_percent", Ok(missed_percent), None);
            verdict.metrics = vec![missed];
            judge_timing(&mut verdict, timing(p99, &[]), &limits, &[]);
            let [_, row, delayed] = verdict.metrics.try_into().unwrap();
            assert_eq!((delayed.value, delayed.passed), (Some(0.0), Some(true)));
            (verdict.outcome, row.value, row.remark)
        };
        assert_eq!(judged(1.0, 700.0), (Outcome::Pass, Some(700.0), None));
        let why = "no command in 66.67 % of the cycles (limit 1 %)".to_owned();
        let expected = (Outcome::Fail, None, Some(why));
        assert_eq!(judged(66.67, 700.0), expected);
        let why = "no cycle had its command before the next SYNC".to_owned();
        let expected = (Outcome::Fail, None, Some(why));
        assert_eq!(judged(0.0, 0.0), expected);
    }

    #[test]
    fn what_both_loops_counted_is_told_and_limited_together() {
        let mut both = timing(0.0, &[]);
        let report = |overruns, frames_delayed| {
            Some(NodeReport {
                overruns,
                frames_delayed,
                ..NodeReport::default()
            })
        };
        (both.controller, both.plant_emulator) = (report(1, 0), report(0, 2));
        let told = "controller: 1 overruns, 0 frames dropped; plant emulator: 0 overruns, 0 frames dropped, \
            2 frames delayed by a full queue of the bus";
        assert_eq!(both.losses(), told);
        assert_eq!(both.rows().len(), 5);
        let mut limits = Expect::default();
        limits.timing.frames_delayed = max(1.0);
        let rows = both.metrics(&limits.timing);
        assert_eq!((rows[0].value, rows[0].passed), (Some(2.0), Some(false)));
    }

    #[test]
    fn limits_on_time_pass_only_where_the_timing_is_trusted() {
        let name = "round_trip_microseconds_p99";
        let mut limits = Expect::default();
        limits.requirements = [(name.to_owned(), vec!["REQ-1".to_owned()])].into();
        limits.timing.round_trip_microseconds.p99 = max(800.0);
        let outcome = |missed: f64, timing: Timing, limits: &Expect| {
            let mut verdict = Verdict::incomplete("hold", 1, "");
            verdict.metrics = vec![Metric::new("missed_cycles_percent", Ok(missed), max(0.1))];
            let passed = verdict.metrics[0].passed == Some(true);
            verdict.outcome = if passed { Outcome::Pass } else { Outcome::Fail };
            judge_timing(&mut verdict, timing, limits, &[]);
            let row = verdict.metrics.iter().find(|metric| metric.name == name);
            assert!(row.is_none_or(|row| row.requirements == ["REQ-1"]));
            assert_eq!(row.is_some(), limits.timing.limits().next().is_some());
            verdict.outcome
        };
        let refused = ["no priority"];
        assert_eq!(outcome(0.0, timing(700.0, &[]), &limits), Outcome::Pass);
        assert_eq!(outcome(0.0, timing(900.0, &[]), &limits), Outcome::Fail);
        for p99 in [700.0, 900.0] {
            let judged = outcome(0.0, timing(p99, &refused), &limits);
            assert_eq!(judged, Outcome::Inconclusive);
        }
        assert_eq!(outcome(0.5, timing(700.0, &[]), &limits), Outcome::Fail);
        // A value that no node sends does not pass, and does not hide a failure.
        let unavailable = |p99| {
            let mut verdict = Verdict::incomplete("hold", 1, "");
            let name = "temperature_celsius";
            verdict.metrics = vec![Metric::not_judged(
                name,
                "not available".to_owned(),
                max(90.0),
            )];
            verdict.outcome = Outcome::Inconclusive;
            verdict.reason = Some(format!("not judged: {name}"));
            judge_timing(&mut verdict, timing(p99, &[]), &limits, &[]);
            verdict.outcome
        };
        assert_eq!(unavailable(700.0), Outcome::Inconclusive);
        assert_eq!(unavailable(900.0), Outcome::Fail);
        // Without limits on time the timing is only reported.
        let none = Expect::default();
        assert_eq!(outcome(0.0, timing(9e9, &refused), &none), Outcome::Pass);
        // A refusal by the machine excuses no cycle.
        assert_eq!(outcome(0.5, timing(9e9, &refused), &none), Outcome::Fail);
        // A stall explains a late frame, but makes no punctual one late.
        let from = Duration::from_millis(1234);
        let until = from + Duration::from_millis(45);
        let stall = Stall::new(from, until, Who::Machine, What::StoodStill);
        for (p99, expected) in [(700.0, Outcome::Pass), (900.0, Outcome::Inconclusive)] {
            let mut verdict = Verdict::incomplete("hold", 1, "");
            (verdict.outcome, verdict.reason) = (Outcome::Pass, None);
            judge_timing(&mut verdict, timing(p99, &[]), &limits, &[stall]);
            assert_eq!(verdict.outcome, expected);
            let is_named = |reason: String| reason.contains("the machine stood still for 45.0 ms");
            assert_eq!(verdict.reason.map(is_named), (p99 > 800.0).then_some(true));
        }
    }
}
