//! The section on loops that follow a path together: the path in the plane, and the distances from it.

use maud::{Markup, html};
use scenario::contour::Contour;

use crate::contour::{axes, window};
use crate::plot::{Colour, Extent, Plot, Shape};
use crate::run::{Run, RunLoop};
use crate::unit::shown_unit;
use judge::contour_errors;
use platform::series::SeriesWriter;

pub(super) fn section(contour: &Contour, run: &Run<'_>) -> Markup {
    let axes = axes(contour, run);
    let timelines = Vec::from_iter(axes.iter().map(|axis| axis.timeline));
    let end_seconds = run.plan.shared.run.duration_seconds;
    let (mut time, mut errors) = (SeriesWriter::default(), SeriesWriter::default());
    for (seconds, error) in contour_errors(contour, &timelines, end_seconds) {
        time.push(seconds);
        errors.push(error);
    }
    let (time, errors) = (time.finish(), errors.finish());
    let mut distance = Plot::over_time("Distance from the path", contour.unit.symbol());
    distance.extent = Extent::FromZero;
    let label = "contour error";
    distance.draw(label, Colour::Measured, Shape::Line, time, errors);
    html! {
        h2 { "Path of " (contour.loops.join(", ")) }
        div.plots.even {
            @for pair in axes.array_windows() { (plane(contour, *pair).render()) }
            (distance.render())
        }
    }
}

/// Plots two loops in the contour's window, one over the other.
fn plane<'a>(contour: &'a Contour, axes: [RunLoop<'a>; 2]) -> Plot<'a> {
    let rows = window(contour, axes);
    let [x, y] = axes.map(|axis| axis.timeline);
    let [across, up] = axes.map(|axis| axis.control_loop.name());
    let title = format!("{up} over {across}");
    let unit = shown_unit(contour.unit.symbol());
    let mut plot = Plot::over_time(title, unit);
    plot.x_label = unit;
    plot.extent = Extent::Plane;
    let [right, high] = [x, y].map(|axis| axis.position().part(rows.clone()));
    plot.draw("measured", Colour::Measured, Shape::Path, right, high);
    let [right, high] = [x, y].map(|axis| axis.set_point().part(rows.clone()));
    plot.draw("set-point", Colour::Wanted, Shape::DashedPath, right, high);
    plot
}
