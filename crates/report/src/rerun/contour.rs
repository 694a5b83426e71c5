//! Two loops in the plane, one over the other: the paths of their set-points and of their positions, and a point that moves with
//! the time.

use re_sdk_types::archetypes::{LineStrips2D, Points2D};
use re_sdk_types::components::Radius;
use scenario::loops::Contour;

use super::output::{Output, send_rows, send_static};
use super::times;
use super::{RerunError, groups};
use crate::contour::{Axis, axes, window};
use crate::run::Run;

/// A point of a path nearer to the one before than this cannot be seen.
const STEP_MILLIMETRES: f64 = 0.02;
/// Free room round the paths, by their size.
const MARGIN: f64 = 0.1;

/// What the layout shows of it.
pub(super) struct Plane {
    pub(super) title: String,
    pub(super) group: String,
    /// From the least to the largest coordinate, across and down.
    pub(super) bounds: [[f64; 2]; 2],
}

/// Logs the contours of a scenario.
pub(super) fn log(output: &mut dyn Output, runs: &[Run<'_>]) -> Result<Vec<Plane>, RerunError> {
    let mut planes = Vec::new();
    for contour in runs[0].setup.contours.iter() {
        for pair in axes(contour, runs).windows(2) {
            planes.extend(log_plane(output, contour, [pair[0], pair[1]])?);
        }
    }
    Ok(planes)
}

fn log_plane(
    output: &mut dyn Output,
    contour: &Contour,
    axes: [Axis<'_>; 2],
) -> Result<Option<Plane>, RerunError> {
    let [x, y] = axes.map(|(_, run)| run.timeline);
    let [across, up] = axes.map(|(name, _)| name);
    let (mut wanted, mut measured) = (Vec::new(), Vec::new());
    for row in window(contour, &axes) {
        let set_points = [x, y].map(|axis| axis.set_point_millimetres[row]);
        let positions = [x, y].map(|axis| axis.position()[row]);
        add(&mut wanted, row, set_points);
        add(&mut measured, row, positions);
    }
    let Some(bounds) = bounds(wanted.iter().chain(&measured).map(|(_, point)| point)) else {
        return Ok(None);
    };
    let group = format!("contour/{across}_{up}");
    for (name, points, colour) in [
        ("set_point", &wanted, groups::ORANGE),
        ("measured", &measured, groups::SKY),
    ] {
        let line = points.iter().map(|(_, point)| place(*point));
        let strip = LineStrips2D::new([Vec::from_iter(line)])
            .with_colors([colour])
            .with_radii([Radius::new_ui_points(1.0)])
            .with_labels([name.replace('_', "-")])
            .with_show_labels(false);
        send_static(output, format!("{group}/{name}"), &strip)?;
    }
    let now = format!("{group}/now");
    let look = Points2D::update_fields()
        .with_colors([groups::SKY])
        .with_radii([Radius::new_ui_points(5.0)]);
    send_static(output, now.as_str(), &look)?;
    let moments = measured.iter().map(|(row, _)| times::moment(x, *row));
    let points = Points2D::new(measured.iter().map(|(_, point)| place(*point)));
    let points = points.columns_of_unit_batches()?;
    send_rows(output, now, times::columns(moments), points)?;
    Ok(Some(Plane {
        title: format!("{up} over {across} (mm)"),
        group,
        bounds,
    }))
}

type Point = [f64; 2];

/// Adds a point with its row, unless it is where the last one was.
fn add(path: &mut Vec<(usize, Point)>, row: usize, point: Point) {
    let is_far = |last: &Point| (point[0] - last[0]).hypot(point[1] - last[1]) >= STEP_MILLIMETRES;
    let is_new = path.last().is_none_or(|(_, last)| is_far(last));
    if is_new && point.iter().all(|value| value.is_finite()) {
        path.push((row, point));
    }
}

/// The viewer's second coordinate points down.
#[expect(clippy::cast_possible_truncation, reason = "for the eye")]
fn place([across, up]: Point) -> [f32; 2] {
    [across as f32, -up as f32]
}

fn bounds<'a>(points: impl Iterator<Item = &'a Point>) -> Option<[[f64; 2]; 2]> {
    let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for [across, up] in points {
        for (range, value) in range.iter_mut().zip([*across, -up]) {
            *range = [range[0].min(value), range[1].max(value)];
        }
    }
    let size = range
        .iter()
        .map(|[low, high]| high - low)
        .fold(0.0, f64::max);
    let room = MARGIN * size;
    size.is_finite()
        .then(|| range.map(|[low, high]| [low - room, high + room]))
        .filter(|_| size >= 0.0)
}
