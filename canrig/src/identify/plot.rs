//! The fit as a picture: measured and simulated position above, their difference below.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::trace::Trace;

const WIDTH: u32 = 1100;
const HEIGHT: u32 = 720;
/// Height of the upper panel.
const UPPER_HEIGHT: u32 = 460;
/// Points of one line at most: more than the picture has columns.
const POINTS_MAX: usize = 2500;

const MEASURED: RGBColor = RGBColor(150, 150, 150);
const FITTED: RGBColor = RGBColor(0, 90, 181);
const STARTED: RGBColor = RGBColor(220, 120, 0);

/// The curves of one recording.
pub struct Curves<'a> {
    /// What was measured.
    pub trace: &'a Trace,
    /// What the sensor should show with the start values.
    pub start_metres: &'a [f64],
    /// What the sensor should show with the values found.
    pub fitted_metres: &'a [f64],
}

/// The picture as SVG.
///
/// # Errors
/// The drawing fails; into memory that does not happen.
pub fn to_svg(curves: &Curves<'_>) -> Result<String, Box<dyn std::error::Error>> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, HEIGHT)).into_drawing_area();
        area.fill(&WHITE)?;
        let (upper, lower) = area.split_vertically(UPPER_HEIGHT);
        draw_positions(&upper, curves)?;
        draw_residual(&lower, curves)?;
        area.present()?;
    }
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn draw_positions(area: &Area<'_>, curves: &Curves<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let measured = points(curves, &curves.trace.positions_metres, 1e3);
    let start = points(curves, curves.start_metres, 1e3);
    let fitted = points(curves, curves.fitted_metres, 1e3);
    let (_, top) = limits([&measured, &start, &fitted]);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(34)
        .y_label_area_size(62)
        .build_cartesian_2d(0.0..end_seconds(curves), 0.0..1.05 * top.max(1.0))?;
    chart
        .configure_mesh()
        .x_desc("time in s")
        .y_desc("position in mm")
        .light_line_style(TRANSPARENT)
        .draw()?;
    let lines = [
        (measured, MEASURED, 3, "measured"),
        (start, STARTED, 1, "start values"),
        (fitted, FITTED, 1, "found"),
    ];
    for (line, colour, width, name) in lines {
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(width)))?
            .label(name)
            .legend(move |(x, y)| {
                PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(width))
            });
    }
    chart
        .configure_series_labels()
        .background_style(WHITE)
        .border_style(BLACK)
        .draw()?;
    Ok(())
}

fn draw_residual(area: &Area<'_>, curves: &Curves<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let pairs = curves
        .trace
        .positions_metres
        .iter()
        .zip(curves.fitted_metres);
    let residual: Vec<f64> = pairs.map(|(measured, fitted)| measured - fitted).collect();
    let residual = points(curves, &residual, 1e6);
    let step = curves.trace.sensor_step_metres() * 1e6;
    let (bottom, top) = limits([&residual]);
    let reach = bottom.abs().max(top.abs()).max(step) * 1.1;
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(34)
        .y_label_area_size(62)
        .build_cartesian_2d(0.0..end_seconds(curves), -reach..reach)?;
    chart
        .configure_mesh()
        .x_desc("time in s")
        .y_desc("measured − found in µm")
        .light_line_style(TRANSPARENT)
        .draw()?;
    for edge in [-0.5 * step, 0.5 * step] {
        let line = [(0.0, edge), (end_seconds(curves), edge)];
        chart
            .draw_series(LineSeries::new(line, STARTED.stroke_width(1)))?
            .label(if edge > 0.0 {
                "half a step of the sensor"
            } else {
                ""
            });
    }
    chart.draw_series(LineSeries::new(residual, FITTED.stroke_width(1)))?;
    Ok(())
}

/// Every so many samples that the line stays drawable, as `(seconds, value · factor)`.
fn points(curves: &Curves<'_>, values: &[f64], factor: f64) -> Vec<(f64, f64)> {
    let every = values.len().div_ceil(POINTS_MAX).max(1);
    let pairs = curves.trace.times_seconds.iter().zip(values).step_by(every);
    pairs.map(|(time, value)| (*time, value * factor)).collect()
}

fn end_seconds(curves: &Curves<'_>) -> f64 {
    curves.trace.times_seconds.last().copied().unwrap_or(1.0)
}

fn limits<const N: usize>(lines: [&Vec<(f64, f64)>; N]) -> (f64, f64) {
    let values = lines.into_iter().flatten().map(|(_, value)| *value);
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    })
}
