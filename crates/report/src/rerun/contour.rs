//! Two loops in the plane, one over the other: the paths of their set-points and of their positions, and a point that moves with
//! time.

use re_sdk_types::archetypes::LineStrips2D;
use re_sdk_types::components::Radius;
use scenario::contour::Contour;

use super::bus::stretch_seconds;
use super::output::{Output, send_look, send_static};
use super::times;
use super::trail::{Trail, log_moves};
use super::{POINTS_MAX, ReportError, groups, thin};
use crate::contour::{axes, window};
use crate::plot::range::{NOTHING, extended};
use crate::run::{Run, RunLoop};
use crate::shown_unit;
use platform::series::Series;
use recording::timeline::Timeline;

/// Least distance of two points in a path; a smaller one cannot be seen.
const STEP_MILLIMETRES: f64 = 0.02;
/// Free room around the paths, relative to their size.
const MARGIN: f64 = 0.1;

/// View of a contour in the layout.
pub(super) struct Plane {
    pub(super) title: String,
    pub(super) group: String,
    /// Least and largest coordinate, across and down.
    pub(super) bounds: [[f64; 2]; 2],
}

/// Logs the contours of a scenario.
pub(super) fn log(output: &mut dyn Output, run: &Run<'_>) -> Result<Vec<Plane>, ReportError> {
    let mut planes = Vec::new();
    for contour in &run.plan.shared.contours {
        for pair in axes(contour, run).array_windows() {
            planes.extend(log_plane(output, contour, *pair, run.is_long)?);
        }
    }
    Ok(planes)
}

fn log_plane(
    output: &mut dyn Output,
    contour: &Contour,
    axes: [RunLoop<'_>; 2],
    is_long: bool,
) -> Result<Option<Plane>, ReportError> {
    let [x, y] = axes.map(|axis| axis.timeline);
    let [across, up] = axes.map(|axis| axis.control_loop.name());
    let pause_seconds = if is_long {
        stretch_seconds(&axes[0].control_loop.trial)
    } else {
        0.0
    };
    let group = format!("contour/{across}_{up}");
    let now = format!("{group}/now");
    let mut wanted = Trail::new(pause_seconds);
    let mut measured = Trail::new(pause_seconds);
    // Number of measured points that are logged already.
    let mut logged = 0;
    let rows = window(contour, axes);
    let series = |of: fn(&Timeline) -> &Series<f64>| {
        let [across, up] = [x, y].map(|axis| of(axis).range(rows.clone()));
        across.zip(up).map(|(across, up)| [across, up])
    };
    let set_points = series(|axis| axis.set_point());
    let samples = set_points.zip(series(Timeline::position));
    let moments = times::moments(x).skip(rows.start);
    for (moment, (set_points, positions)) in moments.zip(samples) {
        wanted.add(moment, set_points, is_far);
        measured.add(moment, positions, is_far);
        if is_long && measured.points.len() > POINTS_MAX {
            log_moves(output, &now, &measured.points[logged..], place)?;
            thin(&mut measured.points);
            logged = measured.points.len();
        }
        if is_long {
            thin(&mut wanted.points);
        }
    }
    let points = wanted.points.iter().chain(&measured.points);
    let Some(bounds) = bounds(points.map(|(_, point)| point)) else {
        return Ok(None);
    };
    for (name, path, colour) in [
        ("set_point", &wanted, groups::ORANGE),
        ("measured", &measured, groups::SKY),
    ] {
        let line = path.points.iter().map(|(_, point)| place(*point));
        let strip = LineStrips2D::new([Vec::from_iter(line)])
            .with_colors([colour])
            .with_radii([Radius::new_ui_points(1.0)])
            .with_labels([name.replace('_', "-")])
            .with_show_labels(false);
        send_static(output, format!("{group}/{name}"), &strip)?;
    }
    send_look(output, &now, groups::SKY)?;
    log_moves(output, &now, &measured.points[logged..], place)?;
    Ok(Some(Plane {
        title: format!("{up} over {across} ({})", shown_unit(contour.unit.symbol())),
        group,
        bounds,
    }))
}

pub(super) fn is_far(here: [f64; 2], last: [f64; 2]) -> bool {
    (here[0] - last[0]).hypot(here[1] - last[1]) >= STEP_MILLIMETRES
}

/// Converts a point to the viewer's coordinates, of which the second one points down.
#[expect(clippy::cast_possible_truncation, reason = "for the eye")]
fn place([across, up]: [f64; 2]) -> [f32; 2] {
    [across as f32, -up as f32]
}

fn bounds<'a>(points: impl Iterator<Item = &'a [f64; 2]> + Clone) -> Option<[[f64; 2]; 2]> {
    let range = |place: fn(&[f64; 2]) -> f64| extended(NOTHING, points.clone().map(place));
    let ranges = [range(|[across, _]| *across), range(|[_, up]| -up)];
    let size = ranges
        .iter()
        .fold(0.0, |size, (low, high)| f64::max(size, high - low));
    let room = MARGIN * size;
    let has_points = points.clone().next().is_some();
    has_points.then(|| ranges.map(|(low, high)| [low - room, high + room]))
}
