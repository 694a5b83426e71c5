//! The cycles that two runs share, and how far values of one are from those of the other.

use platform::series::{Series, SeriesWriter};
use recording::timeline::Timeline;

/// A lag is looked for within this time and so many cycles …
const LAG_SECONDS_MAX: f64 = 0.5;
const LAG_ROWS_MAX: f64 = 500.0;
/// … and reported where it leaves less than this part of the mean square.
const LAG_GAIN: f64 = 0.9;
/// Of more values than these, only every second, third … is compared for it.
const LAG_SAMPLES_MAX: usize = 10_000;
/// Runs that share fewer cycles than this, by the longer one, do not agree.
const SHARED_PERCENT_MIN: f64 = 99.0;

/// The cycles that both runs have, without the last of them.
pub(super) struct Shared {
    /// Rows of the one and of the other.
    pub(super) rows: Series<[u64; 2]>,
    pub(super) time_seconds: Series<f64>,
    pub(super) period_seconds: f64,
}

impl Shared {
    pub(super) fn of(a: &Timeline, b: &Timeline) -> Self {
        let mut rows = SeriesWriter::default();
        let (mut left, mut right) = (0, 0);
        while let (Some(one), Some(other)) = (a.cycle.get(left), b.cycle.get(right)) {
            if one == other {
                rows.push([left, right].map(wide));
            }
            left += usize::from(one <= other);
            right += usize::from(other <= one);
        }
        // In its last cycle a run is already stopped.
        rows.pop();
        let rows = rows.finish();
        let times = rows.iter().map(|[left, _]| a.time_seconds[row(*left)]);
        Self {
            time_seconds: times.collect(),
            rows,
            period_seconds: a.period_seconds,
        }
    }

    /// The values of the one and of the other, side by side.
    pub(super) fn values(&self, a: &[f64], b: &[f64]) -> [Series<f64>; 2] {
        let of = |values: &[f64], side: usize| {
            let rows = self.rows.iter().map(|rows| values[row(rows[side])]);
            rows.collect()
        };
        [of(a, 0), of(b, 1)]
    }

    pub(super) fn remarks(&self, a: &Timeline, b: &Timeline) -> Vec<String> {
        #[expect(
            clippy::cast_precision_loss,
            reason = "cycle counts stay far below 2^52"
        )]
        let percent =
            100.0 * self.rows.len() as f64 / a.cycle.len().max(b.cycle.len()).max(1) as f64;
        if percent >= SHARED_PERCENT_MIN {
            return Vec::new();
        }
        vec![format!(
            "the runs share {} cycles only: A has {} and ends at {:.3} s, B has {} and ends at {:.3} s",
            self.rows.len(),
            a.cycle.len(),
            a.end_seconds(),
            b.cycle.len(),
            b.end_seconds()
        )]
    }

    /// Rows before and after that count as the same time.
    pub(super) fn reach(&self, time_seconds: f64) -> usize {
        let rows = libm::floor(time_seconds / self.period_seconds + 1e-6).clamp(0.0, 100_000.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped"
        )]
        let rows = rows as usize;
        rows
    }
}

fn wide(row: usize) -> u64 {
    u64::try_from(row).unwrap_or(u64::MAX)
}

fn row(wide: u64) -> usize {
    usize::try_from(wide).unwrap_or(usize::MAX)
}

/// Two signals side by side, cycle by cycle, without tolerance of time.
pub(super) struct SignalDeviation {
    /// Root mean square of the differences.
    pub(super) rms: f64,
    /// By how much B comes later, by the shift that makes the root mean square least.
    pub(super) lag_seconds: f64,
}

impl SignalDeviation {
    /// Of values at the shared cycles; none where no cycle has both.
    pub(super) fn of(a: &[f64], b: &[f64], period_seconds: f64) -> Option<Self> {
        let straight = mean_square(a, b, 0, 1)?;
        let reach = libm::round(LAG_SECONDS_MAX / period_seconds).clamp(0.0, LAG_ROWS_MAX);
        #[expect(clippy::cast_possible_truncation, reason = "clamped")]
        let reach = reach as i32;
        // A shift must be worth it, or noise would look like a lag.
        let stride = a.len() / LAG_SAMPLES_MAX + 1;
        let mut least = (mean_square(a, b, 0, stride)? * LAG_GAIN, 0);
        for shift in (-reach..=reach).filter(|_| straight > 0.0) {
            let found = mean_square(a, b, shift, stride);
            if let Some(found) = found.filter(|found| *found < least.0) {
                least = (found, shift);
            }
        }
        Some(Self {
            rms: libm::sqrt(straight),
            lag_seconds: f64::from(least.1) * period_seconds,
        })
    }
}

/// Mean square of the differences where B is taken so many rows later, of every so many rows; none where no row is left.
fn mean_square(a: &[f64], b: &[f64], shift: i32, stride: usize) -> Option<f64> {
    let rows = usize::try_from(shift.unsigned_abs()).ok()?;
    let (a, b) = match shift {
        0.. => (a, b.get(rows..)?),
        _ => (a.get(rows..)?, b),
    };
    let (mut sum, mut count) = (0.0, 0.0);
    for (a, b) in a.iter().zip(b).step_by(stride) {
        let difference = b - a;
        if !difference.is_nan() {
            sum += difference * difference;
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum / count)
}

/// How far each value lies outside the range of the others within `reach` rows; NaN where either has none.
pub(super) fn outside(values: &[f64], others: &[f64], reach: usize) -> Series<f64> {
    let (lows, highs) = (
        running(others, reach, |new, old| new <= old),
        running(others, reach, |new, old| new >= old),
    );
    let ranges = lows.iter().zip(&highs);
    let distances = values.iter().zip(ranges).map(|(value, (low, high))| {
        // A value is NaN where it or the others are missing, which max would hide.
        let (low, high) = (*low, *high);
        if value.is_nan() || low.is_nan() {
            f64::NAN
        } else {
            f64::max(f64::max(low - value, value - high), 0.0)
        }
    });
    distances.collect()
}

/// The best value within `reach` places before and after each, in linear time: a queue holds those that may still win.
fn running(values: &[f64], reach: usize, beats: impl Fn(f64, f64) -> bool) -> Series<f64> {
    let mut queue = std::collections::VecDeque::new();
    let mut best = SeriesWriter::default();
    let mut next = 0;
    for place in 0..values.len() {
        while next < values.len() && next <= place.saturating_add(reach) {
            let value = values[next];
            if !value.is_nan() {
                while queue.back().is_some_and(|(_, last)| beats(value, *last)) {
                    queue.pop_back();
                }
                queue.push_back((next, value));
            }
            next += 1;
        }
        while queue
            .front()
            .is_some_and(|(first, _)| first + reach < place)
        {
            queue.pop_front();
        }
        best.push(queue.front().map_or(f64::NAN, |(_, value)| *value));
    }
    best.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_later_value_is_not_a_different_one() {
        let step = |at: usize| -> Vec<f64> {
            (0..100)
                .map(|row| if row < at { 0.0 } else { 1.0 })
                .collect()
        };
        let most = |reach| {
            let distances = outside(&step(50), &step(53), reach);
            distances.iter().copied().fold(0.0, f64::max)
        };
        assert_eq!(most(3), 0.0);
        assert_eq!(most(2), 1.0);
    }

    #[test]
    fn a_deviation_is_root_mean_square_and_lag() {
        let course = |delay: f64| -> Vec<f64> {
            let rows = (0..1000_u32).map(|row| 0.01 * (f64::from(row) - delay));
            rows.map(libm::sin).collect()
        };
        let of = |delay, period| SignalDeviation::of(&course(0.0), &course(delay), period).unwrap();
        let late = of(20.0, 0.01);
        assert!(
            (late.lag_seconds - 0.2).abs() < 1e-9,
            "{}",
            late.lag_seconds
        );
        assert!((of(-20.0, 0.01).lag_seconds + 0.2).abs() < 1e-9);
        let same = of(0.0, 0.01);
        assert_eq!((same.rms, same.lag_seconds), (0.0, 0.0));
        let apart = SignalDeviation::of(&[1.0, 2.0, f64::NAN], &[1.5, 2.5, 9.0], 1.0).unwrap();
        assert!((apart.rms - 0.5).abs() < 1e-12);
        assert!(SignalDeviation::of(&[f64::NAN], &[1.0], 1.0).is_none());
    }

    #[test]
    fn missing_values_are_not_compared() {
        let found = outside(&[1.0, f64::NAN, 3.0], &[1.0, 5.0, f64::NAN], 0);
        assert_eq!(found[0], 0.0);
        assert!(found[1].is_nan() && found[2].is_nan());
    }

    proptest! {
        #[test]
        fn the_running_best_is_that_of_each_window(values in prop::collection::vec(prop_oneof![5 => -9.0..9.0f64, 1 => Just(f64::NAN)], 0..60), reach in 0usize..9) {
            let best = running(&values, reach, |new, old| new >= old);
            for (place, best) in best.iter().enumerate() {
                let window = &values[place.saturating_sub(reach)..(place + reach + 1).min(values.len())];
                let expected = window.iter().copied().filter(|value| !value.is_nan()).fold(f64::NAN, f64::max);
                prop_assert!(*best == expected || (best.is_nan() && expected.is_nan()));
            }
        }
    }
}
