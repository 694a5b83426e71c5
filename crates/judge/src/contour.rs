//! The distance of several loops together from the path of their set-points.

use std::ops::Range;

use recording::timeline::Timeline;
use scenario::contour::Contour;
use scenario::events::Window;

use crate::evidence::{Absence, Evidence, Known, checked};
use crate::metric::Metric;

/// Time before and after a sample within which the nearest point of the path is searched for.
const SEARCH_SECONDS: f64 = 0.5;
/// Number of samples for which the path is read at once.
const PIECE_ROWS: usize = 1 << 13;

/// Returns the rows of the contours whose first axis is this loop, with which they are judged: longest distance from the path,
/// and RMS of the distance.
///
/// The path is the line through the set-points of the cycles. The error of a sample is the distance of the measured point from
/// the nearest point of the path: an axis that is late makes no error as long as it stays on the path.
pub(crate) fn metrics(evidence: &Evidence<'_>) -> Vec<Metric> {
    let contours = evidence.own_contours();
    let rows = contours.flat_map(|contour| rows(evidence, contour));
    rows.collect()
}

fn rows(evidence: &Evidence<'_>, contour: &Contour) -> Vec<Metric> {
    let axes = contour.loops.iter();
    let axes = Vec::from_iter(axes.filter_map(|name| evidence.for_loop(name)));
    let ends = axes.iter().map(|axis| axis.trial.judged_end_seconds());
    let end_seconds = ends.fold(f64::INFINITY, f64::min);
    let window = window(contour, end_seconds);
    let unseen = axes.iter().find_map(|axis| {
        let absence = axis.seen(window).err()?;
        Some((axis, absence.of(axis.control_loop.name())))
    });
    let (axis, values) = match unseen {
        _ if window.from_seconds >= window.until_seconds => {
            let reason = "the window begins behind what is judged";
            (evidence, Err(reason.into()))
        }
        Some((axis, absence)) => (axis, Err(absence)),
        None => (evidence, values(contour, &axes, end_seconds)),
    };
    let named = contour.rows().into_iter().enumerate();
    let rows = named.filter_map(|(place, expected)| {
        let value = values.clone().map(|values| values[place]);
        axis.row(expected, value)
    });
    rows.collect()
}

/// Returns the longest distance and the RMS of the distances.
fn values(
    contour: &Contour,
    axes: &[Evidence<'_>],
    end_seconds: f64,
) -> Result<[Known; 2], Absence> {
    let window = window(contour, end_seconds);
    let timelines = Vec::from_iter(axes.iter().map(|axis| axis.timeline));
    let is_left_out = |time: f64| axes.iter().any(|axis| axis.leaves_out(time, time));
    let errors =
        contour_errors(contour, &timelines, end_seconds).filter(|(time, _)| !is_left_out(*time));
    let (mut longest, mut squares, mut count) = (0.0, 0.0, 0.0);
    for (_, error) in errors {
        longest = f64::max(longest, error);
        squares += error * error;
        count += 1.0;
    }
    if count > 0.0 {
        let is_cut =
            |axis: &&Evidence<'_>| axis.leaves_out(window.from_seconds, window.until_seconds);
        let cut = axes.iter().find(is_cut).unwrap_or(&axes[0]);
        let rms = checked(f64::sqrt(squares / count))?;
        Ok([cut.of_largest(window, checked(longest))?, rms.into()])
    } else if axes.iter().all(Evidence::has_all) {
        Err("no sample of all axes in the window".into())
    } else {
        Err(Absence::left_out())
    }
}

/// Returns the window of a contour, as far as it is judged.
fn window(contour: &Contour, end_seconds: f64) -> Window {
    let until_seconds = contour.until_seconds.unwrap_or(end_seconds);
    Window::new(contour.from_seconds, until_seconds.min(end_seconds))
}

/// Returns the distance of each sample in a contour's window from the path, with its time: seconds, and the unit of the loops.
/// `axes` are the timelines of the contour's loops.
pub fn contour_errors<'a>(
    contour: &Contour,
    axes: &'a [&'a Timeline],
    end_seconds: f64,
) -> impl Iterator<Item = (f64, f64)> + use<'a> {
    let window = window(contour, end_seconds);
    let seconds = window.from_seconds..window.until_seconds;
    let lengths = axes.iter().map(|axis| axis.time_seconds.len());
    let rows = lengths.min().unwrap_or(0);
    let pieces = (0..rows)
        .step_by(PIECE_ROWS)
        .map(move |begin| begin..rows.min(begin + PIECE_ROWS));
    pieces.flat_map(move |piece| {
        let path = Path::about(axes, piece.clone(), rows);
        let times = axes[0].time_seconds.range(piece.clone());
        let positions = axes.iter().map(|axis| axis.position().range(piece.clone()));
        let (mut positions, mut point) = (Vec::from_iter(positions), Vec::new());
        let seconds = seconds.clone();
        times.filter_map(move |time| {
            point.clear();
            point.extend(positions.iter_mut().filter_map(Iterator::next));
            let is_seen = seconds.contains(&time) && point.iter().all(|value| !value.is_nan());
            is_seen.then(|| (time, path.distance(&point, time)))
        })
    })
}

/// Stretch of a path.
struct Path {
    /// Set-points of each axis.
    axes: Vec<Vec<f64>>,
    times: Vec<f64>,
}

impl Path {
    /// Returns the path about some of the first `end` rows.
    fn about(axes: &[&Timeline], rows: Range<usize>, end: usize) -> Self {
        let times = axes[0].time_seconds.part(0..end);
        let at = |row: usize| times.get(row).unwrap_or_default();
        let (from, until) = (at(rows.start), at(rows.end - 1));
        let begin = times.partition_point(|time| time < from - SEARCH_SECONDS);
        let end = times.partition_point(|time| time <= until + SEARCH_SECONDS);
        let set_points = axes.iter().map(|axis| axis.set_point().range(begin..end));
        Self {
            axes: set_points.map(Iterator::collect).collect(),
            times: times.range(begin..end).collect(),
        }
    }

    /// Returns the distance of a point from the path about a time.
    fn distance(&self, point: &[f64], time: f64) -> f64 {
        let begin = self
            .times
            .partition_point(|other| *other < time - SEARCH_SECONDS);
        let end = self
            .times
            .partition_point(|other| *other <= time + SEARCH_SECONDS);
        let pieces =
            (begin..end).map(|row| self.distance_from_piece(point, row, (row + 1).min(end - 1)));
        pieces.fold(f64::INFINITY, f64::min)
    }

    /// Returns the distance of a point from the straight line between the set-points of two rows.
    fn distance_from_piece(&self, point: &[f64], from: usize, to: usize) -> f64 {
        let coordinates = || {
            self.axes.iter().zip(point).map(|(axis, measured)| {
                let (start, end) = (axis[from], axis[to]);
                (end - start, measured - start)
            })
        };
        let length_squared: f64 = coordinates().map(|(along, _)| along * along).sum();
        let projected: f64 = coordinates()
            .map(|(along, from_start)| along * from_start)
            .sum();
        let share = if length_squared > 0.0 {
            (projected / length_squared).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let squares = coordinates().map(|(along, from_start)| (from_start - share * along).powi(2));
        squares.sum::<f64>().sqrt()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use can::CanFrame;
    use plan::Plan;
    use plan::catalogue::Catalogue;
    use recording::log::Stamped;
    use recording::timeline::decode;
    use scenario::Beside;

    use super::*;
    use crate::{Circumstances, judge};

    /// Two axes hold (30, 30) mm for 1 s; from 0.5 s on they measure (30.3, 30.4) mm.
    #[test]
    fn a_contour_is_judged_in_its_window_as_far_as_its_loops_are() {
        let judged = |expected: &str| {
            let text = format!(
                "schema = 1\nrig = \"two_axes\"\nname = \"point\"\nduration_seconds = 1.0\n[controller.all.pid]\n\
                 proportional_amperes_per_metre = 22.8\n\
                 integral_amperes_per_metre_second = 37.9\n\
                 derivative_ampere_seconds_per_metre = 3.59\n\
                 [[reference.hold]]\nloop = \"x\"\nat_seconds = 0.0\nposition_millimetres = 30.0\n\
                 [[reference.hold]]\nloop = \"y\"\nat_seconds = 0.0\nposition_millimetres = 30.0\n\
                 [[expect.contour]]\nloops = [\"x\", \"y\"]\ncontour_error_millimetres_max = {{ max = 1.0 }}\n{expected}"
            );
            let beside = Beside::new("point.toml".as_ref());
            let read = |_: &str| unreachable!("no table");
            let plan = Plan::parse(&beside, text, read, &Catalogue::shipped()).unwrap();
            let measured = |axis: &str, position: f64| {
                let message = format!("{axis}_tpdo1");
                let mut feedback = plan.database().builder(&message).unwrap();
                for (name, value) in [
                    ("statusword_state", 39.0),
                    ("position_millimetres", position),
                ] {
                    let path = format!("{message}.{name}");
                    feedback.set(&plan.database().signal(&path).unwrap(), value);
                }
                feedback.frame()
            };
            let cycles = (0..500_u64).flat_map(|cycle| {
                let [x, y] = if cycle < 250 { [30.0; 2] } else { [30.3, 30.4] };
                let start = Duration::from_millis(2 * cycle + 1);
                let frames = [
                    CanFrame::new(0x080, &[]),
                    measured("x", x),
                    measured("y", y),
                ];
                frames.map(|frame| Stamped::new(start, frame))
            });
            let on = ["x", "y"].map(|axis| Stamped::new(Duration::ZERO, measured(axis, 30.0)));
            let frames = on.into_iter().chain(cycles);
            let timelines = decode(&frames.collect::<Vec<_>>().into(), &plan).unwrap();
            let rows = judge(&plan, &timelines, &Circumstances::default()).metrics;
            ["max", "rms"].map(|end| {
                let name = format!("x_y.contour_error_millimetres_{end}");
                let row = rows.iter().find(|row| row.name == name).unwrap();
                (row.value, row.remark.clone())
            })
        };
        let seen = |value| (Some(value), None);
        assert_eq!(judged(""), [seen(0.5), seen(0.353_553)]);
        assert_eq!(judged("from_seconds = 0.5\n"), [seen(0.5), seen(0.5)]);
        let ended = "from_seconds = 0.5\n[expect.all]\njudged_until_seconds = 0.5\n";
        let reason = "the window begins behind what is judged".to_owned();
        let unseen = (None, Some(reason));
        assert_eq!(judged(ended), [unseen.clone(), unseen]);
    }

    /// Checks the example of `docs/reference/metrics.md`.
    #[test]
    fn an_axis_that_is_late_on_the_path_makes_no_error() {
        let path = Path {
            axes: vec![vec![30.0, 40.0, 40.0], vec![30.0; 3]],
            times: vec![0.0, 0.1, 0.2],
        };
        for (point, wanted) in [
            ([36.0, 30.2], 0.2),
            ([36.0, 30.0], 0.0),
            ([29.7, 29.6], 0.5),
            ([40.3, 30.4], 0.5),
        ] {
            let distance = path.distance(&point, 0.1);
            assert!((distance - wanted).abs() < 1e-9, "{point:?}: {distance}");
        }
    }

    #[test]
    fn a_path_that_comes_back_is_no_short_cut() {
        let path = Path {
            axes: vec![vec![0.0, 10.0, 10.0, 0.0], vec![0.0, 0.0, 10.0, 0.0]],
            times: vec![0.0, 0.4, 0.8, 1.2],
        };
        // The point is near the last piece, which lies more than half a second ahead.
        let distance = path.distance(&[4.0, 4.0], 0.2);
        assert!((distance - 4.0).abs() < 1e-9, "{distance}");
    }
}
