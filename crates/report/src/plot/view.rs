//! Edges of a drawing, and the elements between them.

use std::fmt::Write;

use platform::series::Series;

use super::curve::{Extent, Patch, PlotCurve, Shape};
use super::decimate::{self, Polyline};
use super::range::{NOTHING, extended, typical, with_room};
use super::scale::{DrawingScale, SIDE};

/// Free room above and below the curves, relative to the height.
const MARGIN: f64 = 0.05;
/// Largest number of values from which the typical range is found.
const TYPICAL_MAX: usize = 1 << 20;

/// Values at the edges.
pub(super) struct View {
    pub(super) x: (f64, f64),
    pub(super) y: (f64, f64),
    /// Whether values lie beyond the upper or lower edge.
    pub(super) is_cut: bool,
}

impl View {
    /// Returns the edges that show everything of the curves, in a stretch of x if one is given.
    pub(super) fn new(
        curves: &[PlotCurve],
        patches: &[Patch],
        extent: Extent,
        x_range: Option<(f64, f64)>,
    ) -> Self {
        if extent == Extent::Plane {
            return Self::plane(curves);
        }
        let x = x_range.unwrap_or_else(|| with_room(all_x(curves)));
        let shown = curves.iter().map(|curve| curve.within(x_range).1);
        let shown = Vec::from_iter(shown);
        let range = shown.iter().fold(NOTHING, extended);
        let range = patches
            .iter()
            .filter(|patch| patch.x.1 > x.0 && patch.x.0 < x.1)
            .fold(range, |range, patch| {
                extended(range, [patch.y.0, patch.y.1])
            });
        let (y, is_cut) = match extent {
            Extent::All => {
                let (low, high) = with_room(range);
                let margin = (high - low) * MARGIN;
                ((low - margin, high + margin), false)
            }
            Extent::FromZero => (with_margin_above(extended(range, [0.0])), false),
            // Both ranges of a plane are known already.
            Extent::Logarithmic | Extent::Plane => (with_margin_above(range), false),
            Extent::Typical => {
                // In a long run every second, third … value determines the typical range; the extremes are known.
                let stride = shown.iter().map(Series::len).sum::<usize>() / TYPICAL_MAX + 1;
                let values = shown
                    .iter()
                    .flat_map(|values| values.iter().step_by(stride));
                let finite = values.filter(|y| y.is_finite());
                let y = typical(finite.collect(), with_room(range));
                (y, y != with_room(range))
            }
        };
        Self { x, y, is_cut }
    }

    /// Returns the edges of a square that shows everything.
    fn plane(curves: &[PlotCurve]) -> Self {
        let all = |values: fn(&PlotCurve) -> &Series<f64>| {
            with_room(curves.iter().map(values).fold(NOTHING, extended))
        };
        let (x, y) = (all(|curve| &curve.x), all(|curve| &curve.y));
        let half = (x.1 - x.0).max(y.1 - y.0) * (0.5 + MARGIN);
        let around = |(low, high): (f64, f64)| {
            let middle = f64::midpoint(low, high);
            (middle - half, middle + half)
        };
        Self {
            x: around(x),
            y: around(y),
            is_cut: false,
        }
    }

    /// Returns the percentage from the left.
    pub(super) fn along(&self, x: f64) -> f64 {
        100.0 * (x - self.x.0) / (self.x.1 - self.x.0)
    }

    /// Returns the percentage from the bottom.
    pub(super) fn up(&self, y: f64) -> f64 {
        100.0 * (y - self.y.0) / (self.y.1 - self.y.0)
    }

    /// Returns a point in the drawing's units.
    pub(super) fn place(&self, x: f64, y: f64) -> (f64, f64) {
        self.scale().place(x, y)
    }

    /// Returns the conversion from values to units of the drawing. It is computed once for all points of a curve, since divisions
    /// are slow.
    fn scale(&self) -> DrawingScale {
        let right = SIDE / (self.x.1 - self.x.0);
        let down = SIDE / (self.y.0 - self.y.1);
        DrawingScale {
            x: self.x.0,
            y: self.y.1,
            right,
            down,
        }
    }

    pub(super) fn grid(&self, x_ticks: &[(f64, String)], y_ticks: &[(f64, String)]) -> String {
        let mut path = String::new();
        for (x, _) in x_ticks {
            let _ = write!(path, "M{:.0} 0V{SIDE}", self.place(*x, 0.0).0);
        }
        for (y, _) in y_ticks {
            let _ = write!(path, "M0 {:.0}H{SIDE}", self.place(0.0, *y).1);
        }
        format!(r#"<path class="grid" d="{path}"/>"#)
    }

    pub(super) fn patch(&self, patch: &Patch) -> String {
        let within = |(low, high): (f64, f64), edges: (f64, f64)| {
            (low.clamp(edges.0, edges.1), high.clamp(edges.0, edges.1))
        };
        let (x, y) = (within(patch.x, self.x), within(patch.y, self.y));
        let ((left, top), (right, bottom)) = (self.place(x.0, y.1), self.place(x.1, y.0));
        let (width, height) = (right - left, bottom - top);
        if width <= 0.0 {
            return String::new();
        }
        format!(
            r#"<rect class="{}" x="{left:.0}" y="{top:.0}" width="{width:.0}" height="{height:.0}"/>"#,
            patch.class
        )
    }

    /// Returns a curve as an element of the drawing.
    pub(super) fn curve(&self, curve: &PlotCurve, class: &str) -> String {
        let (x, y) = curve.within(Some(self.x));
        let (points, scale) = (x.iter().zip(&y), self.scale());
        let data = match curve.shape {
            Shape::Points => points_data(&decimate::points(points, &scale)),
            Shape::Area => path_data(&decimate::over_time(points, &scale), true),
            Shape::Line | Shape::Dashed => path_data(&decimate::over_time(points, &scale), false),
            Shape::Path | Shape::DashedPath => {
                let places = points.map(|(x, y)| scale.place(x, y));
                path_data(&decimate::path(places), false)
            }
        };
        format!(r#"<path class="{class}" d="{data}"/>"#)
    }
}

/// Returns the range from the least to the greatest x of the curves.
fn all_x(curves: &[PlotCurve]) -> (f64, f64) {
    curves.iter().fold(NOTHING, |range, curve| {
        if curve.shape.is_path() {
            extended(range, &curve.x)
        } else {
            // Over time the ends are the extremes.
            extended(range, curve.x.first().into_iter().chain(curve.x.last()))
        }
    })
}

/// Returns a range that can be drawn, with room above it.
fn with_margin_above(range: (f64, f64)) -> (f64, f64) {
    let (low, high) = with_room(range);
    (low, high + (high - low) * MARGIN)
}

/// Returns the commands of an SVG path, in steps from point to point; with `close`, each line continues down to the lower edge
/// and back.
fn path_data(lines: &[Polyline], close: bool) -> String {
    let mut data = String::new();
    for line in lines {
        let Some((&start, rest)) = line.split_first() else {
            continue;
        };
        // Writing into a string cannot fail.
        let _ = write!(data, "M{} {}", start.0, start.1);
        if rest.is_empty() {
            // A single point is drawn as a dot, by the round ends of a line without length.
            data.push_str("h0");
        }
        for (step, [from, to]) in line.array_windows().enumerate() {
            let before = if step == 0 { "l" } else { " " };
            push_step(&mut data, before, *from, *to);
        }
        if close {
            let _ = write!(data, "V{SIDE}H{}z", start.0);
        }
    }
    data
}

/// Returns the commands of an SVG path that draws each point as a dot.
fn points_data(points: &[(i32, i32)]) -> String {
    let mut data = String::new();
    if let Some((x, y)) = points.first() {
        let _ = write!(data, "M{x} {y}h0");
    }
    for [from, to] in points.array_windows() {
        push_step(&mut data, "m", *from, *to);
        data.push_str("h0");
    }
    data
}

/// Writes a step from point to point; a minus sign separates two numbers, too.
fn push_step(data: &mut String, before: &str, from: (i32, i32), to: (i32, i32)) {
    let (right, down) = (to.0 - from.0, to.1 - from.1);
    let before = if before == " " && right < 0 {
        ""
    } else {
        before
    };
    let between = if down < 0 { "" } else { " " };
    let _ = write!(data, "{before}{right}{between}{down}");
}
