//! The `[reference]` table: the raw position set-point over scenario time.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::curve::Piece;
pub use crate::curve::Trajectory;
use crate::sweep::Spacing;

/// The position set-point, in pieces ordered by time.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Reference {
    /// A position from a time on. The set-point jumps there, but no metric judges it as a step.
    #[schemars(length(max = 10_000))]
    pub hold: Vec<Hold>,
    /// A jump that the metrics judge.
    #[schemars(length(max = 10_000))]
    pub step: Vec<Step>,
    /// A linear move from the present value.
    #[schemars(length(max = 10_000))]
    pub ramp: Vec<Ramp>,
    /// A sine about a centre.
    #[schemars(length(max = 10_000))]
    pub sine: Vec<Sine>,
    /// A sine whose frequency moves, which shows gain and phase over frequency in one run.
    #[schemars(length(max = 10_000))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub chirp: Vec<Chirp>,
    /// A table from a CSV file.
    #[schemars(length(max = 10_000))]
    pub table: Vec<Table>,
}

/// A position from a time on.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Hold {
    /// Time at which the hold begins.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// Set-point that is held.
    #[serde(rename = "{signal}_{unit}")]
    pub position: f64,
}

/// A jump.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Time of the jump.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// Set-point after the jump.
    #[serde(rename = "{signal}_{unit}")]
    pub position: f64,
}

/// A linear move from the present value; the end value holds.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    /// Start of the ramp.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// End of the ramp.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: f64,
    /// Set-point at the end.
    #[serde(rename = "{signal}_{unit}")]
    pub position: f64,
}

/// A harmonic `centre + amplitude sin(2π (t − from) / period)`.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Sine {
    /// Start of the sine.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// Mean of the sine.
    #[serde(rename = "centre_{unit}")]
    pub centre: f64,
    /// Amplitude of the sine.
    #[serde(rename = "amplitude_{unit}")]
    pub amplitude: f64,
    /// Period of the sine.
    #[schemars(range(min = 0.01, max = 3_600.0))]
    pub period_seconds: f64,
}

/// A harmonic `centre + amplitude sin φ` whose frequency moves from one value to another; then its centre holds.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Chirp {
    /// Start of the chirp.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// End of the chirp.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: f64,
    /// Mean of the chirp.
    #[serde(rename = "centre_{unit}")]
    pub centre: f64,
    /// Amplitude of the chirp.
    #[serde(rename = "amplitude_{unit}")]
    pub amplitude: f64,
    /// Frequency at its start.
    #[schemars(range(min = 0.000_1, max = 100.0))]
    pub from_hertz: f64,
    /// Frequency at its end.
    #[schemars(range(min = 0.000_1, max = 100.0))]
    pub until_hertz: f64,
    /// Spacing of the frequency over time; `linear` if absent.
    #[serde(default)]
    pub spacing: Spacing,
}

/// Straight lines through the rows of a CSV file with the columns `time_seconds,position_millimetres`.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Start; the file's times count from here.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// The file, relative to the scenario.
    pub file: String,
    /// The rows, time in seconds and set-point, put in by the loader.
    #[serde(skip)]
    pub rows: Arc<[(f64, f64)]>,
}

/// Set-point and its derivatives at one time, in the unit of the loop and seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetPoint {
    /// Set-point.
    pub position: f64,
    /// First derivative of the set-point.
    pub velocity: f64,
    /// Second derivative of the set-point.
    pub acceleration: f64,
    /// Third derivative of the set-point.
    pub jerk: f64,
    /// Whether the derivatives are exact (sine, chirp): such a set-point bypasses the reference filter (PAPER E5).
    pub has_exact_derivatives: bool,
}

impl Reference {
    /// Checks whether there is no piece.
    pub fn is_empty(&self) -> bool {
        self.starts_seconds().next().is_none()
    }

    /// Prepares the set-point for a look-up in every cycle.
    pub fn trajectory(&self) -> Trajectory {
        Trajectory::new(self.pieces().collect())
    }

    /// Returns the starts of all pieces, kind by kind.
    pub fn starts_seconds(&self) -> impl Iterator<Item = f64> + '_ {
        self.pieces().map(|(start_seconds, _)| start_seconds)
    }

    /// Returns all pieces, kind by kind, each with its start.
    fn pieces(&self) -> impl Iterator<Item = (f64, Piece)> + '_ {
        let holds = self.hold.iter().map(|one| (one.at_seconds, one.position));
        let steps = self.step.iter().map(|one| (one.at_seconds, one.position));
        let jumps = holds.chain(steps);
        let constants = jumps.map(|(start, value)| (start, Piece::Constant { value }));
        let ramps = self.ramp.iter().map(|ramp| {
            let (until_seconds, end) = (ramp.until_seconds, ramp.position);
            (ramp.from_seconds, Piece::Line { until_seconds, end })
        });
        let sines = self.sine.iter();
        let harmonics = sines.map(|sine| (sine.from_seconds, Piece::Sine(sine.clone())));
        let chirps = self.chirp.iter();
        let swept = chirps.map(|chirp| (chirp.from_seconds, Piece::Chirp(chirp.clone())));
        let tables = self.table.iter().map(|table| {
            let rows = table.rows.clone();
            (table.from_seconds, Piece::Table { rows })
        });
        let moving = ramps.chain(harmonics).chain(swept).chain(tables);
        constants.chain(moving)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_of_each() -> Reference {
        Reference {
            hold: vec![Hold {
                at_seconds: 0.0,
                position: 10.0,
            }],
            step: vec![Step {
                at_seconds: 1.0,
                position: 30.0,
            }],
            ramp: vec![Ramp {
                from_seconds: 2.0,
                until_seconds: 4.0,
                position: 20.0,
            }],
            sine: vec![Sine {
                from_seconds: 5.0,
                centre: 25.0,
                amplitude: 10.0,
                period_seconds: 4.0,
            }],
            table: vec![Table {
                from_seconds: 8.0,
                file: String::new(),
                rows: Arc::new([(0.0, 1.0), (1.0, 2.0)]),
            }],
            // One turn: 0.5 Hz on average for 2 s.
            chirp: vec![Chirp {
                from_seconds: 10.0,
                until_seconds: 12.0,
                centre: 30.0,
                amplitude: 5.0,
                from_hertz: 0.25,
                until_hertz: 0.75,
                spacing: Spacing::Linear,
            }],
        }
    }

    #[test]
    fn rows_are_the_set_point_in_straight_lines() {
        let trajectory = one_of_each().trajectory();
        let rows = trajectory.rows(20.0, 0.001);
        assert_eq!(
            rows[..6],
            [
                (0.0, 10.0),
                (1.0, 10.0),
                (1.0, 30.0),
                (2.0, 30.0),
                (4.0, 20.0),
                (5.0, 20.0)
            ]
        );
        for time in (0..20_000).map(|cycle| f64::from(cycle) * 0.001) {
            let behind = rows.partition_point(|(at, _)| *at <= time);
            let (from, to) = (rows[behind - 1], rows[behind]);
            let share = (time - from.0) / (to.0 - from.0);
            let straight = from.1 + share * (to.1 - from.1);
            let exact = trajectory.at(time).position;
            assert!(
                (straight - exact).abs() < 1e-9,
                "{straight} for {exact} at {time}"
            );
        }
    }

    #[test]
    fn every_kind_of_piece_takes_its_turn() {
        let trajectory = one_of_each().trajectory();
        let expected = [
            (0.5, 10.0),
            (1.0, 30.0),
            (3.0, 25.0),
            (4.5, 20.0),
            (5.0, 25.0),
            (6.0, 35.0),
            (8.5, 1.5),
            (9.9, 2.0),
            (10.0, 30.0),
            // 0.375 turns after 1 s.
            (11.0, 30.0 + 5.0 * std::f64::consts::FRAC_1_SQRT_2),
            (12.0, 30.0),
            (99.0, 30.0),
        ];
        for (time, millimetres) in expected {
            let position = trajectory.at(time).position;
            assert!(
                (position - millimetres).abs() < 1e-9,
                "{position} at {time}"
            );
        }
        assert!(trajectory.at(6.0).has_exact_derivatives);
        assert!(trajectory.at(11.9).has_exact_derivatives);
        assert!(!trajectory.at(12.0).has_exact_derivatives);
        assert!(!trajectory.at(3.0).has_exact_derivatives);
        assert!((trajectory.at(3.0).velocity + 5.0).abs() < 1e-9);
    }
}
