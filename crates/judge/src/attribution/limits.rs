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
    let percent = evidence.attribution.cycles.percent_by_host();
    let busy = (percent > HOST_PERCENT_MAX).then(|| {
        format!(
            "{percent:.2} % of the cycles were missed because of stalls (limit {HOST_PERCENT_MAX} %), the longest when {}: the machine was too busy for real time; try --clock lockstep",
            longest.description()
        )
    });
    let rest = metrics(&evidence.rest(false));
    let without_long = metrics(&evidence.rest(true));
    let named = |others: &[Metric], row: &Metric| {
        others.iter().find(|other| other.name == row.name).cloned()
    };
    let mut opened = Vec::new();
    for row in rows.iter_mut() {
        let rest = named(&rest, row);
        let is_missed_besides = rest.as_ref().is_some_and(|rest| rest.passed == Some(false));
        let is_open = match row.passed {
            // A stall kept the window from being seen to the end, but the limit is missed without the stall, too.
            None => {
                let rest = rest.filter(|_| is_missed_besides);
                rest.into_iter().for_each(|rest| *row = rest);
                false
            }
            Some(true) => busy.is_some() && !is_traffic_metric(&row.name),
            Some(false) => !is_missed_besides && is_explained(row, named(&without_long, row)),
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
/// explained; a motion is if the limit is met without the pieces of long stalls, or is missed by little.
fn is_explained(row: &Metric, without_long: Option<Metric>) -> bool {
    let missed = without_long.filter(|row| row.passed == Some(false));
    is_traffic_metric(&row.name)
        || missed.is_none_or(|row| {
            let judged = row.value.zip(row.limit);
            judged.is_some_and(|(value, limit)| is_nearly_met(value, limit))
        })
}

fn is_nearly_met(value: f64, limit: Limit) -> bool {
    let is_near = |beyond: f64, limit: f64| beyond <= NEARLY * limit.abs();
    limit.max.is_none_or(|max| is_near(value - max, max))
        && limit.min.is_none_or(|min| is_near(min - value, min))
}
