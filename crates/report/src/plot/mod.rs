//! Plots for the HTML pages: curves as SVG that stretches to the available width, axes as text of constant size.
//!
//! A [`Plot`] is curves of values. `view` chooses the values at its edges and draws between them: `range` finds those values,
//! `ticks` labels them, `scale` turns values into units of the drawing, and `decimate` leaves out the points that cannot be seen.
//! `plots.js` reads the samples from the drawn curves, so a page has no other data.

mod curve;
mod decimate;
pub(crate) mod range;
mod scale;
mod ticks;
mod view;

use maud::{Markup, PreEscaped, html};
use platform::series::Series;

use self::ticks::{apart, decades, ticks};
use self::view::View;
use crate::unit::shown_unit;

pub use curve::{Colour, EDGES, Extent, Patch, PlotCurve, Shape};
pub(crate) use scale::SIDE;

/// Part of the height within which two curves cover each other.
const HIDDEN_WITHIN: f64 = 0.006;

/// Plot of curves.
pub struct Plot<'a> {
    /// Title above the plot.
    pub title: String,
    /// Unit of the height; empty for numbers without one.
    pub y_unit: &'a str,
    /// Label below the horizontal axis.
    pub x_label: &'a str,
    /// Range of the values that the height shows.
    pub extent: Extent,
    pub curves: Vec<PlotCurve>,
    /// Rectangles behind the curves.
    pub patches: Vec<Patch>,
    /// Stretch of x that is shown; `None` for all of it.
    pub x_range: Option<(f64, f64)>,
    /// Notes on single points, which appear when a reader points at them.
    pub notes: Vec<(f64, f64, String)>,
}

/// Drawing of a plot, which is the same on a page and in a picture.
pub struct PlotDrawing {
    /// Grid, patches and curves, in the drawing's own units.
    pub content: Markup,
    /// Labels, each at a percentage from the left.
    pub x_labels: Vec<(f64, String)>,
    /// Labels, each at a percentage from the top.
    pub y_labels: Vec<(f64, String)>,
    /// Classes of each curve.
    pub classes: Vec<String>,
    view: View,
}

impl<'a> Plot<'a> {
    /// Returns a plot over time without curves.
    pub fn over_time(title: impl Into<String>, y_unit: &'a str) -> Self {
        Self {
            title: title.into(),
            y_unit: shown_unit(y_unit),
            x_label: "time (s)",
            extent: Extent::All,
            curves: Vec::new(),
            patches: Vec::new(),
            x_range: None,
            notes: Vec::new(),
        }
    }

    /// Adds a curve, unless it has no value at all.
    pub fn draw(
        &mut self,
        label: impl Into<String>,
        colour: Colour,
        shape: Shape,
        x: impl Into<Series<f64>>,
        y: impl Into<Series<f64>>,
    ) {
        let (label, x, y) = (label.into(), x.into(), y.into());
        let mut points = x.iter().zip(&y);
        if points.any(|(x, y)| x.is_finite() && y.is_finite()) {
            self.curves.push(PlotCurve {
                label,
                colour,
                shape,
                x,
                y,
            });
        }
    }

    /// Returns the plot as a figure; empty if it has no curve.
    pub fn render(&self) -> Markup {
        if self.curves.is_empty() {
            return html! {};
        }
        let is_plane = self.curves.iter().any(|curve| curve.shape.is_path());
        let drawing = self.drawing();
        let ((left, right), (bottom, top)) = (drawing.view.x, drawing.view.y);
        let names = self.curves.iter().map(|curve| curve.label.as_str());
        let names = Vec::from_iter(names).join(", ");
        html! {
            figure.plot.square[self.extent == Extent::Plane].log[self.extent == Extent::Logarithmic].plane[is_plane]
                data-view=(format!("{left} {right} {bottom} {top}")) data-unit=[(!self.y_unit.is_empty()).then_some(self.y_unit)] {
                figcaption {
                    strong { (self.title) }
                    @if !self.y_unit.is_empty() { " (" (self.y_unit) ")" }
                    @if drawing.view.is_cut { ", peaks cut" }
                    span.legend {
                        @for (curve, class) in self.curves.iter().zip(&drawing.classes) {
                            span { i.(class) {} (curve.label) }
                        }
                    }
                }
                div.axes {
                    div.y aria-hidden="true" {
                        @for (place, label) in &drawing.y_labels { span style=(format!("top:{place:.2}%")) { (label) } }
                    }
                    svg viewBox=(format!("0 0 {SIDE} {SIDE}")) preserveAspectRatio="none" role="img"
                        aria-label=(format!("{}: {names}", self.title)) {
                        (drawing.content)
                    }
                    div.x aria-hidden="true" {
                        @for (place, label) in &drawing.x_labels { span style=(format!("left:{place:.2}%")) { (label) } }
                    }
                }
                p.x-label { (self.x_label) }
                @for (x, y, text) in &self.notes {
                    @let (x, y) = drawing.view.place(*x, *y);
                    span.note data-at=(format!("{x:.0} {y:.0}")) hidden { (text) }
                }
            }
        }
    }

    pub(super) fn drawing(&self) -> PlotDrawing {
        let view = View::new(&self.curves, &self.patches, self.extent, self.x_range);
        let x_ticks = ticks(view.x);
        let y_ticks = match self.extent {
            Extent::Logarithmic => decades(view.y),
            _ => ticks(view.y),
        };
        let classes = self.classes(&view);
        let content = html! {
            (PreEscaped(view.grid(&x_ticks, &y_ticks)))
            @for patch in &self.patches { (PreEscaped(view.patch(patch))) }
            @for (curve, class) in self.curves.iter().zip(&classes) { (PreEscaped(view.curve(curve, class))) }
        };
        let along = |(value, label)| (view.along(value), label);
        let down = |(value, label)| (100.0 - view.up(value), label);
        PlotDrawing {
            content,
            x_labels: apart(x_ticks).into_iter().map(along).collect(),
            y_labels: y_ticks.into_iter().map(down).collect(),
            classes,
            view,
        }
    }

    /// Returns the classes of each curve. A curve that hides others is dashed, so that they can be seen through it.
    fn classes(&self, view: &View) -> Vec<String> {
        let near = HIDDEN_WITHIN * (view.y.1 - view.y.0);
        let class = |(number, curve): (usize, &PlotCurve)| {
            let below = self.curves[..number].iter();
            let hidden = below
                .filter(|other| curve.hides(other, view.x, near))
                .count();
            let over = match (curve.shape, hidden) {
                (Shape::Line, 1) => Some("over"),
                (Shape::Line, 2..) => Some("over-two"),
                _ => curve.shape.class(),
            };
            let colour = curve.colour.class();
            over.map_or_else(|| colour.clone(), |over| format!("{colour} {over}"))
        };
        self.curves.iter().enumerate().map(class).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_escaped() {
        let mut plot = Plot::over_time("<b>", "mm");
        plot.draw(
            "\"&",
            Colour::Measured,
            Shape::Line,
            &[0.0, 1.0],
            &[0.0, 1.0],
        );
        let text = plot.render().into_string();
        assert!(
            text.contains("&lt;b&gt;") && !text.contains("<b>"),
            "{text}"
        );
        assert!(text.contains("&quot;&amp;"), "{text}");
    }

    #[test]
    fn a_curve_without_a_value_is_left_out() {
        let mut plot = Plot::over_time("t", "");
        plot.draw(
            "none",
            Colour::Measured,
            Shape::Line,
            &[0.0, 1.0],
            &[f64::NAN; 2],
        );
        assert_eq!(plot.render().into_string(), "");
    }
}
