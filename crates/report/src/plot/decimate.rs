//! Leaves out the points of a curve that cannot be seen, so that a page stays small for a run of any length.

use std::collections::BTreeSet;
use std::ops::Range;

use super::range::{NOTHING, extended, finite_range};
use super::scale::{DrawingScale, SIDE};

/// Joined points, in whole units of the drawing.
pub(super) type Polyline = Vec<(i32, i32)>;

/// Width of a pixel column in units of the drawing.
const COLUMN: i32 = 80;

/// Number of parts between gaps from which they are drawn as one within a pixel column. They cannot be distinguished, and would let
/// the page grow with the run.
const PARTS_MANY: usize = 6;

/// Width and height of a cell for a path in the plane.
const CELL: (i32, i32) = (80, 256);

/// Returns a curve over time: the first, the lowest, the highest and the last point of each pixel column. A point that is not
/// finite interrupts it.
pub(super) fn over_time(
    points: impl Iterator<Item = (f64, f64)>,
    scale: &DrawingScale,
) -> Vec<Polyline> {
    let mut lines = Vec::new();
    let mut line = Polyline::new();
    let mut points = points.peekable();
    let (mut x, mut y) = (Vec::new(), Vec::new());
    while let Some((first, _)) = points.peek() {
        let until = column_end(scale.along(*first));
        x.clear();
        y.clear();
        while let Some(point) = points.next_if(|(x, _)| scale.along(*x) < until) {
            x.push(point.0);
            y.push(point.1);
        }
        if x.is_empty() {
            // The first point has no place.
            end(&mut line, &mut lines);
            points.next();
            continue;
        }
        if let Some(range) = finite_range(&y) {
            draw(&x, &y, range, scale, &mut line);
            continue;
        }
        for (number, part) in parts(&y).into_iter().enumerate() {
            if number > 0 {
                end(&mut line, &mut lines);
            }
            if !part.is_empty() {
                let (x, y) = (&x[part.clone()], &y[part]);
                let range = extended(NOTHING, y.iter().copied());
                draw(x, y, range, scale, &mut line);
            }
        }
    }
    end(&mut line, &mut lines);
    lines
}

/// Returns single samples over time: the first, the lowest, the highest and the last one of each pixel column.
pub(super) fn points(samples: impl Iterator<Item = (f64, f64)>, scale: &DrawingScale) -> Polyline {
    let mut points = Polyline::new();
    let mut column = Vec::new();
    let mut until = f64::NEG_INFINITY;
    for (x, y) in samples {
        let (along, down) = scale.place(x, y);
        let Some(point) = whole((along, down)) else {
            continue;
        };
        if along >= until {
            points.extend(extremes(&column));
            column.clear();
            until = column_end(along);
        }
        column.push(point);
    }
    points.extend(extremes(&column));
    points
}

/// Returns the first, the lowest, the highest and the last of some points, each once and in their order.
fn extremes(points: &[(i32, i32)]) -> impl Iterator<Item = (i32, i32)> {
    let places = || 0..points.len();
    let by_height = |place: &usize| points[*place].1;
    let ends = [places().next(), places().next_back()];
    let heights = [
        places().min_by_key(by_height),
        places().max_by_key(by_height),
    ];
    let mut found = Vec::from_iter(ends.into_iter().chain(heights).flatten());
    found.sort_unstable();
    found.dedup();
    found.into_iter().map(|place| points[place])
}

/// Returns a path in the plane. Places that it passes a second time are not drawn again.
pub(super) fn path(points: impl Iterator<Item = (f64, f64)>) -> Vec<Polyline> {
    let mut lines = Vec::new();
    let mut line = Polyline::new();
    let mut passed = BTreeSet::new();
    let mut last = None;
    let mut before = None;
    for point in points {
        // A value that is held for several cycles is the same point in all of them.
        if before.replace(point) == Some(point) {
            continue;
        }
        let Some(point) = whole(point) else {
            end(&mut line, &mut lines);
            last = None;
            continue;
        };
        if last.is_some_and(|last| cell(last) == cell(point)) {
            continue;
        }
        let is_new = passed.insert(cell(point));
        if is_new && line.is_empty() {
            line.extend(last);
        }
        if is_new || !line.is_empty() {
            line.push(point);
        }
        if !is_new {
            end(&mut line, &mut lines);
        }
        last = Some(point);
    }
    end(&mut line, &mut lines);
    lines
}

/// Returns the end of the pixel column of a place: from there on, whole units belong to the next.
fn column_end(place: f64) -> f64 {
    f64::from((nearest(place) / COLUMN + 1) * COLUMN) - 0.5
}

/// Returns the parts of a pixel column between heights that are not finite. If these are many, the parts are one, and only a gap
/// at an edge stays.
fn parts(y: &[f64]) -> Vec<Range<usize>> {
    let mut begin = 0;
    let parts = y.split(|y| !y.is_finite()).map(|part| {
        let part = begin..begin + part.len();
        begin = part.end + 1;
        part
    });
    let parts = Vec::from_iter(parts);
    let drawn = Vec::from_iter(parts.iter().filter(|part| !part.is_empty()));
    let (Some(first), Some(last), PARTS_MANY..) = (drawn.first(), drawn.last(), drawn.len()) else {
        return parts;
    };
    let all = first.start..last.end;
    let edges = [all.start > 0, all.end < y.len()];
    let [before, after] = edges.map(|is_gap| is_gap.then_some(0..0));
    Vec::from_iter([before, Some(all), after].into_iter().flatten())
}

/// Draws the first, the lowest, the highest and the last of some points; the first and the last one must be finite.
fn draw(x: &[f64], y: &[f64], (low, high): (f64, f64), scale: &DrawingScale, line: &mut Polyline) {
    let first_at = |wanted| y.iter().position(|y| *y == wanted).unwrap_or(0);
    let mut places = [0, first_at(low), first_at(high), y.len() - 1];
    places.sort_unstable();
    for place in places {
        let (along, down) = scale.place(x[place], y[place]);
        push(line, (nearest(along), nearest(down)));
    }
}

/// Appends a point, unless the line is there already. Of a level stretch only the ends are kept.
fn push(line: &mut Polyline, point: (i32, i32)) {
    match line[..] {
        [.., last] if last == point => {}
        [.., before, last] if before.1 == last.1 && last.1 == point.1 && before.0 <= last.0 => {
            line.pop();
            line.push(point);
        }
        _ => line.push(point),
    }
}

fn end(line: &mut Polyline, lines: &mut Vec<Polyline>) {
    if !line.is_empty() {
        lines.push(std::mem::take(line));
    }
}

/// Returns the nearest whole units; `None` for a point that is not finite.
fn whole((x, y): (f64, f64)) -> Option<(i32, i32)> {
    (x.is_finite() && y.is_finite()).then(|| (nearest(x), nearest(y)))
}

/// Returns the nearest whole unit.
fn nearest(value: f64) -> i32 {
    let bounded = value.clamp(-1e9, 1e9);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "clamped to far less than i32"
    )]
    let rounded = bounded.round() as i32;
    rounded
}

/// Returns the cell of a point. Points outside of the drawing are in the cells at its edges, which bounds the number of cells.
fn cell((x, y): (i32, i32)) -> (i32, i32) {
    let side = nearest(SIDE);
    (x.clamp(0, side) / CELL.0, y.clamp(0, side) / CELL.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Drawing with the units of the values.
    const UNITS: DrawingScale = DrawingScale {
        x: 0.0,
        y: 0.0,
        right: 1.0,
        down: 1.0,
    };

    fn decimated(points: impl Iterator<Item = (f64, f64)>) -> Vec<Polyline> {
        over_time(points, &UNITS)
    }

    #[test]
    fn single_samples_stay_and_of_many_the_extremes() {
        let samples = (0..30).map(|row| {
            let y = f64::from(if row == 13 { 900 } else { row });
            (f64::from(10 * row), if row % 3 == 1 { y } else { f64::NAN })
        });
        // The ends of the rows 1, 4 and 7 are their extremes, so they suffice; 13 is the lowest of 10 and 13, since the heights
        // point down.
        let expected = [1, 4, 7, 10, 13, 16, 19, 22, 25, 28]
            .map(|row| (10 * row, if row == 13 { 900 } else { row }));
        let found = points(samples, &UNITS);
        assert!(
            found.iter().all(|point| expected.contains(point)),
            "{found:?}"
        );
        assert!(
            found.contains(&(130, 900)) && found[0] == (10, 1),
            "{found:?}"
        );
        assert_eq!(found.last(), Some(&(280, 28)));
        let many = [(0.0, 1.0), (1.0, 7.0), (2.0, 2.0), (3.0, -3.0), (4.0, 2.0)];
        let many = points(many.into_iter(), &UNITS);
        assert_eq!(many, [(0, 1), (1, 7), (3, -3), (4, 2)]);
    }

    #[test]
    fn a_peak_of_one_sample_stays() {
        let points = (0..100_000).map(|sample| {
            let y = if sample == 50_123 { 900.0 } else { 500.0 };
            (f64::from(sample) * SIDE / 1e5, y)
        });
        let lines = decimated(points);
        assert_eq!(lines.len(), 1);
        assert!(lines[0].iter().any(|point| point.1 == 900), "{lines:?}");
        assert!(lines[0].len() < 10, "{lines:?}");
    }

    #[test]
    fn a_gap_stays() {
        let nan = (f64::NAN, f64::NAN);
        let points = [(0.0, 1.0), (100.0, 2.0), nan, (200.0, 3.0), nan, nan];
        assert_eq!(
            decimated(points.into_iter()),
            [vec![(0, 1), (100, 2)], vec![(200, 3)]]
        );
    }

    #[test]
    fn gaps_everywhere_do_not_make_a_long_curve_larger() {
        let size = |samples: u32| {
            let points = (0..samples).map(|sample| {
                let y = match sample {
                    _ if sample % 2 == 1 => f64::NAN,
                    _ if sample == samples / 2 => 900.0,
                    _ => f64::from(sample % 7),
                };
                (f64::from(sample) * SIDE / f64::from(samples), y)
            });
            let lines = decimated(points);
            let highest = lines.iter().flatten().map(|point| point.1).max();
            assert_eq!(highest, Some(900));
            lines.iter().map(Vec::len).sum::<usize>()
        };
        assert!(size(400_000) <= 5 * 800, "{}", size(400_000));
    }

    #[test]
    fn of_many_gaps_in_a_pixel_those_at_its_edges_stay() {
        let points = |missing: fn(u32) -> bool| {
            (0..60).map(move |sample| {
                let y = if missing(sample) { f64::NAN } else { 1.0 };
                (f64::from(sample) * 4.0, y)
            })
        };
        // The middle one of three pixels has the gaps.
        let inside = decimated(points(|sample| {
            (22..34).contains(&sample) && sample % 2 == 0
        }));
        assert_eq!(inside, [vec![(0, 1), (236, 1)]]);
        let at_its_begin = decimated(points(|sample| {
            (20..34).contains(&sample) && sample % 2 == 0
        }));
        assert_eq!(
            at_its_begin,
            [vec![(0, 1), (76, 1)], vec![(84, 1), (236, 1)]]
        );
    }

    #[test]
    fn a_loop_that_is_passed_often_is_drawn_once() {
        let turn = |number: u32| f64::from(number % 1000) * std::f64::consts::TAU / 1000.0;
        let circle = |number| {
            (
                32e3 + 20e3 * libm::cos(turn(number)),
                32e3 + 25e3 * libm::sin(turn(number)),
            )
        };
        let points = |turns: u32| {
            path((0..turns * 1000).map(circle))
                .iter()
                .map(Vec::len)
                .sum::<usize>()
        };
        assert!(points(1) > 500);
        assert!(points(50) <= points(1) + 5, "{} {}", points(50), points(1));
    }

    #[test]
    fn whole_units_are_the_nearest() {
        let below_half = 0.5 - f64::EPSILON / 4.0;
        for (value, nearest) in [
            (0.0, 0),
            (below_half, 0),
            (-below_half, 0),
            (0.5, 1),
            (-0.5, -1),
            (2.5, 3),
            (-1e10, -1_000_000_000),
        ] {
            assert_eq!(whole((value, value)), Some((nearest, nearest)), "{value}");
        }
        assert_eq!(whole((f64::NAN, 0.0)), None);
    }

    proptest! {
        #[test]
        fn rounding_is_that_of_libm(value in -1e6..1e6f64) {
            prop_assert_eq!(f64::from(whole((value, 0.0)).unwrap().0), libm::round(value) + 0.0);
        }

        #[test]
        fn the_size_is_bounded(values in prop::collection::vec(prop_oneof![9 => -1e9..1e9f64, 1 => Just(f64::NAN)], 0..20_000)) {
            let count = values.len() as f64;
            let points = values.iter().enumerate().map(|(number, value)| (number as f64 * SIDE / count, *value));
            let lines = decimated(points);
            let columns = 64_000 / usize::try_from(COLUMN).unwrap() + 2;
            let gaps = values.iter().filter(|value| value.is_nan()).count();
            prop_assert!(lines.iter().map(Vec::len).sum::<usize>() <= 4 * (columns + gaps));
        }
    }
}
