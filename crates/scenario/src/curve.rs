//! A curve over time, made of pieces: a later piece replaces an earlier one. Set-points and current profiles share it; the
//! position of a profile is its current.

use std::f64::consts::TAU;
use std::sync::Arc;

use crate::reference::{Chirp, SetPoint, Sine};

/// A piece as the scenario describes it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Piece {
    /// A constant.
    Constant { value: f64 },
    /// A straight line from the curve's present value to `end` at `until_seconds`, then constant.
    Line { until_seconds: f64, end: f64 },
    /// A sine.
    Sine(Sine),
    /// A sine whose frequency moves.
    Chirp(Chirp),
    /// Straight lines through rows `(seconds from the start, value)`, constant outside.
    Table { rows: Arc<[(f64, f64)]> },
}

impl SetPoint {
    fn line(position: f64, velocity: f64) -> Self {
        Self {
            position,
            velocity,
            ..Self::default()
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
struct Segment {
    start_seconds: f64,
    start_value: f64,
    piece: Piece,
}

/// Set-point or current prepared for a look-up in every cycle.
///
/// The piece that started last acts; before the first piece the value is 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    segments: Vec<Segment>,
}

impl Trajectory {
    /// Sorts the pieces by their starts and gives each line its first value.
    pub(crate) fn new(mut pieces: Vec<(f64, Piece)>) -> Self {
        pieces.sort_by(|left, right| left.0.total_cmp(&right.0));
        let mut curve = Self {
            segments: Vec::with_capacity(pieces.len()),
        };
        for (start_seconds, piece) in pieces {
            let start_value = curve.at(start_seconds).position;
            curve.segments.push(Segment {
                start_seconds,
                start_value,
                piece,
            });
        }
        curve
    }

    /// The raw set-point at a scenario time, by a binary search without allocation.
    ///
    /// ```
    /// use scenario::reference::{Reference, Step};
    /// let step = vec![Step { at_seconds: 10.0, position: 35.0 }];
    /// let trajectory = Reference { step, ..Reference::default() }.trajectory();
    /// assert_eq!(trajectory.at(9.999).position, 0.0);
    /// assert_eq!(trajectory.at(10.0).position, 35.0);
    /// ```
    pub fn at(&self, time_seconds: f64) -> SetPoint {
        let started = self
            .segments
            .partition_point(|segment| segment.start_seconds <= time_seconds);
        match started.checked_sub(1) {
            Some(last) => self.segments[last].at(time_seconds),
            None => SetPoint::default(),
        }
    }

    /// Returns stretches of scenario time that together show every value until `end_seconds`. The rest of a piece that is constant
    /// or periodic is left out, and a stretch may end where it begins.
    pub fn stretches(&self, end_seconds: f64) -> impl Iterator<Item = (f64, f64)> {
        let starts = self.segments.iter().map(|segment| segment.start_seconds);
        let ends = starts.skip(1).chain([end_seconds]);
        let pieces = self.segments.iter().zip(ends).map(move |(piece, end)| {
            let until = piece.is_new_until_seconds().min(end).min(end_seconds);
            (piece.start_seconds, until)
        });
        [(0.0, 0.0)].into_iter().chain(pieces)
    }

    /// Returns rows `(seconds, value)` until a time, with straight lines between them; two rows at one time are a jump. A piece
    /// that is not a straight line has a row in each spacing.
    pub fn rows(&self, end_seconds: f64, spacing_seconds: f64) -> Vec<(f64, f64)> {
        let mut rows = vec![(0.0, self.at(0.0).position)];
        let starts = self.segments.iter().map(|segment| segment.start_seconds);
        let ends = starts.skip(1).chain([f64::INFINITY]);
        for (segment, end) in self.segments.iter().zip(ends) {
            let (start, end) = (segment.start_seconds, end.min(end_seconds));
            if start > end {
                break;
            }
            if let Some((_, before)) = rows.last().copied() {
                rows.push((start, before));
            }
            let between = segment
                .corners_seconds(end, spacing_seconds)
                .into_iter()
                .filter(|time| (start..end).contains(time));
            let times = [start].into_iter().chain(between).chain([end]);
            rows.extend(times.map(|time| (time, segment.at(time).position)));
        }
        rows.dedup();
        rows
    }
}

impl Segment {
    /// Returns the times at which its straight lines meet.
    fn corners_seconds(&self, end_seconds: f64, spacing_seconds: f64) -> Vec<f64> {
        match &self.piece {
            Piece::Constant { .. } => Vec::new(),
            Piece::Line { until_seconds, .. } => vec![*until_seconds],
            Piece::Table { rows } => {
                let times = rows.iter().map(|(seconds, _)| self.start_seconds + seconds);
                times.collect()
            }
            Piece::Sine(_) | Piece::Chirp(_) => {
                let first = libm::ceil(self.start_seconds / spacing_seconds);
                let times = (0_u32..).map(|place| (first + f64::from(place)) * spacing_seconds);
                times.take_while(|time| *time < end_seconds).collect()
            }
        }
    }

    /// Returns the time from which on the piece only repeats values.
    fn is_new_until_seconds(&self) -> f64 {
        match &self.piece {
            Piece::Constant { .. } => self.start_seconds,
            Piece::Line { until_seconds, .. } => *until_seconds,
            Piece::Chirp(chirp) => chirp.until_seconds,
            Piece::Sine(sine) => self.start_seconds + TAU / sine.radians_per_second(),
            Piece::Table { rows } => {
                self.start_seconds + rows.last().map_or(0.0, |(seconds, _)| *seconds)
            }
        }
    }

    fn at(&self, time_seconds: f64) -> SetPoint {
        let elapsed = time_seconds - self.start_seconds;
        match &self.piece {
            Piece::Constant { value } => SetPoint::line(*value, 0.0),
            Piece::Line { until_seconds, end } => {
                let rows = [
                    (0.0, self.start_value),
                    (until_seconds - self.start_seconds, *end),
                ];
                interpolate(&rows, elapsed)
            }
            Piece::Sine(sine) => sine.at(elapsed),
            Piece::Chirp(chirp) if time_seconds < chirp.until_seconds => chirp.at(elapsed),
            Piece::Chirp(chirp) => SetPoint::line(chirp.centre, 0.0),
            Piece::Table { rows } => interpolate(rows, elapsed),
        }
    }
}

impl Sine {
    fn radians_per_second(&self) -> f64 {
        TAU / self.period_seconds
    }

    /// Returns `centre + amplitude sin(ω t)` with its exact derivatives.
    fn at(&self, elapsed_seconds: f64) -> SetPoint {
        let (amplitude, omega) = (self.amplitude, self.radians_per_second());
        // The phase within one turn keeps its accuracy in long runs.
        let turns = omega * elapsed_seconds / TAU;
        let (sin, cos) = libm::sincos(TAU * (turns - libm::floor(turns)));
        SetPoint {
            position: self.centre + amplitude * sin,
            velocity: amplitude * omega * cos,
            acceleration: -amplitude * omega * omega * sin,
            jerk: -amplitude * omega * omega * omega * cos,
            has_exact_derivatives: true,
        }
    }
}

impl Chirp {
    /// Returns `centre + amplitude sin φ` with its exact derivatives.
    fn at(&self, elapsed_seconds: f64) -> SetPoint {
        let (amplitude, phase) = (self.amplitude, self.phase_at(elapsed_seconds));
        let (sin, cos) = libm::sincos(phase.radians());
        let [omega, slope, curvature] = phase.derivatives;
        let jerk = (curvature - omega * omega * omega) * cos - 3.0 * omega * slope * sin;
        SetPoint {
            position: self.centre + amplitude * sin,
            velocity: amplitude * omega * cos,
            acceleration: amplitude * (slope * cos - omega * omega * sin),
            jerk: amplitude * jerk,
            has_exact_derivatives: true,
        }
    }
}

/// Interpolates the rows by straight lines; constant before the first row and from the last on.
pub(crate) fn interpolate(rows: &[(f64, f64)], time: f64) -> SetPoint {
    let next = rows.partition_point(|row| row.0 <= time);
    match (next.checked_sub(1).map(|last| rows[last]), rows.get(next)) {
        (Some((from, start)), Some(&(until, end))) => {
            let slope = (end - start) / (until - from);
            SetPoint::line(start + slope * (time - from), slope)
        }
        (Some((_, value)), None) | (None, Some(&(_, value))) => SetPoint::line(value, 0.0),
        (None, None) => SetPoint::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::Spacing;

    #[test]
    fn zero_before_the_first_piece_and_without_pieces() {
        assert_eq!(Trajectory::default().at(1.0).position, 0.0);
        let curve = Trajectory::new(vec![(2.0, Piece::Constant { value: 5.0 })]);
        assert_eq!(curve.at(1.999).position, 0.0);
        assert_eq!(curve.at(2.0).position, 5.0);
        assert_eq!(curve.at(f64::NAN), SetPoint::default());
    }

    #[test]
    fn a_line_starts_from_the_present_value_even_of_an_unfinished_line() {
        let line = |until_seconds, end| Piece::Line { until_seconds, end };
        let curve = Trajectory::new(vec![(1.0, line(3.0, 4.0)), (2.0, line(4.0, 0.0))]);
        assert_eq!(curve.at(1.5).position, 1.0);
        assert_eq!(curve.at(1.5).velocity, 2.0);
        assert_eq!(curve.at(2.0).position, 2.0);
        assert_eq!(curve.at(3.0).position, 1.0);
        assert_eq!(curve.at(9.0), SetPoint::line(0.0, 0.0));
    }

    #[test]
    fn derivatives_of_sines_and_chirps_agree_with_differences() {
        check_derivatives(Piece::Sine(Sine {
            from_seconds: 1.0,
            centre: 25.0,
            amplitude: 10.0,
            period_seconds: TAU / 1.3,
        }));
        for spacing in [Spacing::Linear, Spacing::Logarithmic] {
            check_derivatives(Piece::Chirp(Chirp {
                from_seconds: 1.0,
                until_seconds: 61.0,
                centre: 25.0,
                amplitude: 10.0,
                from_hertz: 0.1,
                until_hertz: 0.4,
                spacing,
            }));
        }
    }

    #[track_caller]
    fn check_derivatives(piece: Piece) {
        let curve = Trajectory::new(vec![(1.0, piece)]);
        let step = 1e-4;
        for time in [1.0, 2.7, 50.3] {
            let (before, now, after) = (
                curve.at(time),
                curve.at(time + step),
                curve.at(time + 2.0 * step),
            );
            let values = |one: SetPoint| [one.position, one.velocity, one.acceleration, one.jerk];
            for order in 0..3 {
                let difference = (values(after)[order] - values(before)[order]) / (2.0 * step);
                assert!(
                    (difference - values(now)[order + 1]).abs() < 1e-4,
                    "{order} at {time}: {difference}, {:?}",
                    values(now)
                );
            }
            assert!(now.has_exact_derivatives);
        }
    }

    #[test]
    fn a_table_counts_from_its_start_and_holds_its_last_row() {
        let rows = Arc::new([(0.5, 1.0), (1.5, 3.0)]);
        let curve = Trajectory::new(vec![(10.0, Piece::Table { rows })]);
        assert_eq!(curve.at(10.0).position, 1.0);
        assert_eq!(curve.at(11.0).position, 2.0);
        assert_eq!(curve.at(20.0).position, 3.0);
    }
}
