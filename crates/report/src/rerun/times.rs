//! The two timelines of a recording.

use re_sdk::log::TimeColumn;

use recording::timeline::Timeline;

/// Name of the timeline of scenario time.
pub(super) const RUN_TIME: &str = "run_time";
/// Name of the timeline of cycles since scenario time 0.
pub(super) const CYCLE: &str = "cycle";

/// Time on both timelines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    pub(super) seconds: f64,
    pub(super) cycle: i64,
}

/// Returns the times of all rows.
pub(super) fn moments(timeline: &Timeline) -> impl Iterator<Item = Moment> + Clone {
    let cycles = timeline.cycle.iter();
    let times = timeline.time_seconds.iter().zip(cycles);
    times.map(|(seconds, cycle)| at_cycle(seconds, cycle))
}

fn at_cycle(seconds: f64, cycle: u64) -> Moment {
    Moment {
        seconds,
        cycle: i64::try_from(cycle).unwrap_or(i64::MAX),
    }
}

/// Returns the time of a row that is the first of its kind: the first event, if that is earlier, so that the row is shown from
/// there on.
pub(super) fn first_moment(timeline: &Timeline, here: Moment) -> Moment {
    match timeline.events.first() {
        Some(event) if event.time_seconds < here.seconds => {
            moment_at(event.time_seconds, timeline.period_seconds)
        }
        _ => here,
    }
}

/// Returns a time that may lie before the first cycle or within one.
pub(super) fn moment_at(seconds: f64, period_seconds: f64) -> Moment {
    Moment {
        seconds,
        cycle: whole((seconds / period_seconds + 1e-6).floor()),
    }
}

/// Returns both timelines at some times.
pub(super) fn columns(moments: impl Iterator<Item = Moment> + Clone) -> [TimeColumn; 2] {
    let nanoseconds = moments
        .clone()
        .map(|moment| whole((moment.seconds * 1e9).round()));
    [
        TimeColumn::new_duration_nanos(RUN_TIME, nanoseconds),
        TimeColumn::new_sequence(CYCLE, moments.map(|moment| moment.cycle)),
    ]
}

/// Returns both timelines at some rows.
pub(super) fn at_rows(timeline: &Timeline, rows: &[usize]) -> [TimeColumn; 2] {
    let cycles = timeline.cycle.at(rows.iter().copied());
    let times = timeline.time_seconds.at(rows.iter().copied()).zip(cycles);
    let moments = times.map(|(seconds, cycle)| at_cycle(seconds, cycle));
    columns(Vec::from_iter(moments).into_iter())
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "run times stay far below 292 years"
)]
fn whole(value: f64) -> i64 {
    value as i64
}
