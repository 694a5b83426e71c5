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
/// Temperatures are marked at multiples of this.
const GRID_CELSIUS: f64 = 20.0;

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
    let Some(scale) = Scale::new(rows.iter().map(|&row| temperature[row])) else {
        return Ok(false);
    };
    let seen = thinned(rows, |row| scale.place(temperature[row], fraction[row]));
    scale.log_frame(stream)?;
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
fn thinned(rows: Vec<usize>, place: impl Fn(usize) -> [f32; 2]) -> Vec<(usize, [f32; 2])> {
    let mut seen: Vec<(usize, [f32; 2])> = Vec::new();
    for row in rows {
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

/// From °C and fraction to the drawing.
struct Scale {
    coldest: f64,
    hottest: f64,
}

impl Scale {
    /// From grid line to grid line around all temperatures; `None` when there are none.
    fn new(temperatures: impl Iterator<Item = f64>) -> Option<Self> {
        let (low, high) = temperatures
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| {
                (low.min(t), high.max(t))
            });
        (low <= high).then(|| Self {
            coldest: (low / GRID_CELSIUS).floor() * GRID_CELSIUS,
            hottest: ((high / GRID_CELSIUS).floor() + 1.0) * GRID_CELSIUS,
        })
    }

    #[expect(clippy::cast_possible_truncation, reason = "for the eye")]
    fn place(&self, celsius: f64, fraction: f64) -> [f32; 2] {
        let x = (celsius - self.coldest) / (self.hottest - self.coldest) * WIDTH;
        [x as f32, ((1.0 - fraction) * HEIGHT) as f32]
    }

    fn log_frame(&self, stream: &RecordingStream) -> Result<(), RecordingStreamError> {
        let mut lines: Vec<[[f32; 2]; 2]> = Vec::new();
        let mut numbers: Vec<([f32; 2], String)> = Vec::new();
        let mut celsius = self.coldest;
        while celsius <= self.hottest {
            lines.push([self.place(celsius, 0.0), self.place(celsius, 1.0)]);
            numbers.push((self.place(celsius, -0.04), format!("{celsius:.0} °C")));
            celsius += GRID_CELSIUS;
        }
        for quarter in 0..=4 {
            let fraction = f64::from(quarter) / 4.0;
            let line = [
                self.place(self.coldest, fraction),
                self.place(self.hottest, fraction),
            ];
            numbers.push(([line[0][0] - 6.0, line[0][1]], format!("{fraction}")));
            lines.push(line);
        }
        let frame = LineStrips2D::new(lines)
            .with_colors([groups::GREY])
            .with_radii([Radius::new_ui_points(0.5)]);
        stream.log_static("hysteresis/frame", &frame)?;
        let (places, texts): (Vec<_>, Vec<_>) = numbers.into_iter().unzip();
        let numbers = Points2D::new(places)
            .with_labels(texts)
            .with_show_labels(true)
            .with_colors([groups::GREY])
            .with_radii([Radius::new_ui_points(0.0)]);
        stream.log_static("hysteresis/numbers", &numbers)
    }
}
