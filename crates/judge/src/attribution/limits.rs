//! Limits in a run with stalls: a limit is missed if it is also missed without the pieces of the run that stalls explain.

use scenario::expect::Limit;
use scenario::metrics::is_traffic_metric;

use crate::evidence::Evidence;
use crate::metric::{Metric, leave_open};
use crate::metrics::metrics;

/// Largest percentage of cycles missed because of stalls; beyond it, no metric of the control means anything.
const HOST_PERCENT_MAX: f64 = 1.0;
/// Part of a limit by which it may be missed and still be explained by a short stall.
const NEARLY: f64 = 0.1;

/// Opens the limits that stalls explain. Returns the reason, if there are any.
pub(crate) fn open_limits(evidence: &Evidence<'_>, rows: &mut [Metric]) -> Option<String> {
    let longest = evidence.longest_stall()?;
    let cycles = &evidence.attribution.cycles;
    let percent = cycles.share_percent(cycles.by_host);
    let busy = (percent > HOST_PERCENT_MAX).then(|| {
        format!(
            "{percent:.2} % of the cycles were missed because of stalls (limit {HOST_PERCENT_MAX} %), the longest when {}: the machine was too busy for real time; try --clock lockstep",
            longest.description()
        )
    });
    let rest = metrics(&evidence.rest(false));
    let without_long = metrics(&evidence.rest(true));
    let missed = |others: &[Metric], name: &str| {
        let is_missed = |other: &&Metric| other.name == name && other.passed == Some(false);
        others.iter().find(is_missed).cloned()
    };
    let mut opened = Vec::new();
    for row in rows.iter_mut() {
        let besides = missed(&rest, &row.name);
        let is_open = match row.passed {
            // A stall kept the window from being seen to the end, but the limit is missed without the stall, too.
            None => {
                besides.into_iter().for_each(|missed| *row = missed);
                false
            }
            Some(true) => busy.is_some() && !is_traffic_metric(&row.name),
            Some(false) => besides.is_none() && is_explained(row, missed(&without_long, &row.name)),
        };
        if is_open {
            leave_open(row);
            opened.push(row.name.clone());
        }
    }
    if busy.is_some() || opened.is_empty() {
        return busy;
    }
    let (stall, names) = (longest.description(), opened.join(", "));
    Some(format!(
        "not judged, since {stall}: {names}; run it again or use --clock lockstep"
    ))
}

/// Returns whether stalls explain a missed limit that is met without the pieces they explain. A breach of a duty is always
/// explained; a motion is unless the limit is missed without the pieces of long stalls, too, and by much.
fn is_explained(row: &Metric, missed_without_long: Option<Metric>) -> bool {
    is_traffic_metric(&row.name)
        || missed_without_long.is_none_or(|row| {
            let judged = row.value.zip(row.limit);
            judged.is_some_and(|(value, limit)| is_nearly_met(value, limit))
        })
}

fn is_nearly_met(value: f64, limit: Limit) -> bool {
    let is_near = |beyond: f64, limit: f64| beyond <= NEARLY * limit.abs();
    limit.max.is_none_or(|max| is_near(value - max, max))
        && limit.min.is_none_or(|min| is_near(min - value, min))
}
