//! The cycles that two runs share, and the distances of the values of one from those of the other.

use recording::timeline::{Series, SeriesWriter, Timeline};

/// Largest lag that is searched for, in seconds and in cycles.
const LAG_SECONDS_MAX: f64 = 0.5;
const LAG_ROWS_MAX: f64 = 500.0;
/// Part of the mean square that must be left at most for a lag to be reported.
const LAG_GAIN: f64 = 0.9;
/// Largest number of values to compare for a lag. If there are more, only every second, third … is compared.
const LAG_SAMPLES_MAX: usize = 10_000;
/// Smallest share of the longer run's cycles for two runs to agree.
const SHARED_PERCENT_MIN: f64 = 99.0;

/// Cycles that both runs have, without the last of them.
pub(super) struct Shared {
    /// Rows of the first and of the second run.
    pub(super) rows: Series<[u64; 2]>,
    pub(super) time_seconds: Series<f64>,
    pub(super) period_seconds: f64,
}

impl Shared {
    pub(super) fn of(a: &Timeline, b: &Timeline) -> Self {
        let mut rows = SeriesWriter::default();
        let mut right = (0..).zip(&b.cycle).peekable();
        for (left, cycle) in (0..).zip(&a.cycle) {
            while right.next_if(|(_, other)| *other < cycle).is_some() {}
            if let Some((right, _)) = right.next_if(|(_, other)| *other == cycle) {
                rows.push([left, right]);
            }
        }
        // In its last cycle a run has already been stopped.
        rows.pop();
        let rows = rows.finish();
        Self {
            time_seconds: values_at(&rows, 0, &a.time_seconds),
            rows,
            period_seconds: a.period_seconds,
        }
    }

    /// Returns the values of both runs in the shared cycles.
    pub(super) fn values(&self, a: &Series<f64>, b: &Series<f64>) -> [Series<f64>; 2] {
        [values_at(&self.rows, 0, a), values_at(&self.rows, 1, b)]
    }

    pub(super) fn remark(&self, a: &Timeline, b: &Timeline) -> Option<String> {
        let percent =
            100.0 * self.rows.len() as f64 / a.cycle.len().max(b.cycle.len()).max(1) as f64;
        (percent < SHARED_PERCENT_MIN).then(|| {
            format!(
                "the runs share {} cycles only: A has {} and ends at {:.3} s, B has {} and ends at {:.3} s",
                self.rows.len(),
                a.cycle.len(),
                a.end_seconds(),
                b.cycle.len(),
                b.end_seconds()
            )
        })
    }
}

/// Returns the number of rows before and after that count as the same time.
pub(super) fn reach(time_seconds: f64, period_seconds: f64) -> usize {
    clamped(libm::floor(time_seconds / period_seconds + 1e-6), 100_000.0)
}

/// Returns a whole number of rows, at most `rows_max`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped"
)]
fn clamped(rows: f64, rows_max: f64) -> usize {
    rows.clamp(0.0, rows_max) as usize
}

/// Returns the values of a run in the shared rows.
fn values_at(rows: &Series<[u64; 2]>, side: usize, values: &Series<f64>) -> Series<f64> {
    let rows = rows.iter().map(|rows| rows[side]);
    let places = rows.map(|row| usize::try_from(row).unwrap_or(usize::MAX));
    values.at(places).collect()
}

/// Compares two signals at the shared cycles, without tolerance of time. Returns the root mean square of their differences, and the
/// seconds by which B comes later: the shift with the least root mean square. `None` if no cycle has both.
pub(super) fn deviation(
    a: &Series<f64>,
    b: &Series<f64>,
    period_seconds: f64,
) -> Option<(f64, f64)> {
    let straight = mean_squares(a, b, 0, 1)[0]?;
    let reach = clamped(libm::round(LAG_SECONDS_MAX / period_seconds), LAG_ROWS_MAX);
    let stride = a.len() / LAG_SAMPLES_MAX + 1;
    let later = mean_squares(a, b, reach, stride);
    let earlier = mean_squares(b, a, reach, stride);
    // A shift must reduce the difference clearly, or noise would look like a lag.
    let mut least = (later[0]? * LAG_GAIN, 0.0);
    let shifts = (0_u32..).map(f64::from);
    let earlier = Vec::from_iter(shifts.clone().zip(earlier).skip(1))
        .into_iter()
        .rev()
        .map(|(rows, found)| (-rows, found));
    // The shifts go from the earliest to the latest. The first of equal ones counts.
    for (shift, found) in earlier.chain(shifts.zip(later)) {
        if let Some(found) = found.filter(|found| straight > 0.0 && *found < least.0) {
            least = (found, shift);
        }
    }
    // The best shift may lie beyond the last one that was tried: then it is unknown.
    let is_inside = least.1.abs() < reach as f64;
    let shift = if is_inside { least.1 } else { 0.0 };
    Some((libm::sqrt(straight), shift * period_seconds))
}

/// Returns the mean squares of the differences if `others` are taken 0, 1, … up to `rows_max` rows later, from every `stride`-th
/// row; `None` if no row is left. A single pass over the values serves all shifts, since the values may exceed the memory.
fn mean_squares(
    values: &Series<f64>,
    others: &Series<f64>,
    rows_max: usize,
    stride: usize,
) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0.0); rows_max + 1];
    if stride == 1 && rows_max == 0 {
        let pairs = values.iter().zip(others);
        pairs.for_each(|(value, other)| add_square(&mut sums[0], value, other));
    } else {
        for (begin, value) in (0..others.len()).zip(values).step_by(stride) {
            let within = others.range(begin..others.len().min(begin + sums.len()));
            let pairs = sums.iter_mut().zip(within);
            pairs.for_each(|(sum, other)| add_square(sum, value, other));
        }
    }
    let means = sums.into_iter();
    means
        .map(|(sum, count)| (count > 0.0).then(|| sum / count))
        .collect()
}

fn add_square((sum, count): &mut (f64, f64), value: f64, other: f64) {
    let difference = other - value;
    if !difference.is_nan() {
        *sum += difference * difference;
        *count += 1.0;
    }
}

/// Returns the distance of each value from the range of the others within `reach` rows, positive above it; NaN if either has none.
pub(super) fn outside(values: &Series<f64>, others: &Series<f64>, reach: usize) -> Series<f64> {
    let (lows, highs) = (
        running(others, reach, |new, old| new <= old),
        running(others, reach, |new, old| new >= old),
    );
    let ranges = lows.iter().zip(&highs);
    let distances = values.iter().zip(ranges).map(|(value, (low, high))| {
        // A value is NaN if it or the others are missing.
        if value.is_nan() || low.is_nan() {
            f64::NAN
        } else if (low..=high).contains(&value) {
            // Also an infinite value, whose difference from itself is NaN.
            0.0
        } else {
            value - value.clamp(low, high)
        }
    });
    distances.collect()
}

/// Returns the best value within `reach` places before and after each, in linear time: a queue holds those that may still win.
fn running(values: &Series<f64>, reach: usize, beats: impl Fn(f64, f64) -> bool) -> Series<f64> {
    let mut queue = std::collections::VecDeque::new();
    let mut best = SeriesWriter::default();
    let mut rest = values.iter().enumerate().peekable();
    for place in 0..values.len() {
        while let Some((next, value)) =
            rest.next_if(|(next, _)| *next <= place.saturating_add(reach))
        {
            if !value.is_nan() {
                while queue.back().is_some_and(|(_, last)| beats(value, *last)) {
                    queue.pop_back();
                }
                queue.push_back((next, value));
            }
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

    fn series(values: &[f64]) -> Series<f64> {
        values.to_vec().into()
    }

    #[test]
    fn a_later_value_is_not_a_different_one() {
        let step = |at: usize| -> Series<f64> {
            (0..100)
                .map(|row| if row < at { 0.0 } else { 1.0 })
                .collect()
        };
        let most = |reach| {
            let distances = outside(&step(50), &step(53), reach);
            distances.iter().fold(0.0, f64::max)
        };
        assert_eq!(most(3), 0.0);
        assert_eq!(most(2), 1.0);
    }

    #[test]
    fn a_deviation_is_root_mean_square_and_lag() {
        let course = |delay: f64| -> Series<f64> {
            let rows = (0..1000_u32).map(|row| 0.01 * (f64::from(row) - delay));
            rows.map(libm::sin).collect()
        };
        let of = |delay, period| deviation(&course(0.0), &course(delay), period).unwrap();
        let (_, lag_seconds) = of(20.0, 0.01);
        assert!((lag_seconds - 0.2).abs() < 1e-9, "{lag_seconds}");
        assert!((of(-20.0, 0.01).1 + 0.2).abs() < 1e-9);
        // Half a second is the end of the search: the lag may be longer.
        let (rms, lag_seconds) = of(60.0, 0.01);
        assert_eq!(lag_seconds, 0.0, "{rms}");
        assert_eq!(of(0.0, 0.01), (0.0, 0.0));
        let apart = [&[1.0, 2.0, f64::NAN], &[1.5, 2.5, 9.0]].map(|values| series(values));
        let (rms, _) = deviation(&apart[0], &apart[1], 1.0).unwrap();
        assert!((rms - 0.5).abs() < 1e-12);
        assert!(deviation(&series(&[f64::NAN]), &series(&[1.0]), 1.0).is_none());
    }

    #[test]
    fn missing_values_are_not_compared() {
        let found = outside(
            &series(&[1.0, f64::NAN, 3.0]),
            &series(&[1.0, 5.0, f64::NAN]),
            0,
        )
        .to_vec();
        assert_eq!(found[0], 0.0);
        assert!(found[1].is_nan() && found[2].is_nan());
    }

    /// Returns the mean square for a single shift, by going through all values for it.
    fn mean_square(a: &[f64], b: &[f64], rows: usize, stride: usize) -> Option<f64> {
        let pairs = a.iter().zip(b.get(rows..)?).step_by(stride);
        let squares = pairs.map(|(a, b)| (b - a) * (b - a));
        let squares = Vec::from_iter(squares.filter(|square| !square.is_nan()));
        let sum = squares.iter().fold(0.0, |sum, square| sum + square);
        (!squares.is_empty()).then(|| sum / squares.len() as f64)
    }

    proptest! {
        #[test]
        fn all_shifts_at_once_are_those_one_by_one(
            a in prop::collection::vec(prop_oneof![5 => -9.0..9.0f64, 1 => Just(f64::NAN)], 0..60),
            b in prop::collection::vec(-9.0..9.0f64, 0..60),
            reach in 0usize..9,
            stride in 1usize..5,
        ) {
            let expected = Vec::from_iter((0..=reach).map(|rows| mean_square(&a, &b, rows, stride)));
            prop_assert_eq!(mean_squares(&series(&a), &series(&b), reach, stride), expected);
        }

        #[test]
        fn the_running_best_is_that_of_each_window(values in prop::collection::vec(prop_oneof![5 => -9.0..9.0f64, 1 => Just(f64::NAN)], 0..60), reach in 0usize..9) {
            let best = running(&series(&values), reach, |new, old| new >= old);
            for (place, best) in best.iter().enumerate() {
                let window = &values[place.saturating_sub(reach)..(place + reach + 1).min(values.len())];
                let expected = window.iter().copied().filter(|value| !value.is_nan()).fold(f64::NAN, f64::max);
                prop_assert!(best == expected || (best.is_nan() && expected.is_nan()));
            }
        }
    }
}
