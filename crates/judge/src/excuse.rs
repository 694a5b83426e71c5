//! What a limit says in a run in which the machine stood still: nothing, where that explains the miss.

use rig::plan::ControlLoop;
use scenario::metrics::{is_of_traffic, only_grows};
use scenario::port::Unit;

use crate::commands;
use crate::evidence::{Evidence, RecordedLoop};
use crate::metric::{Metric, leave_open, meets};
use crate::metrics::metrics;
use crate::misses::{Stretch, Totals};

pub(crate) const MISSED_CYCLES: &str = "missed_cycles_percent";
pub(crate) const MISSED_COMMANDS: &str = "missed_commands_percent";
/// Its row has no value but the event.
const NO_EVENT: &str = "no_event";
const SYNC_INTERVAL: &str = "sync_interval_milliseconds_max";

/// A row that only grows, which begins with the names of its loops.
const GROWING_CONTOUR: &str = ".contour_error_millimetres_max";

/// The bench's own misses.
pub(crate) struct Excuse {
    /// When the first of them was, or the stall that it was missed for.
    first_seconds: f64,
    longest: Stretch,
    /// So many that no control metric says anything any more: what to say of it.
    busy: Option<String>,
}

impl Excuse {
    /// None where no cycle was missed because of the bench.
    pub(crate) fn find(evidence: &Evidence<'_>, percent_max: f64) -> Option<Self> {
        let cycles = evidence.misses().totals();
        let (first_seconds, longest) = cycles.first_stall()?;
        let percent = cycles.percent_by_bench();
        let busy = (percent > percent_max).then(|| {
            format!(
                "{percent:.2} % of the cycles were missed because of stalls (limit {percent_max} %), the longest when {}: the machine was too busy for real time; try --clock lockstep",
                longest.words()
            )
        });
        Some(Self {
            first_seconds,
            longest,
            busy,
        })
    }

    /// Opens the limits that the bench's misses explain; what to say of them, if there are some.
    pub(crate) fn open_limits(
        &self,
        evidence: &Evidence<'_>,
        rows: &mut [Metric],
    ) -> Option<String> {
        let before = metrics_before(evidence, self.first_seconds);
        let unit = &evidence.scenario.wiring.unit;
        let is_proven = |row: &Metric, old: &Metric| is_proven(row, old, unit);
        let mut opened = Vec::new();
        for row in rows.iter_mut() {
            let old = before.iter().find(|old| old.name == row.name);
            if row.passed.is_none()
                && let Some(old) = old.filter(|old| is_proven(row, old))
            {
                // A stall kept its window from being seen to the end, but it was beyond the limit before.
                row.clone_from(old);
                continue;
            }
            let is_open = match row.passed {
                Some(false) if row.name == MISSED_CYCLES => {
                    explains_missed(evidence.misses().totals(), row)
                }
                Some(false) if row.name == SYNC_INTERVAL => self.explains_interval(evidence, row),
                Some(false) => !old.is_some_and(|old| is_proven(row, old)),
                Some(true) => self.busy.is_some() && !is_of_traffic(&row.name),
                None => false,
            };
            if is_open {
                leave_open(row);
                opened.push(row.name.as_str());
            }
        }
        if self.busy.is_some() {
            return self.busy.clone();
        }
        (!opened.is_empty()).then(|| not_judged_since(&self.longest, &opened.join(", ")))
    }

    /// A SYNC that is due in a stall comes after it, by a period at most.
    fn explains_interval(&self, evidence: &Evidence<'_>, row: &Metric) -> bool {
        let periods = 2.0 * evidence.timeline.period_seconds;
        let longest = self.longest.until_seconds - self.longest.from_seconds;
        row.value
            .is_some_and(|value| value <= 1e3 * (longest + periods))
    }
}

/// Opens the limit on missed commands if it is met without those that the bench kept from being sent; what to say of it.
pub(crate) fn open_commands(evidence: &Evidence<'_>, rows: &mut [Metric]) -> Option<String> {
    let is_missed = |row: &&mut Metric| row.name == MISSED_COMMANDS && row.passed == Some(false);
    let row = rows.iter_mut().find(is_missed)?;
    let missed = commands::missed(evidence);
    let (_, longest) = missed
        .first_stall()
        .filter(|_| explains_missed(&missed, row))?;
    leave_open(row);
    Some(not_judged_since(&longest, MISSED_COMMANDS))
}

fn not_judged_since(stall: &Stretch, names: &str) -> String {
    let stall = stall.words();
    format!("not judged, since {stall}: {names}; run it again or use --clock lockstep")
}

/// Without the bench's own misses the limit is met.
fn explains_missed(missed: &Totals, row: &Metric) -> bool {
    let unexplained = missed.percent_unexplained();
    row.limit.is_some_and(|limit| meets(unexplained, limit))
}

/// What was measured until a time, as if the scenario ended there.
fn metrics_before(evidence: &Evidence<'_>, seconds: f64) -> Vec<Metric> {
    let before = |(own, timeline): &RecordedLoop<'_>| {
        let mut own = ControlLoop::clone(own);
        let until_seconds = seconds.min(own.scenario.judged_end_seconds());
        own.scenario.expect.judged_until_seconds = Some(until_seconds);
        (own, timeline.before(seconds))
    };
    let (own, timeline) = before(&(evidence.own, evidence.timeline));
    let loops = Vec::from_iter(evidence.loops.iter().map(before));
    let loops = Vec::from_iter(loops.iter().map(|(own, timeline)| (own, timeline)));
    let evidence_before = Evidence::new(&timeline, &own, evidence.circumstances);
    metrics(&evidence_before.among(evidence.contours, &loops))
}

/// Whether a limit was missed by what was on the bus before the first stall: by what is the same without all that came later,
/// or can only have grown.
fn is_proven(row: &Metric, before: &Metric, unit: &Unit) -> bool {
    if row.name == NO_EVENT {
        return before.passed == Some(false) && before.remark == row.remark;
    }
    let (Some(value), Some(limit)) = (before.value, before.limit) else {
        return false;
    };
    let is_same = before.value == row.value && before.at_seconds == row.at_seconds;
    let is_beyond = limit.max.is_some_and(|max| value > max);
    let name = unit.canonical(&row.name);
    let only_grows = only_grows(&name) || name.ends_with(GROWING_CONTOUR);
    before.passed == Some(false) && (is_same || is_beyond && only_grows)
}
