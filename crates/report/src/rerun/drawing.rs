//! The rig as a drawing, in millimetres: the wire over its cooling element, the pulleys, the load and its target.

use std::f64::consts::TAU;

use dbc::Unit;
use re_sdk_types::archetypes::{Boxes2D, LineStrips2D, Points2D};
use re_sdk_types::components::{Color, Radius};
use scenario::Trial;

use super::output::{Output, send_rows, send_static};
use super::times::{self, Moment};
use super::{ReportError, groups};
use recording::timeline::Timeline;

/// Distance from the wire's cold end to the pulleys.
const GAP: f64 = 12.0;
/// Distance from the pulleys' axle to the load at position 0.
const CORD: f64 = 105.0;
/// Half the load's width and height.
const LOAD: [f64; 2] = [17.0, 11.0];
/// Number of corners of a drawn circle.
const CORNERS: u32 = 48;
/// Least change of position or temperature that can be seen.
const STEP_MILLIMETRES: f64 = 0.1;
const STEP_CELSIUS: f64 = 0.5;
/// Largest number of poses that are sent at once: each has a hundred numbers, which are copied several times on their way.
const POSES_MAX: usize = 1 << 11;
/// Colours of temperatures, which are interpolated linearly.
const COLOURS: [(f64, [f64; 3]); 4] = [
    (20.0, [80.0, 130.0, 220.0]),
    (50.0, [230.0, 190.0, 90.0]),
    (75.0, [240.0, 110.0, 30.0]),
    (100.0, [255.0, 50.0, 30.0]),
];
/// Signals of the temperature: the true one of an emulator, else the observer's.
const TEMPERATURES: [&str; 2] = ["wire_temperature_celsius", "estimated_temperature_celsius"];

/// Visible values of a row.
#[derive(Clone, Copy)]
struct Pose {
    moment: Moment,
    position: f64,
    set_point: f64,
    celsius: f64,
}

/// Drawing of the rig.
pub(super) struct Drawing {
    wire: f64,
    inner: f64,
    outer: f64,
    last: Option<Pose>,
    /// Least time between two poses.
    pause_seconds: f64,
}

impl Drawing {
    /// Returns the actuator's drawing; `None` for other plants.
    pub(super) fn new(trial: &Trial, pause_seconds: f64) -> Option<Self> {
        let mechanics = trial.plant().actuator()?.mechanics;
        let is_length = trial.wiring.feedback.quantity.unit == Unit::Millimetres;
        is_length.then_some(Self {
            wire: 1e3 * mechanics.wire_length_metres,
            inner: 1e3 * mechanics.inner_pulley_radius_metres,
            outer: 1e3 * mechanics.outer_pulley_radius_metres,
            last: None,
            pause_seconds,
        })
    }

    /// Draws the static parts.
    pub(super) fn draw(&self, output: &mut dyn Output) -> Result<(), ReportError> {
        let anchor = vec![place(0.0, -9.0), place(0.0, 9.0)];
        let circles = [self.inner, self.outer].map(|radius| self.circle(radius));
        let lines = LineStrips2D::new([anchor].into_iter().chain(circles))
            .with_colors([groups::GREY])
            .with_radii([Radius::new_ui_points(1.0)]);
        send_static(output, "rig/frame", &lines)?;
        let [left, right] = [0.08, 0.72].map(|part| part * self.wire);
        let cooler = Boxes2D::from_mins_and_sizes([place(left, 3.0)], [place(right - left, 8.0)])
            .with_colors([[70, 90, 120]])
            .with_labels(["cooling element"])
            .with_show_labels(true);
        send_static(output, "rig/cooling_element", &cooler)?;
        let thin = [Radius::new_ui_points(1.0)];
        let cord = LineStrips2D::update_fields()
            .with_colors([groups::GREY])
            .with_radii(thin);
        for name in ["rig/lead", "rig/cord", "rig/spoke"] {
            send_static(output, name, &cord)?;
        }
        let wire = LineStrips2D::update_fields().with_radii([Radius::new_ui_points(3.0)]);
        send_static(output, "rig/wire", &wire)?;
        let temperature = Points2D::new([place(0.4 * self.wire, -18.0)])
            .with_radii([Radius::new_ui_points(0.0)])
            .with_show_labels(true);
        send_static(output, "rig/temperature", &temperature)?;
        let [width, height] = LOAD;
        let load = Boxes2D::from_half_sizes([place(width, height)])
            .with_colors([groups::SKY])
            .with_radii([Radius::new_ui_points(1.5)])
            .with_show_labels(true);
        send_static(output, "rig/load", &load)?;
        let target = LineStrips2D::update_fields()
            .with_colors([groups::ORANGE])
            .with_radii(thin);
        send_static(output, "rig/set_point", &target)
    }

    /// Draws the moving parts in a piece of the run.
    pub(super) fn log(
        &mut self,
        output: &mut dyn Output,
        timeline: &Timeline,
    ) -> Result<(), ReportError> {
        let poses = self.new_poses(timeline);
        let mut parts = poses.chunks(POSES_MAX);
        parts.try_for_each(|poses| self.log_poses(output, poses))
    }

    fn log_poses(&self, output: &mut dyn Output, poses: &[Pose]) -> Result<(), ReportError> {
        let times = times::columns(poses.iter().map(|pose| pose.moment));
        let strips = |strip: &dyn Fn(&Pose) -> Vec<[f32; 2]>| {
            LineStrips2D::update_fields().with_strips(poses.iter().map(strip))
        };
        let wire = strips(&|pose| vec![place(0.0, 0.0), place(self.joint(pose), 0.0)])
            .with_colors(poses.iter().map(|pose| colour(pose.celsius)))
            .columns_of_unit_batches()?;
        send_rows(output, "rig/wire", times.clone(), wire)?;
        let temperature = Points2D::update_fields()
            .with_colors(poses.iter().map(|pose| colour(pose.celsius)))
            .with_labels(poses.iter().map(|pose| with_unit(pose.celsius, 0, "°C")))
            .columns_of_unit_batches()?;
        send_rows(output, "rig/temperature", times.clone(), temperature)?;
        let load = Boxes2D::update_fields()
            .with_centers(poses.iter().map(|pose| {
                let [right, down] = self.load(pose.position);
                place(right, down)
            }))
            .with_labels(poses.iter().map(|pose| with_unit(pose.position, 1, "mm")))
            .columns_of_unit_batches()?;
        send_rows(output, "rig/load", times.clone(), load)?;
        let mut send = |path: &str, strip: &dyn Fn(&Pose) -> Vec<[f32; 2]>| {
            let lines = strips(strip).columns_of_unit_batches()?;
            send_rows(output, path, times.clone(), lines)
        };
        send("rig/lead", &|pose| {
            vec![place(self.joint(pose), 0.0), place(self.axle()[0], 0.0)]
        })?;
        send("rig/cord", &|pose| {
            let [right, top] = self.load(pose.position);
            vec![place(right, self.axle()[1]), place(right, top - LOAD[1])]
        })?;
        send("rig/spoke", &|pose| self.spoke(pose.position))?;
        send("rig/set_point", &|pose| self.target(pose.set_point))
    }

    /// Returns the rows that look different from the ones before.
    fn new_poses(&mut self, timeline: &Timeline) -> Vec<Pose> {
        let mut celsius = TEMPERATURES
            .iter()
            .find_map(|name| timeline.column(name))
            .map(|column| column.values.iter());
        let samples = timeline.position().iter().zip(timeline.set_point());
        let mut poses = Vec::new();
        for (moment, (position, set_point)) in times::moments(timeline).zip(samples) {
            let celsius = celsius.as_mut().and_then(Iterator::next);
            let pose = Pose {
                moment: match self.last {
                    None => times::first_moment(timeline, moment),
                    Some(_) => moment,
                },
                position,
                set_point,
                celsius: celsius.unwrap_or(f64::NAN),
            };
            let is_new = self.last.is_none_or(|last| {
                pose.moment.seconds - last.moment.seconds >= self.pause_seconds
                    && pose.differs_from(&last)
            });
            if position.is_finite() && is_new {
                self.last = Some(pose);
                poses.push(pose);
            }
        }
        poses
    }

    /// Returns the pulleys' axle: the wire pulls at the top of the inner one.
    fn axle(&self) -> [f64; 2] {
        [self.wire + GAP, self.inner]
    }

    /// Returns the wire's moving end; the load moves further by the ratio of the pulleys.
    fn joint(&self, pose: &Pose) -> f64 {
        self.wire - pose.position * self.inner / self.outer
    }

    /// Returns the middle of the load, which hangs from the outer pulley.
    fn load(&self, position: f64) -> [f64; 2] {
        let [right, down] = self.axle();
        [right + self.outer, down + CORD + LOAD[1] - position]
    }

    /// Returns the target of the load's upper edge.
    fn target(&self, set_point: f64) -> Vec<[f32; 2]> {
        if set_point.is_nan() {
            return Vec::new();
        }
        let [right, middle] = self.load(set_point);
        let reach = 1.6 * LOAD[0];
        [right - reach, right + reach]
            .map(|right| place(right, middle - LOAD[1]))
            .to_vec()
    }

    /// Returns a line across the outer pulley, which turns with it.
    fn spoke(&self, position: f64) -> Vec<[f32; 2]> {
        let angle = position / self.outer;
        let (across, up) = (self.outer * libm::cos(angle), self.outer * libm::sin(angle));
        let [right, down] = self.axle();
        vec![
            place(right - across, down + up),
            place(right + across, down - up),
        ]
    }

    fn circle(&self, radius: f64) -> Vec<[f32; 2]> {
        let [right, down] = self.axle();
        let corner = |number: u32| {
            let angle = TAU * f64::from(number) / f64::from(CORNERS);
            place(
                right + radius * libm::cos(angle),
                down + radius * libm::sin(angle),
            )
        };
        (0..=CORNERS).map(corner).collect()
    }
}

/// Returns the bounds of the view: least and largest coordinate, across and down.
pub(super) fn bounds(trial: &Trial) -> Option<[[f64; 2]; 2]> {
    let rig = Drawing::new(trial, 0.0)?;
    let [right, down] = rig.load(0.0);
    let top = rig.inner - rig.outer;
    Some([
        [-8.0, right + 2.2 * LOAD[0]],
        [top - 6.0, down + LOAD[1] + 24.0],
    ])
}

impl Pose {
    fn differs_from(&self, other: &Self) -> bool {
        let is_far = |a: f64, b: f64, step: f64| (a - b).abs() >= step || a.is_nan() != b.is_nan();
        is_far(self.position, other.position, STEP_MILLIMETRES)
            || is_far(self.set_point, other.set_point, STEP_MILLIMETRES)
            || is_far(self.celsius, other.celsius, STEP_CELSIUS)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "for the eye")]
fn place(right: f64, down: f64) -> [f32; 2] {
    [right as f32, down as f32]
}

/// Writes a number with its unit; empty for NaN.
fn with_unit(value: f64, decimals: usize, unit: &str) -> String {
    if value.is_nan() {
        String::new()
    } else {
        format!("{value:.decimals$} {unit}")
    }
}

/// Returns the colour of the wire at a temperature.
fn colour(celsius: f64) -> Color {
    let mut colour = COLOURS[0].1;
    for pair in COLOURS.windows(2) {
        let ((low, from), (high, to)) = (pair[0], pair[1]);
        let part = ((celsius - low) / (high - low)).clamp(0.0, 1.0);
        if part > 0.0 {
            colour = [0, 1, 2].map(|place| from[place] + part * (to[place] - from[place]));
        }
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between two colours"
    )]
    let [red, green, blue] = colour.map(|part| part as u8);
    Color::from_rgb(red, green, blue)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wire_glows_from_blue_to_red() {
        assert_eq!(colour(-10.0), Color::from_rgb(80, 130, 220));
        assert_eq!(colour(f64::NAN), Color::from_rgb(80, 130, 220));
        assert_eq!(colour(62.5), Color::from_rgb(235, 150, 60));
        assert_eq!(colour(300.0), Color::from_rgb(255, 50, 30));
    }
}
