//! The range of the values in a plot.

use std::cmp::Ordering;

/// Range of no values.
pub(crate) const NOTHING: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// Extends a range by the finite ones of some values.
pub(crate) fn extended(range: (f64, f64), values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let finite = values.into_iter().filter(|value| value.is_finite());
    finite.fold(range, |(low, high), value| {
        (low.min(value), high.max(value))
    })
}

/// Returns a range that can be drawn: an empty one becomes 0 to 1, and a constant gets room above and below.
pub(super) fn with_room((low, high): (f64, f64)) -> (f64, f64) {
    if low > high {
        return (0.0, 1.0);
    }
    let least = (low.abs().max(high.abs()) * 1e-6).max(1e-9);
    if high - low < least {
        let room = if low == 0.0 { 1.0 } else { low.abs() * 0.1 };
        return (low - room, high + room);
    }
    (low, high)
}

/// Returns the range of all values except the rarest, with room around it, if the whole range is much larger.
pub(super) fn typical(mut values: Vec<f64>, whole: (f64, f64)) -> (f64, f64) {
    let tail = values.len() / 40;
    if tail == 0 {
        return whole;
    }
    // The values are finite, so the plain comparison suffices.
    let order = |left: &f64, right: &f64| left.partial_cmp(right).unwrap_or(Ordering::Equal);
    let (_, low, _) = values.select_nth_unstable_by(tail, order);
    let low = *low;
    let last = values.len() - 1 - tail;
    let (_, high, _) = values.select_nth_unstable_by(last, order);
    let (low, high) = with_room((low, *high));
    let room = (high - low) * 0.5;
    let cut = (
        f64::max(low - room, whole.0),
        f64::min(high + room, whole.1),
    );
    if whole.1 - whole.0 > 2.0 * (cut.1 - cut.0) {
        cut
    } else {
        whole
    }
}

/// Returns the least and the greatest of some values; `None` unless there are some and all are finite.
pub(super) fn finite_range(values: &[f64]) -> Option<(f64, f64)> {
    // The processor takes two values at a time.
    let (mut low, mut high, mut sum) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2], [0.0; 2]);
    let mut take = |lane: usize, value: f64| {
        low[lane] = if value < low[lane] { value } else { low[lane] };
        high[lane] = if value > high[lane] {
            value
        } else {
            high[lane]
        };
        // A sum that is not finite stays so.
        sum[lane] += value;
    };
    let (pairs, rest) = values.as_chunks::<2>();
    for [first, second] in pairs {
        take(0, *first);
        take(1, *second);
    }
    rest.iter().for_each(|value| take(0, *value));
    let is_finite = !values.is_empty() && (sum[0] + sum[1]).is_finite();
    is_finite.then(|| (low[0].min(low[1]), high[0].max(high[1])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_and_constants_have_a_range() {
        assert_eq!(with_room(NOTHING), (0.0, 1.0));
        assert_eq!(with_room((0.0, 0.0)), (-1.0, 1.0));
        let values = [f64::NAN, 10.0, f64::INFINITY];
        assert_eq!(with_room(extended(NOTHING, values)), (9.0, 11.0));
    }

    #[test]
    fn a_rare_peak_does_not_press_the_rest_flat() {
        let mut values: Vec<f64> = (0..1000).map(|number| f64::from(number % 10)).collect();
        assert_eq!(typical(values.clone(), (0.0, 9.0)), (0.0, 9.0));
        values[3] = 1e6;
        assert_eq!(typical(values, (0.0, 1e6)), (0.0, 13.5));
    }
}
