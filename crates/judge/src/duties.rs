//! The metrics of the duties: missed and late cycles and commands, and the SYNC period.

use std::collections::VecDeque;

use recording::timeline::TIME_TOLERANCE_SECONDS;
use scenario::expect::rounded;
use scenario::metrics::Metric;

use crate::attribution::Commands;
use crate::attribution::breaches::Duty;
use crate::attribution::stalls::Stretch;
use crate::evidence::{Absence, Evidence, Measurement};

/// Metrics of duties, by their names in the table of metrics.
pub(crate) const MISSED_CYCLES: &str = "missed_cycles_percent";
pub(crate) const MISSED_COMMANDS: &str = "missed_commands_percent";
pub(crate) const LATE_COMMANDS: &str = "late_commands_percent";
pub(crate) const SYNC_PERIOD_ERROR: &str = "sync_period_error_percent";

/// Number of SYNC periods whose mean shows the clock that makes them.
pub(crate) const PERIODS: usize = 64;
/// Interval, in periods, beyond which SYNCs are missing.
const GAP_PERIODS: f64 = 1.5;

/// Returns the limit of a metric of the controller's duties: that of the scenario, or the default if the controller is under test
/// and not canrig's; `None` if the metric is not watched.
pub(crate) fn limited_max(evidence: &Evidence<'_>, metric: &str) -> Option<f64> {
    is_watched(evidence, metric).then(|| percent_max(evidence, metric))
}

/// Returns the limit of a metric of a duty: that of the scenario, or the default.
pub(crate) fn percent_max(evidence: &Evidence<'_>, metric: &str) -> f64 {
    let limit = evidence.trial.expect.limit(metric);
    let default = || Metric::named(metric)?.default_max;
    let max = limit.and_then(|limit| limit.max);
    max.or_else(default).unwrap_or(f64::INFINITY)
}

/// Returns the percentage of due cycles that never began or in which the drive was silent.
pub(crate) fn missed_cycles(evidence: &Evidence<'_>) -> Measurement {
    let attribution = &evidence.attribution;
    if attribution.due == 0 {
        let reason = "no cycle in the recording";
        return Err(Absence::unseen(reason, evidence.whole()));
    }
    Ok(attribution.cycles.percent(evidence.has_all()).into())
}

/// Returns the percentage of cycles in which a command was due and did not come.
pub(crate) fn missed_commands(evidence: &Evidence<'_>) -> Measurement {
    command_share(evidence, Commands::Missed, MISSED_COMMANDS)
}

/// Returns the percentage of cycles in which a command was due and came after the next SYNC.
pub(crate) fn late_commands(evidence: &Evidence<'_>) -> Measurement {
    command_share(evidence, Commands::Late, LATE_COMMANDS)
}

/// Measures a share of commands. It is reported if it is limited, if the controller is under test, or if a controller left out
/// too many and no fault may be the cause.
fn command_share(evidence: &Evidence<'_>, commands: Commands, metric: &str) -> Measurement {
    let is_watched = is_watched(evidence, metric);
    let is_sound = evidence.control_loop.faults().next().is_none();
    if !is_watched && (!is_sound || commands.are_sound(evidence.timeline)) {
        return Err(Absence::not_asked());
    }
    let totals = commands.totals(evidence);
    if !is_watched && totals.too_many(percent_max(evidence, metric), 0).is_empty() {
        return Err(Absence::not_asked());
    }
    evidence.seen(evidence.whole()).map(drop)?;
    Ok(totals.percent(evidence.has_all()).into())
}

/// Returns whether a metric of the controller's duties is reported.
fn is_watched(evidence: &Evidence<'_>, metric: &str) -> bool {
    Duty::Command.is_of_external(evidence.control_loop)
        || evidence.trial.expect.of(metric).is_some()
}

/// Returns the largest distance of the mean of 64 SYNC periods from the nominal period, in percent of it.
pub(crate) fn sync_period_error(evidence: &Evidence<'_>) -> Measurement {
    if !is_watched(evidence, SYNC_PERIOD_ERROR) {
        return Err(Absence::not_asked());
    }
    match largest_period_error(evidence, evidence.has_all()) {
        Some((percent, _)) => Ok(percent.into()),
        None if !evidence.has_all() => Err(Absence::left_out()),
        None => Err(Absence::meaningless(format!(
            "no {PERIODS} SYNC periods in a row"
        ))),
    }
}

/// Returns the largest such distance in percent, with the end of those periods. `with_host` includes periods that stalls explain.
pub(crate) fn largest_period_error(evidence: &Evidence<'_>, with_host: bool) -> Option<(f64, f64)> {
    if !with_host && undecided_period(evidence).is_some() {
        return None;
    }
    let mut largest: Option<(f64, f64)> = None;
    for (percent, until) in period_errors(evidence, with_host) {
        if largest.is_none_or(|(largest, _)| percent > largest) {
            largest = Some((percent, until));
        }
    }
    largest
}

/// Returns the distance of the mean of each 64 SYNC periods from the nominal period in percent,
/// with the end of those periods. The count begins anew at missing SYNCs, and at late ones that
/// follow in a burst.
fn period_errors<'a>(
    evidence: &'a Evidence<'_>,
    with_host: bool,
) -> impl Iterator<Item = (f64, f64)> + use<'a> {
    let period = evidence.timeline.period_seconds;
    let mut periods = VecDeque::with_capacity(PERIODS);
    let mut held_up = 0.0;
    sync_intervals(evidence).filter_map(move |(from, until)| {
        let interval = (until - from) / period;
        let is_gap = interval > GAP_PERIODS;
        let is_held_up = held_up > 0.5 && interval < 0.5;
        if is_gap {
            held_up = interval - 1.0;
        } else if is_held_up {
            held_up -= 1.0 - interval;
        }
        let stall = || evidence.stall_of_controller(from, until);
        let is_of_host = !with_host && stall().is_some();
        if is_gap || is_held_up || is_of_host {
            periods.clear();
            return None;
        }
        if periods.len() == PERIODS {
            periods.pop_front();
        }
        periods.push_back(interval);
        let mean = periods.iter().sum::<f64>() / PERIODS as f64;
        (periods.len() == PERIODS).then_some((100.0 * (mean - 1.0).abs(), until))
    })
}

/// Returns the longest stall if stalls leave open whose SYNC periods exceeded their limit. Periods
/// that are wrong at the end, too, are those of a wrong clock.
pub(crate) fn undecided_period(evidence: &Evidence<'_>) -> Option<Stretch> {
    let stall = {
        let controller = evidence.control_loop.controller_index();
        evidence.attribution.undecided(controller)?
    };
    let max = limited_max(evidence, SYNC_PERIOD_ERROR)?;
    let mut is_exceeded = false;
    let mut is_last = false;
    for (percent, _) in period_errors(evidence, true) {
        is_last = rounded(percent) > max;
        is_exceeded |= is_last;
    }
    (is_exceeded && !is_last).then_some(stall)
}

/// Returns the longest time between two SYNCs that no stall explains.
pub(crate) fn longest_interval_milliseconds(evidence: &Evidence<'_>) -> f64 {
    let is_explained = |(from, until): &(f64, f64)| {
        let due = from + evidence.timeline.period_seconds;
        let stall = evidence.stall_of_controller(due.min(*until), *until);
        stall.is_some()
    };
    let intervals = sync_intervals(evidence).filter(|interval| !is_explained(interval));
    let longest = intervals.map(|(from, until)| 1e3 * (until - from));
    longest.fold(0.0, f64::max)
}

/// Returns the times between SYNCs, as far as they are judged.
fn sync_intervals<'a>(evidence: &'a Evidence<'_>) -> impl Iterator<Item = (f64, f64)> + use<'a> {
    let syncs = &evidence.timeline.syncs_seconds;
    let end = evidence.trial.judged_end_seconds() - TIME_TOLERANCE_SECONDS;
    let hits = &evidence.attribution.hits;
    let half = evidence.timeline.period_seconds / 2.0;
    let mut before: Option<f64> = None;
    let pairs = syncs.iter().filter_map(move |at| {
        let is_soon = before.is_some_and(|before| at - before < half);
        if is_soon && hits.is_copy(at) {
            return None;
        }
        Some((before.replace(at)?, at))
    });
    pairs.take_while(move |(_, until)| *until < end)
}

#[cfg(test)]
mod tests {
    use recording::timeline::{Series, decode};

    use super::*;
    use crate::Circumstances;
    use crate::tests::{frames, step_plan};

    /// Returns the largest error of a controller with these intervals between its SYNCs, in milliseconds.
    fn error(intervals: &[f64]) -> f64 {
        let plan = step_plan("");
        let mut timeline = decode(&frames(4, |_| Some(10.0)).into(), &plan)
            .unwrap()
            .remove(0);
        let times = intervals.iter().scan(0.0, |time, interval| {
            *time += interval / 1e3;
            Some(*time)
        });
        timeline.syncs_seconds = [0.0].into_iter().chain(times).collect::<Series<f64>>();
        let circumstances = Circumstances::default();
        let evidence = Evidence::new(
            plan.database(),
            &timeline,
            plan.only_loop().unwrap(),
            &circumstances,
        );
        let (percent, _) = largest_period_error(&evidence, true).unwrap();
        percent
    }

    #[test]
    fn a_controller_that_catches_up_breaks_no_period() {
        let regular = [1.0; 100];
        assert!((error(&[1.03; 100]) - 3.0).abs() < 1e-6);
        let late = [&regular[..], &[10.0], &[0.1; 10], &regular].concat();
        assert!(error(&late) < 1e-6, "{}", error(&late));
        // No gap precedes this burst.
        let burst = [&regular[..], &[0.1; 10], &regular].concat();
        assert!(error(&burst) > 10.0, "{}", error(&burst));
    }
}
