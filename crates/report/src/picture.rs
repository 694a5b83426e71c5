//! Plots as a separate SVG file, for texts with pictures.

use maud::{Markup, PreEscaped, html};

use super::plot::{Plot, SIDE};

/// Size of one plot with everything around its drawing.
const PLOT_WIDTH: f64 = 1100.0;
const PLOT_HEIGHT: f64 = 360.0;
/// Room around the drawing, for labels and title.
const LEFT: f64 = 62.0;
const RIGHT: f64 = 18.0;
const TOP: f64 = 32.0;
const BOTTOM: f64 = 48.0;

/// Style of the light pages; many picture viewers do not support variables in style sheets.
const STYLE: &str = "\
text { font: 13px sans-serif; fill: #5b6470; }
.title { font-weight: bold; fill: #1b1f24; }
.paper { fill: #fff; }
.frame { fill: none; stroke: #d9dee4; }
path { fill: none; stroke-width: 1.5px; stroke-linejoin: round; stroke-linecap: round; vector-effect: non-scaling-stroke; }
.grid { stroke: #e8ebef; stroke-width: 1px; }
.dashed { stroke-dasharray: 6 4; }
.over { stroke-dasharray: 8 6; }
.over-two { stroke-dasharray: 3 9; }
.points { stroke-width: 3px; }
.area { fill-opacity: .35; }
.band { fill: #2da44e; fill-opacity: .15; }
.c0 { stroke: #57606a; } .c1 { stroke: #0969da; } .c2 { stroke: #1a7f37; } .c3 { stroke: #bf3989; }
.c4 { stroke: #bc4c00; } .c5 { stroke: #8250df; } .c6 { stroke: #0f7b85; } .c7 { stroke: #9a6700; }
";

/// Returns a picture with the plots, one below the other.
pub fn to_svg(plots: &[Plot<'_>]) -> String {
    let tops = || (0..).map(|number| f64::from(number) * PLOT_HEIGHT);
    let height = tops().nth(plots.len()).unwrap_or_default();
    let picture = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {PLOT_WIDTH} {height}")) {
            style { (PreEscaped(STYLE)) }
            rect.paper width=(PLOT_WIDTH) height=(height) {}
            @for (top, plot) in tops().zip(plots) {
                g transform=(format!("translate({LEFT} {})", top + TOP)) { (drawn(plot)) }
            }
        }
    };
    picture.into_string() + "\n"
}

/// Draws a plot whose drawing begins at the origin.
fn drawn(plot: &Plot<'_>) -> Markup {
    let (width, height) = (PLOT_WIDTH - LEFT - RIGHT, PLOT_HEIGHT - TOP - BOTTOM);
    let drawing = plot.drawing();
    html! {
        text.title y="-11" {
            (plot.title)
            @if !plot.y_unit.is_empty() { " (" (plot.y_unit) ")" }
        }
        @for (place, curve) in (1..).map(|number| width - 160.0 * f64::from(number)).zip(plot.curves.iter().zip(&drawing.classes).rev()) {
            (key(place, &curve.0.label, curve.1))
        }
        svg width=(width) height=(height) viewBox=(format!("0 0 {SIDE} {SIDE}")) preserveAspectRatio="none" {
            (drawing.content)
        }
        rect.frame width=(width) height=(height) {}
        @for (place, label) in &drawing.y_labels {
            text x="-7" y=(format!("{:.1}", place / 100.0 * height + 4.0)) text-anchor="end" { (label) }
        }
        @for (place, label) in &drawing.x_labels {
            text x=(format!("{:.1}", place / 100.0 * width)) y=(height + 17.0) text-anchor="middle" { (label) }
        }
        text x=(width / 2.0) y=(height + 36.0) text-anchor="middle" { (plot.x_label) }
    }
}

/// Draws the label of a curve, next to a piece of it.
fn key(place: f64, label: &str, class: &str) -> Markup {
    html! {
        path.(class) d=(format!("M{place} -15h26")) {}
        text x=(place + 32.0) y="-11" { (label) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::Colour;
    use crate::plot::Shape;

    #[test]
    fn a_picture_names_its_plots_and_curves() {
        let mut plot = Plot::over_time("a < b", "mm");
        let (x, y) = ([0.0, 1.0], [0.0, 10.0]);
        plot.draw("measured", Colour::Measured, Shape::Line, &x, &y);
        plot.draw("found", Colour::Estimated, Shape::Dashed, &x, &y);
        let picture = to_svg(&[plot, Plot::over_time("second", "")]);
        assert!(picture.starts_with("<svg xmlns="), "{picture}");
        assert!(picture.contains(r#"viewBox="0 0 1100 720""#), "{picture}");
        for text in ["a &lt; b (mm)", "measured", "found", "second", "time (s)"] {
            assert!(
                picture.contains(&format!(">{text}</text>")),
                "{text}: {picture}"
            );
        }
        assert_eq!(
            picture.matches(r#"class="c3 dashed""#).count(),
            2,
            "{picture}"
        );
    }
}
