//! Whether a recording is good enough to decide anything.

use recording::timeline::Timeline;
use recording::unrecorded::Unrecorded;
use scenario::Scenario;

use crate::verdict::Outcome;

/// With more missed cycles than this, control metrics decide nothing.
const MISSED_CYCLES_PERCENT_MAX: f64 = 1.0;
/// From this load on, a cycle that carries more than the others does not end in its time.
const BUSY_BUS_PERCENT: f64 = 70.0;
/// With faults the plant sends its truth every 10 ms at least.
const FAULTY_END_SECONDS: f64 = 0.05;

/// The outcome of a recording that is not good enough, with the reason. In a scenario with faults, cycles are missed on
/// purpose.
pub(crate) fn undecided(timeline: &Timeline, scenario: &Scenario) -> Option<(Outcome, String)> {
    let planned = scenario.duration_seconds;
    let is_sound = scenario.fault.is_empty();
    if let Some(reason) = too_many_missed(timeline).filter(|_| is_sound) {
        return Some((Outcome::Inconclusive, reason));
    }
    if timeline.zero_seconds.is_none() && has_boot_fault(scenario) {
        return None;
    }
    let (reached, tolerance) = if is_sound {
        (timeline.due_seconds(), 1.5 * timeline.period_seconds)
    } else {
        (timeline.last_frame_seconds, FAULTY_END_SECONDS)
    };
    (timeline.zero_seconds.is_none() || reached + tolerance < planned).then(|| {
        let reached = timeline.zero_seconds.map_or(0.0, |_| reached);
        let reason = format!("the recording ends after {reached:.3} s of {planned} s");
        (Outcome::Incomplete, reason)
    })
}

/// A fault with which the scenario need not begin.
fn has_boot_fault(scenario: &Scenario) -> bool {
    let windows = scenario.fault.windows();
    windows.iter().any(|fault| fault.from_seconds.is_none())
}

/// Why nothing can be decided, when the recording is not all that was on the bus.
pub(crate) fn incomplete_recording(unrecorded: &Unrecorded) -> Option<String> {
    let lost = unrecorded.frames_lost;
    let lost = (lost > 0).then(|| lost_frames(lost));
    lost.or_else(|| unrecorded.strange_lines.clone())
}

/// Why nothing can be decided, when somebody else led the drive too.
pub(crate) fn second_master(timeline: &Timeline) -> Option<String> {
    let found = timeline.second_masters.iter().map(ToString::to_string);
    let found = found.collect::<Vec<_>>().join("; ");
    (!found.is_empty()).then(|| format!("a second master: {found}"))
}

/// The reason of a verdict on a recording with missing frames.
#[must_use]
pub fn lost_frames(lost: u64) -> String {
    format!("the recorder lost {lost} frames")
}

/// Why nothing can be decided, when too many cycles were missed.
#[must_use]
pub fn too_many_missed(timeline: &Timeline) -> Option<String> {
    let missed = timeline.missed_cycles_percent();
    (missed > MISSED_CYCLES_PERCENT_MAX).then(|| {
        let load = timeline.bus_load_percent;
        let cause = if load > BUSY_BUS_PERCENT {
            format!("the bus is nearly full (load {load:.1} %)")
        } else {
            "the machine was too busy for real time; try --clock lockstep".to_owned()
        };
        format!(
            "{missed:.1} % of the cycles were missed (limit {MISSED_CYCLES_PERCENT_MAX} %): {cause}"
        )
    })
}
