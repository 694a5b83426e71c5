//! Martensite fraction over temperature: the hysteresis that makes the wire hard to control.
//!
//! The viewer has no plot of one signal over another, so the plot is drawn: a frame with its numbers, the whole path, and a point
//! that moves with time.

use re_sdk_types::archetypes::{LineStrips2D, Points2D};
use re_sdk_types::components::Radius;

use super::output::{Output, send_static};
use super::times;
use super::trail::{Trail, log_moves};
use super::{ReportError, groups, thin};
use crate::plot::range::{NOTHING, extended};
use platform::series::Series;
use recording::timeline::Timeline;

/// Pairs of signals (temperature, fraction): the true ones of an emulator, else the observer's.
const PAIRS: [(&str, &str); 2] = [
    ("wire_temperature_celsius", "martensite_fraction"),
    (
        "estimated_temperature_celsius",
        "estimated_martensite_fraction",
    ),
];
/// Path of the point that moves with time.
pub(super) const NOW: &str = "hysteresis/now";
/// Size of the drawing; the viewer's y axis points down.
const WIDTH: f64 = 160.0;
const HEIGHT: f64 = 100.0;
/// Least and largest coordinate of the view, across and down.
pub(super) const BOUNDS: [[f64; 2]; 2] = [
    [-0.12 * WIDTH, 1.08 * WIDTH],
    [-0.08 * HEIGHT, 1.16 * HEIGHT],
];
/// Least distance of two points in the path; a smaller one cannot be seen.
const STEP: f64 = 0.25;
/// Time between two drawings of the path while a run is played.
const PATH_PERIOD_SECONDS: f64 = 0.5;
/// Distances of grid lines. An axis has the first of these that needs no more than the largest number of steps.
const GRID_CELSIUS: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0];
const GRID_FRACTION: [f64; 5] = [0.01, 0.02, 0.05, 0.1, 0.2];
const GRID_STEPS_MAX: u8 = 6;

/// Path so far, and the frame that holds it.
pub(super) struct Hysteresis {
    /// Least and largest values so far.
    celsius: (f64, f64),
    fraction: (f64, f64),
    frame: Option<Frame>,
    /// Temperatures and fractions.
    trail: Trail,
    is_path_old: bool,
    drawn_at_seconds: f64,
}

impl Hysteresis {
    /// Returns a path without points.
    pub(super) fn new(pause_seconds: f64) -> Self {
        Self {
            celsius: NOTHING,
            fraction: NOTHING,
            frame: None,
            trail: Trail::new(pause_seconds),
            is_path_old: false,
            drawn_at_seconds: 0.0,
        }
    }

    /// Returns whether anything is drawn.
    pub(super) fn is_there(&self) -> bool {
        self.frame.is_some()
    }

    /// Draws the additions of a piece of the run.
    pub(super) fn log(
        &mut self,
        output: &mut dyn Output,
        timeline: &Timeline,
    ) -> Result<(), ReportError> {
        let Some((temperature, fraction)) = signals(timeline) else {
            return Ok(());
        };
        let values = temperature.iter().zip(fraction);
        let rows = times::moments(timeline)
            .enumerate()
            .zip(values)
            .filter(|(_, (celsius, fraction))| celsius.is_finite() && fraction.is_finite());
        let is_new_frame = self.widen(rows.clone().map(|(_, values)| values));
        let Some(frame) = &self.frame else {
            return Ok(());
        };
        if is_new_frame {
            frame.log(output)?;
        }
        // A new frame moves every point.
        let trail = &mut self.trail;
        let first = if is_new_frame { 0 } else { trail.points.len() };
        for ((row, moment), (celsius, fraction)) in rows {
            let moment = if row == 0 && trail.points.is_empty() {
                times::first_moment(timeline, moment)
            } else {
                moment
            };
            trail.add(moment, [celsius, fraction], |here, last| {
                is_far(frame.place(here), frame.place(last))
            });
        }
        let new = &trail.points[first..];
        if !new.is_empty() {
            log_moves(output, NOW, new, |point| frame.place(point))?;
            self.is_path_old = true;
        }
        let now_seconds = timeline.end_seconds();
        if now_seconds - self.drawn_at_seconds >= PATH_PERIOD_SECONDS {
            self.drawn_at_seconds = now_seconds;
            self.log_path(output)?;
        }
        Ok(())
    }

    /// Widens the axes to the values; returns `true` if the frame has changed.
    fn widen(&mut self, values: impl Iterator<Item = (f64, f64)>) -> bool {
        for (celsius, fraction) in values {
            self.celsius = extended(self.celsius, [celsius]);
            self.fraction = extended(self.fraction, [fraction]);
        }
        let celsius = Axis::new(self.celsius, &GRID_CELSIUS);
        let fraction = Axis::new(self.fraction, &GRID_FRACTION);
        let frame = celsius
            .zip(fraction)
            .map(|(celsius, fraction)| Frame { celsius, fraction });
        let is_new = frame != self.frame;
        self.frame = frame;
        is_new
    }

    /// Draws the whole path, which stays while the point moves along it, unless it is drawn already.
    pub(super) fn log_path(&mut self, output: &mut dyn Output) -> Result<(), ReportError> {
        let Some(frame) = self.frame.as_ref().filter(|_| self.is_path_old) else {
            return Ok(());
        };
        self.is_path_old = false;
        let points = self.trail.points.iter();
        let path = points.map(|(_, point)| frame.place(*point));
        let strip = LineStrips2D::new([Vec::from_iter(path)])
            .with_colors([groups::GREEN])
            .with_radii([Radius::new_ui_points(1.0)]);
        thin(&mut self.trail.points);
        send_static(output, "hysteresis/path", &strip)
    }
}

fn is_far(a: [f32; 2], b: [f32; 2]) -> bool {
    let [right, down] = [a[0] - b[0], a[1] - b[1]].map(f64::from);
    right * right + down * down >= STEP * STEP
}

fn signals(timeline: &Timeline) -> Option<(&Series<f64>, &Series<f64>)> {
    PAIRS.iter().find_map(|(temperature, fraction)| {
        let temperature = &timeline.column(temperature)?.values;
        let fraction = &timeline.column(fraction)?.values;
        let is_there = temperature
            .iter()
            .zip(fraction)
            .any(|(t, f)| t.is_finite() && f.is_finite());
        is_there.then_some((temperature, fraction))
    })
}

/// Axis of the frame: whole grid lines around all values.
#[derive(PartialEq)]
struct Axis {
    low: f64,
    step: f64,
    /// Number of steps, which is whole.
    steps: f64,
}

impl Axis {
    /// Returns an axis around the values; `None` if there are none.
    fn new((low, high): (f64, f64), steps: &[f64]) -> Option<Self> {
        let axes = steps.iter().map(|&step| {
            let first = (low / step).floor();
            // A value on a line does not need the next line.
            let steps = ((high / step - 1e-9).ceil() - first).max(1.0);
            Self {
                low: first * step,
                step,
                steps,
            }
        });
        let steps_max = f64::from(GRID_STEPS_MAX);
        let mut fitting = axes.filter(|axis| low <= high && axis.steps <= steps_max);
        fitting.next()
    }

    /// Returns the place of a value: 0 at the low end, 1 at the high end.
    fn part(&self, value: f64) -> f64 {
        (value - self.low) / (self.step * self.steps)
    }

    fn lines(&self) -> impl Iterator<Item = f64> {
        let numbers = (0..=GRID_STEPS_MAX).map(f64::from);
        let shown = numbers.take_while(|number| *number <= self.steps);
        shown.map(|number| self.low + self.step * number)
    }
}

/// Conversion from °C and fraction to the drawing.
#[derive(PartialEq)]
struct Frame {
    celsius: Axis,
    fraction: Axis,
}

impl Frame {
    /// Returns a place by its parts of the axes.
    #[expect(clippy::cast_possible_truncation, reason = "for the eye")]
    fn at(right: f64, up: f64) -> [f32; 2] {
        [(right * WIDTH) as f32, ((1.0 - up) * HEIGHT) as f32]
    }

    fn place(&self, [celsius, fraction]: [f64; 2]) -> [f32; 2] {
        let right = self.celsius.part(celsius);
        Self::at(right, self.fraction.part(fraction))
    }

    fn log(&self, output: &mut dyn Output) -> Result<(), ReportError> {
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
        send_static(output, "hysteresis/frame", &lines)?;
        let (places, texts): (Vec<_>, Vec<_>) = numbers.into_iter().unzip();
        let numbers = Points2D::new(places)
            .with_labels(texts)
            .with_show_labels(true)
            .with_colors([groups::GREY])
            .with_radii([Radius::new_ui_points(0.0)]);
        send_static(output, "hysteresis/numbers", &numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_has_few_lines_around_all_values() {
        let axis = |values: &[f64]| {
            let range = extended(NOTHING, values.iter().copied());
            let axis = Axis::new(range, &GRID_CELSIUS)?;
            Some((axis.low, axis.step, axis.steps))
        };
        assert_eq!(axis(&[20.0, 57.0]), Some((20.0, 10.0, 4.0)));
        assert_eq!(axis(&[20.0, 90.0]), Some((20.0, 20.0, 4.0)));
        assert_eq!(axis(&[-1.0, 0.0]), Some((-1.0, 1.0, 1.0)));
        assert_eq!(axis(&[25.0]), Some((25.0, 1.0, 1.0)));
        assert_eq!(axis(&[]), None);
        assert_eq!(axis(&[0.0, 1e9]), None);
        assert_eq!(axis(&[f64::NEG_INFINITY, f64::INFINITY]), None);
    }
}
