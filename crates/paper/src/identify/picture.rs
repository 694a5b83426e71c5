//! The fit as a picture: measured and simulated position above, their difference below.

use super::data::IdentificationData;
use report::picture;
use report::plot::{Colour, EDGES, Extent, Patch, Plot, Shape};

/// Returns the picture of one recording as SVG: the measured positions, and the expected readings with the start values
/// and with the result.
pub(crate) fn to_svg(
    measurement: &IdentificationData,
    start_metres: &[f64],
    fitted_metres: &[f64],
) -> String {
    let times = &measurement.times_seconds;
    let millimetres = |metres: &[f64]| metres.iter().map(|metres| 1e3 * metres).collect();
    let measured: Vec<f64> = millimetres(&measurement.positions_metres);
    let start: Vec<f64> = millimetres(start_metres);
    let fitted: Vec<f64> = millimetres(fitted_metres);
    let mut positions = Plot::over_time("Position", "mm");
    positions.extent = Extent::FromZero;
    positions.draw("measured", Colour::Measured, Shape::Line, times, &measured);
    positions.draw("start values", Colour::Run(3), Shape::Line, times, &start);
    // The line is dashed, so the measured positions remain visible behind it.
    positions.draw("found", Colour::Estimated, Shape::Dashed, times, &fitted);
    let pairs = measured.iter().zip(&fitted);
    let residual: Vec<f64> = pairs
        .map(|(measured, fitted)| 1e3 * (measured - fitted))
        .collect();
    let half_a_step = 0.5e6 * measurement.sensor_step_metres();
    let mut difference = Plot::over_time("Measured − found, and half a step of the sensor", "µm");
    let step = Patch::band(EDGES, (-half_a_step, half_a_step));
    difference.patches.push(step);
    difference.draw(
        "difference",
        Colour::Estimated,
        Shape::Line,
        times,
        &residual,
    );
    picture::to_svg(&[positions, difference])
}
