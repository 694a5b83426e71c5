//! Path of a point that moves in the plane.

use re_sdk_types::archetypes::Points2D;
use recording::timeline::TIME_TOLERANCE_SECONDS;

use super::ReportError;
use super::output::{Output, send_rows};
use super::times::{self, Moment};

/// Place in the plane, with the time at which the point was there.
pub(super) type Passed = (Moment, [f64; 2]);

/// Places of the point that can be distinguished.
pub(super) struct Trail {
    pub(super) points: Vec<Passed>,
    last: Option<Passed>,
    /// Least time between two places.
    pause_seconds: f64,
}

impl Trail {
    /// Returns a path without places.
    pub(super) fn new(pause_seconds: f64) -> Self {
        Self {
            points: Vec::new(),
            last: None,
            pause_seconds,
        }
    }

    /// Adds a place, unless it is the last one.
    pub(super) fn add(
        &mut self,
        moment: Moment,
        point: [f64; 2],
        is_far: impl Fn([f64; 2], [f64; 2]) -> bool,
    ) {
        let is_new = self.last.is_none_or(|(before, last)| {
            let passed_seconds = moment.seconds - before.seconds + TIME_TOLERANCE_SECONDS;
            passed_seconds >= self.pause_seconds && is_far(point, last)
        });
        if is_new && point.iter().all(|value| value.is_finite()) {
            self.points.push((moment, point));
            self.last = Some((moment, point));
        }
    }
}

/// Logs some places of the point.
pub(super) fn log_moves(
    output: &mut dyn Output,
    entity: &str,
    points: &[Passed],
    place: impl Fn([f64; 2]) -> [f32; 2],
) -> Result<(), ReportError> {
    let times = times::columns(points.iter().map(|(moment, _)| *moment));
    let places = Points2D::new(points.iter().map(|(_, point)| place(*point)));
    send_rows(output, entity, times, places.columns_of_unit_batches()?)
}

#[cfg(test)]
mod tests {
    use super::super::contour::is_far;
    use super::super::{POINTS_MAX, thin};
    use super::*;

    #[test]
    fn the_path_of_a_long_run_stays_short() {
        let mut path = Trail::new(0.1);
        let mut longest = 0;
        for cycle in 0..10_000_000_i32 {
            let seconds = f64::from(cycle) * 1e-3;
            let moment = Moment {
                seconds,
                cycle: cycle.into(),
            };
            let point = [libm::cos(seconds), libm::sin(seconds)].map(|part| 10.0 * part);
            path.add(moment, point, is_far);
            thin(&mut path.points);
            longest = longest.max(path.points.len());
        }
        assert!(
            (POINTS_MAX / 2..=POINTS_MAX).contains(&longest),
            "{longest}"
        );
        let mut cycles = path.points.iter().map(|(moment, _)| moment.cycle);
        assert!(cycles.clone().is_sorted() && cycles.all(|cycle| cycle % 100 == 0));
    }

    #[test]
    fn a_place_that_cannot_be_distinguished_from_the_last_one_is_left_out() {
        let mut path = Trail::new(0.0);
        let places = [
            [f64::NAN, 1.0],
            [1.0, 1.0],
            [1.0, 1.0],
            [1.0, 1.01],
            [1.0, 1.1],
        ];
        for (cycle, place) in (0..).zip(places) {
            let seconds = 0.0;
            path.add(Moment { seconds, cycle }, place, is_far);
        }
        let cycles = path.points.iter().map(|(moment, _)| moment.cycle);
        assert_eq!(Vec::from_iter(cycles), [1, 4]);
    }
}
