//! Plots for the HTML pages: curves as SVG that stretches to the width of its place, axes as text of constant size.

use std::cmp::Ordering;
use std::fmt::Write;

use maud::{Markup, PreEscaped, html};

use super::thin::{self, Polyline};

/// Size of the drawing in its own units; it is stretched to the place that the page gives it.
pub(super) const WIDTH: f64 = 3200.0;
pub(super) const HEIGHT: f64 = 1000.0;
/// Ticks on an axis, about.
const TICKS: f64 = 6.0;
/// Free room above and below the curves, by the height.
const MARGIN: f64 = 0.05;

/// One of the colours that the style sheet defines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// What is wanted.
    Wanted,
    /// What is measured.
    Measured,
    /// What is true, known only in emulation.
    True,
    /// What the controller estimates or makes of it.
    Estimated,
    /// The n-th of several runs.
    Run(usize),
}

impl Colour {
    /// Number of colours that the style sheet defines.
    const COUNT: usize = 8;

    pub(super) fn class(self) -> String {
        let number = match self {
            Self::Wanted => 0,
            Self::Measured => 1,
            Self::True => 2,
            Self::Estimated => 3,
            Self::Run(number) => (number + 1) % Self::COUNT,
        };
        format!("c{number}")
    }
}

/// How the points of a curve are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Over time: x grows.
    Line,
    /// Over time, broken: for what is wanted.
    Dashed,
    /// In a plane: x goes to and fro.
    Path,
    /// An area down to the lower edge.
    Area,
}

/// A curve of a plot.
pub(super) struct Curve<'a> {
    pub(super) label: String,
    pub(super) colour: Colour,
    pub(super) shape: Shape,
    pub(super) x: &'a [f64],
    pub(super) y: &'a [f64],
}

impl Curve<'_> {
    /// The points that a stretch of x shows. In the plane all are shown.
    fn within(&self, stretch: Option<(f64, f64)>) -> (&[f64], &[f64]) {
        match stretch {
            Some((from, until)) if self.shape != Shape::Path => {
                let first = self.x.partition_point(|x| *x < from);
                let end = self.x.partition_point(|x| *x <= until);
                (&self.x[first..end], &self.y[first..end])
            }
            _ => (self.x, self.y),
        }
    }
}

/// A rectangle behind the curves; infinite sides reach the edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Class in the style sheet.
    pub class: &'static str,
    /// From left to right.
    pub x: (f64, f64),
    /// From bottom to top.
    pub y: (f64, f64),
}

/// What the height of a plot stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Everything.
    All,
    /// Everything, and 0.
    FromZero,
    /// Nearly everything: rare peaks that would press the rest flat are cut, and the caption says so.
    Typical,
    /// Everything; the values are decimal logarithms.
    Logarithmic,
}

/// A plot.
pub struct Plot<'a> {
    /// What it shows.
    pub title: String,
    /// The unit of the height; empty for numbers without one.
    pub y_unit: &'a str,
    /// What stands below the horizontal axis.
    pub x_label: &'a str,
    /// What the height stands for.
    pub extent: Extent,
    pub(super) curves: Vec<Curve<'a>>,
    /// What stands behind the curves.
    pub patches: Vec<Patch>,
    /// The stretch of x that is shown; all of it when absent.
    pub x_range: Option<(f64, f64)>,
}

/// What is drawn of a plot: the same on a page and in a picture.
pub(super) struct Drawing {
    /// Grid, patches and curves, in the drawing's own units.
    pub(super) content: Markup,
    /// Labels at per cent from the left.
    pub(super) x_labels: Vec<(f64, String)>,
    /// Labels at per cent from the top.
    pub(super) y_labels: Vec<(f64, String)>,
    is_cut: bool,
}

impl<'a> Plot<'a> {
    /// A plot over time without curves.
    pub fn over_time(title: impl Into<String>, y_unit: &'a str) -> Self {
        Self {
            title: title.into(),
            y_unit,
            x_label: "time (s)",
            extent: Extent::All,
            curves: Vec::new(),
            patches: Vec::new(),
            x_range: None,
        }
    }

    /// Adds a curve, unless it has no value at all.
    pub fn draw(
        &mut self,
        label: impl Into<String>,
        colour: Colour,
        shape: Shape,
        x: &'a [f64],
        y: &'a [f64],
    ) {
        if x.iter().zip(y).any(|(x, y)| x.is_finite() && y.is_finite()) {
            let label = label.into();
            self.curves.push(Curve {
                label,
                colour,
                shape,
                x,
                y,
            });
        }
    }

    /// The plot as a figure; nothing when it has no curve.
    pub(super) fn render(&self) -> Markup {
        if self.curves.is_empty() {
            return html! {};
        }
        let drawing = self.drawing();
        let names: Vec<&str> = self
            .curves
            .iter()
            .map(|curve| curve.label.as_str())
            .collect();
        html! {
            figure.plot {
                figcaption {
                    strong { (self.title) }
                    @if !self.y_unit.is_empty() { " (" (self.y_unit) ")" }
                    @if drawing.is_cut { ", peaks cut" }
                    span.legend {
                        @for curve in &self.curves {
                            span { i.(curve.colour.class()).dashed[curve.shape == Shape::Dashed] {} (curve.label) }
                        }
                    }
                }
                div.axes {
                    div.y aria-hidden="true" {
                        @for (place, label) in &drawing.y_labels { span style=(format!("top:{place:.2}%")) { (label) } }
                    }
                    svg viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) preserveAspectRatio="none" role="img"
                        aria-label=(format!("{}: {}", self.title, names.join(", "))) {
                        (drawing.content)
                    }
                    div.x aria-hidden="true" {
                        @for (place, label) in &drawing.x_labels { span style=(format!("left:{place:.2}%")) { (label) } }
                    }
                }
                p.x-label { (self.x_label) }
            }
        }
    }

    pub(super) fn drawing(&self) -> Drawing {
        let view = View::of(self);
        let x_ticks = ticks(view.x);
        let y_ticks = match self.extent {
            Extent::Logarithmic => decades(view.y),
            _ => ticks(view.y),
        };
        let content = html! {
            (PreEscaped(view.grid(&x_ticks, &y_ticks)))
            @for patch in &self.patches { (PreEscaped(view.patch(patch))) }
            @for curve in &self.curves { (PreEscaped(view.curve(curve))) }
        };
        let along = |(value, label)| (view.along(value), label);
        let down = |(value, label)| (100.0 - view.up(value), label);
        Drawing {
            content,
            x_labels: x_ticks.into_iter().map(along).collect(),
            y_labels: y_ticks.into_iter().map(down).collect(),
            is_cut: view.is_cut,
        }
    }
}

/// Which values are at the edges.
struct View {
    x: (f64, f64),
    y: (f64, f64),
    is_cut: bool,
}

impl View {
    fn of(plot: &Plot<'_>) -> Self {
        let curves = || plot.curves.iter().map(|curve| curve.within(plot.x_range));
        let all_x = plot.curves.iter().fold(NOTHING, |range, curve| {
            let (x, _) = curve.within(plot.x_range);
            match (curve.shape, x) {
                // Over time the ends are the extremes.
                (Shape::Line | Shape::Dashed | Shape::Area, [first, .., last]) => {
                    extended(range, &[*first, *last])
                }
                _ => extended(range, x),
            }
        });
        let x = plot.x_range.unwrap_or_else(|| with_room(all_x));
        let patches = plot.patches.iter();
        let patches = patches.filter(|patch| patch.x.1 > x.0 && patch.x.0 < x.1);
        let all = curves().fold(NOTHING, |range, (_, y)| extended(range, y));
        let all = patches.fold(all, |range, patch| extended(range, &[patch.y.0, patch.y.1]));
        let (low, high) = match plot.extent {
            Extent::FromZero => with_room(extended(all, &[0.0])),
            Extent::Typical => {
                let values = curves().flat_map(|(_, y)| y);
                let y = typical(values.copied().filter(|y| y.is_finite()).collect());
                let is_cut = y != with_room(all);
                return Self { x, y, is_cut };
            }
            Extent::All | Extent::Logarithmic => with_room(all),
        };
        let margin = (high - low) * MARGIN;
        let low = match plot.extent {
            Extent::All => low - margin,
            _ => low,
        };
        let y = (low, high + margin);
        Self {
            x,
            y,
            is_cut: false,
        }
    }

    /// Per cent from the left.
    fn along(&self, x: f64) -> f64 {
        100.0 * (x - self.x.0) / (self.x.1 - self.x.0)
    }

    /// Per cent from the bottom.
    fn up(&self, y: f64) -> f64 {
        100.0 * (y - self.y.0) / (self.y.1 - self.y.0)
    }

    /// A point in the drawing's units.
    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        self.scale().place(x, y)
    }

    /// What makes points of the drawing of values: worked out once for all points of a curve, since to divide takes long.
    fn scale(&self) -> Scale {
        let right = WIDTH / (self.x.1 - self.x.0);
        let down = HEIGHT / (self.y.0 - self.y.1);
        Scale {
            x: self.x.0,
            y: self.y.1,
            right,
            down,
        }
    }

    fn grid(&self, x_ticks: &[(f64, String)], y_ticks: &[(f64, String)]) -> String {
        let mut path = String::new();
        for (x, _) in x_ticks {
            let _ = write!(path, "M{:.0} 0V{HEIGHT}", self.place(*x, 0.0).0);
        }
        for (y, _) in y_ticks {
            let _ = write!(path, "M0 {:.0}H{WIDTH}", self.place(0.0, *y).1);
        }
        format!(r#"<path class="grid" d="{path}"/>"#)
    }

    fn patch(&self, patch: &Patch) -> String {
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

    fn curve(&self, curve: &Curve<'_>) -> String {
        let (x, y) = curve.within(Some(self.x));
        let scale = self.scale();
        let lines = match curve.shape {
            Shape::Path => thin::path(x.iter().zip(y).map(|(x, y)| scale.place(*x, *y))),
            _ => thin::over_time(x, y, &scale),
        };
        let class = curve.colour.class();
        let (more, close) = match curve.shape {
            Shape::Dashed => (" dashed", false),
            Shape::Area => (" area", true),
            Shape::Line | Shape::Path => ("", false),
        };
        format!(
            r#"<path class="{class}{more}" d="{}"/>"#,
            path_data(&lines, close)
        )
    }
}

/// From values to the drawing's units, by way of the upper left corner.
pub(super) struct Scale {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) right: f64,
    pub(super) down: f64,
}

impl Scale {
    /// Units from the left.
    pub(super) fn along(&self, x: f64) -> f64 {
        (x - self.x) * self.right
    }

    /// Units from the top.
    pub(super) fn down(&self, y: f64) -> f64 {
        (y - self.y) * self.down
    }

    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        (self.along(x), self.down(y))
    }
}

/// The commands of an SVG path, in steps from point to point; with `close`, each down to the lower edge and back.
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
            let before = if step == 0 { 'l' } else { ' ' };
            let _ = write!(data, "{before}{} {}", to.0 - from.0, to.1 - from.1);
        }
        if close {
            let _ = write!(data, "V{HEIGHT}H{}z", start.0);
        }
    }
    data
}

/// The range of no values.
const NOTHING: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// A range with the finite ones of these values in it.
fn extended(range: (f64, f64), values: &[f64]) -> (f64, f64) {
    let within = |(low, high): (f64, f64), part: (f64, f64)| (low.min(part.0), high.max(part.1));
    // Values that are not finite are rare, and look like their neighbours.
    values.chunks(256).fold(range, |range, values| {
        if let Some(part) = thin::finite_range(values) {
            return within(range, part);
        }
        let finite = values.iter().filter(|value| value.is_finite());
        finite.fold(range, |range, value| within(range, (*value, *value)))
    })
}

/// A range that can be drawn: nothing becomes 0 to 1, and a constant gets room above and below.
fn with_room((low, high): (f64, f64)) -> (f64, f64) {
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

/// The range of all but the rarest values with room round it, where the whole range is much more than that.
fn typical(mut values: Vec<f64>) -> (f64, f64) {
    let whole = with_room(extended(NOTHING, &values));
    let tail = values.len() / 40;
    if tail == 0 {
        return whole;
    }
    // They are finite, so the plain comparison does.
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

/// Round values in a range, with their labels.
fn ticks((low, high): (f64, f64)) -> Vec<(f64, String)> {
    let rough = (high - low) / TICKS;
    let exponent = libm::floor(libm::log10(rough));
    let decade = libm::pow(10.0, exponent);
    let factors = [1.0, 2.0, 5.0, 10.0];
    let factor = factors
        .into_iter()
        .find(|factor| factor * decade >= rough * 0.999);
    let step = factor.unwrap_or(10.0) * decade;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to a few digits"
    )]
    let decimals = (-libm::floor(libm::log10(step) + 1e-9)).clamp(0.0, 9.0) as usize;
    let first = libm::ceil(low / step - 1e-9);
    let mut ticks = Vec::new();
    for number in 0..20 {
        let value = (first + f64::from(number)) * step;
        if value > high + step * 1e-9 {
            break;
        }
        // Adding 0 makes -0 a 0.
        ticks.push((value, label(value + 0.0, decimals)));
    }
    ticks
}

fn label(value: f64, decimals: usize) -> String {
    if value.abs() >= 1e5 {
        return format!("{value:e}").replace('-', "−");
    }
    format!("{value:.decimals$}").replace('-', "−")
}

/// Powers of ten in a range of logarithms.
fn decades((low, high): (f64, f64)) -> Vec<(f64, String)> {
    let powers = (0..12)
        .map(f64::from)
        .filter(|power| (low..=high).contains(power));
    powers
        .map(|power| (power, format!("{}", libm::round(libm::pow(10.0, power)))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(low: f64, high: f64) -> Vec<String> {
        ticks((low, high))
            .into_iter()
            .map(|(_, label)| label)
            .collect()
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(labels(0.0, 12.0), ["0", "2", "4", "6", "8", "10", "12"]);
        assert_eq!(
            labels(-0.6, 0.6),
            ["−0.6", "−0.4", "−0.2", "0.0", "0.2", "0.4", "0.6"]
        );
        assert_eq!(
            labels(9.9, 11.1),
            ["10.0", "10.2", "10.4", "10.6", "10.8", "11.0"]
        );
        assert_eq!(labels(-2e6, 2e6), ["−2e6", "−1e6", "0", "1e6", "2e6"]);
    }

    #[test]
    fn nothing_and_constants_have_a_range() {
        assert_eq!(with_room(NOTHING), (0.0, 1.0));
        assert_eq!(with_room((0.0, 0.0)), (-1.0, 1.0));
        let values = [f64::NAN, 10.0, f64::INFINITY];
        assert_eq!(with_room(extended(NOTHING, &values)), (9.0, 11.0));
    }

    #[test]
    fn a_rare_peak_does_not_press_the_rest_flat() {
        let mut values: Vec<f64> = (0..1000).map(|number| f64::from(number % 10)).collect();
        assert_eq!(typical(values.clone()), (0.0, 9.0));
        values[3] = 1e6;
        assert_eq!(typical(values), (0.0, 13.5));
    }

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
