//! Martensite fraction over temperature: the loop that makes the wire hard to control.
//!
//! The viewer has no plot of one signal over another, so the plot is drawn: a frame with its numbers, the whole path,
//! and a point that moves with the time.

use rerun::{LineStrips2D, Points2D, Radius, RecordingStream, RecordingStreamError};

use super::{groups, times};
use crate::timeline::Timeline;

/// The signals (temperature, fraction): the truth where there is an emulator, else the observer's.
const PAIRS: [(&str, &str); 2] = [
    ("wire_temperature_celsius", "martensite_fraction"),
    (
        "estimated_temperature_celsius",
        "estimated_martensite_fraction",
    ),
];
/// Size of the drawing; the viewer's y axis points down.
pub(super) const WIDTH: f64 = 160.0;
pub(super) const HEIGHT: f64 = 100.0;
/// A point of the path nearer to the one before than this cannot be seen.
const STEP: f64 = 0.25;
/// Grid lines are at multiples of the first of these that needs no more than so many steps.
const GRID_CELSIUS: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0];
const GRID_FRACTION: [f64; 5] = [0.01, 0.02, 0.05, 0.1, 0.2];
const GRID_STEPS_MAX: u32 = 6;

/// Draws it; `false` when the recording has not both signals.
pub(super) fn log(
    stream: &RecordingStream,
    timeline: &Timeline,
) -> Result<bool, RecordingStreamError> {
    let Some((temperature, fraction)) = signals(timeline) else {
        return Ok(false);
    };
    let rows: Vec<usize> = (0..timeline.cycle.len())
        .filter(|&row| temperature[row].is_finite() && fraction[row].is_finite())
        .collect();
    let axis =
        |values: &[f64], steps: &[f64]| Axis::new(rows.iter().map(|&row| values[row]), steps);
    let (Some(celsius), Some(fractions)) = (
        axis(temperature, &GRID_CELSIUS),
        axis(fraction, &GRID_FRACTION),
    ) else {
        return Ok(false);
    };
    let frame = Frame {
        celsius,
        fraction: fractions,
    };
    let seen = thinned(&rows, |row| frame.place(temperature[row], fraction[row]));
    frame.log(stream)?;
    let path: Vec<[f32; 2]> = seen.iter().map(|(_, place)| *place).collect();
    let strip = LineStrips2D::new([path.clone()])
        .with_colors([[0, 158, 115]])
        .with_radii([Radius::new_ui_points(1.0)]);
    stream.log_static("hysteresis/path", &strip)?;
    let look = Points2D::update_fields()
        .with_colors([[230, 159, 0]])
        .with_radii([Radius::new_ui_points(5.0)]);
    stream.log_static("hysteresis/now", &look)?;
    let rows: Vec<usize> = seen.iter().map(|(row, _)| *row).collect();
    let points = Points2D::new(path).columns_of_unit_batches()?;
    stream.send_columns("hysteresis/now", times(timeline, &rows), points)?;
    Ok(true)
}

fn signals(timeline: &Timeline) -> Option<(&[f64], &[f64])> {
    PAIRS.iter().find_map(|(temperature, fraction)| {
        let temperature = &timeline.column(temperature)?.values;
        let fraction = &timeline.column(fraction)?.values;
        let is_there = temperature
            .iter()
            .zip(fraction)
            .any(|(t, f)| t.is_finite() && f.is_finite());
        is_there.then_some((temperature.as_slice(), fraction.as_slice()))
    })
}

/// The rows whose places can be told apart, with their places.
fn thinned(rows: &[usize], place: impl Fn(usize) -> [f32; 2]) -> Vec<(usize, [f32; 2])> {
    let mut seen: Vec<(usize, [f32; 2])> = Vec::new();
    for &row in rows {
        let here = place(row);
        let is_new = seen.last().is_none_or(|(_, last)| {
            f64::from(here[0] - last[0]).hypot(f64::from(here[1] - last[1])) >= STEP
        });
        if is_new {
            seen.push((row, here));
        }
    }
    seen
}

/// One axis of the frame: whole grid lines around all values.
struct Axis {
    low: f64,
    step: f64,
    steps: u32,
}

impl Axis {
    /// `None` when there are no values.
    fn new(values: impl Iterator<Item = f64> + Clone, steps: &[f64]) -> Option<Self> {
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(f64::NEG_INFINITY, f64::max);
        let axes = steps.iter().map(|&step| {
            let first = (low / step).floor();
            // A value on a line does not need the next one.
            let count = ((high / step - 1e-9).ceil() - first).max(1.0);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "at least 1, and held to the limit below"
            )]
            let steps = count.min(1e6) as u32;
            Self {
                low: first * step,
                step,
                steps,
            }
        });
        let mut fitting = axes.filter(|axis| low <= high && axis.steps <= GRID_STEPS_MAX);
        fitting.next()
    }

    /// Where a value lies: 0 at the low end, 1 at the high end.
    fn part(&self, value: f64) -> f64 {
        (value - self.low) / (self.step * f64::from(self.steps))
    }

    fn lines(&self) -> impl Iterator<Item = f64> {
        (0..=self.steps).map(|number| self.low + self.step * f64::from(number))
    }
}

/// From °C and fraction to the drawing.
struct Frame {
    celsius: Axis,
    fraction: Axis,
}

impl Frame {
    /// A place by the parts of the axes.
    #[expect(clippy::cast_possible_truncation, reason = "for the eye")]
    fn at(right: f64, up: f64) -> [f32; 2] {
        [(right * WIDTH) as f32, ((1.0 - up) * HEIGHT) as f32]
    }

    fn place(&self, celsius: f64, fraction: f64) -> [f32; 2] {
        Self::at(self.celsius.part(celsius), self.fraction.part(fraction))
    }

    fn log(&self, stream: &RecordingStream) -> Result<(), RecordingStreamError> {
        let mut lines: Vec<[[f32; 2]; 2]> = Vec::new();
        let mut numbers: Vec<([f32; 2], String)> = Vec::new();
        for celsius in self.celsius.lines() {
            let right = self.celsius.part(celsius);
            lines.push([Self::at(right, 0.0), Self::at(right, 1.0)]);
            numbers.push((Self::at(right, -0.03), format!("{celsius:.0} °C")));
        }
        let decimals = if self.fraction.step < 0.1 { 2 } else { 1 };
        for fraction in self.fraction.lines() {
            let up = self.fraction.part(fraction);
            lines.push([Self::at(0.0, up), Self::at(1.0, up)]);
            numbers.push((Self::at(-0.04, up + 0.04), format!("{fraction:.decimals$}")));
        }
        let lines = LineStrips2D::new(lines)
            .with_colors([groups::GREY])
            .with_radii([Radius::new_ui_points(0.5)]);
        stream.log_static("hysteresis/frame", &lines)?;
        let (places, texts): (Vec<_>, Vec<_>) = numbers.into_iter().unzip();
        let numbers = Points2D::new(places)
            .with_labels(texts)
            .with_show_labels(true)
            .with_colors([groups::GREY])
            .with_radii([Radius::new_ui_points(0.0)]);
        stream.log_static("hysteresis/numbers", &numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_has_few_lines_around_all_values() {
        let axis = |values: &[f64]| {
            let axis = Axis::new(values.iter().copied(), &GRID_CELSIUS)?;
            Some((axis.low, axis.step, axis.steps))
        };
        assert_eq!(axis(&[20.0, 57.0]), Some((20.0, 10.0, 4)));
        assert_eq!(axis(&[20.0, 90.0]), Some((20.0, 20.0, 4)));
        assert_eq!(axis(&[-1.0, 0.0]), Some((-1.0, 1.0, 1)));
        assert_eq!(axis(&[25.0]), Some((25.0, 1.0, 1)));
        assert_eq!(axis(&[]), None);
        assert_eq!(axis(&[0.0, 1e9]), None);
        assert_eq!(axis(&[f64::NEG_INFINITY, f64::INFINITY]), None);
    }
}
