//! Whether a measured position can be true.
//!
//! A sample that cannot is no position; when too many in a row are none, the controller goes to its safe state. So a spike
//! costs one cycle, and a broken sensor the run.

use crate::cause::Cause;

/// No wire lifts its load so high: the nominal travel is 60 mm, and any load stretches the wire. A converter at the end of
/// its range is beyond.
const POSITION_METRES_MAX: f64 = 59.5e-3;
/// Below the stop there is nothing but noise.
const POSITION_METRES_MIN: f64 = -2e-3;
/// Faster than the wire moves: 1 A takes it through its transformation, 60 mm, in 0.2 s.
const SPEED_METRES_PER_SECOND_MAX: f64 = 0.5;
/// Noise and quantisation of two samples.
const JUMP_METRES_MAX: f64 = 2e-3;

/// Above this mean square, the continuous current of the drive's protection, no position needs more: either the wire
/// moves, or it is at the top.
const HEATED_SQUARE_AMPERES: f64 = 0.9 * 0.9;
/// How long it is watched: longer than the nominal wire's time constant of 0.65 s.
const WATCH_SECONDS: f64 = 1.0;
/// What counts as motion.
const MOTION_METRES_MIN: f64 = 1e-3;
/// From here on the wire may be all austenite.
const TOP_METRES: f64 = 50e-3;

/// What was measured and commanded lately.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Plausibility {
    /// The latest position that can be true.
    last: Option<f64>,
    /// Since then.
    seconds_since: f64,
    watch: Watch,
}

/// A stretch of time in which a heated wire must move.
#[derive(Clone, Copy, Debug, Default)]
struct Watch {
    seconds: f64,
    square_ampere_seconds: f64,
    lowest_metres: f64,
    highest_metres: f64,
}

impl Plausibility {
    /// A cycle has passed under a current.
    pub(crate) fn advance(&mut self, period_seconds: f64, current_amperes: f64) {
        self.seconds_since += period_seconds;
        self.watch.seconds += period_seconds;
        self.watch.square_ampere_seconds += current_amperes * current_amperes * period_seconds;
    }

    /// Takes a sample, unless it cannot be true.
    ///
    /// # Errors
    /// Why it cannot.
    pub(crate) fn check(&mut self, position_metres: f64) -> Result<(), Cause> {
        if !(POSITION_METRES_MIN..=POSITION_METRES_MAX).contains(&position_metres) {
            return Err(Cause::PositionOutsideTravel);
        }
        let reach = JUMP_METRES_MAX + SPEED_METRES_PER_SECOND_MAX * self.seconds_since;
        let jump = |last: f64| (position_metres - last).abs();
        if self.last.is_some_and(|last| jump(last) > reach) {
            return Err(Cause::PositionTooFast);
        }
        (self.last, self.seconds_since) = (Some(position_metres), 0.0);
        self.watch(position_metres)
    }

    fn watch(&mut self, position_metres: f64) -> Result<(), Cause> {
        let watch = &mut self.watch;
        if watch.seconds < WATCH_SECONDS {
            watch.lowest_metres = watch.lowest_metres.min(position_metres);
            watch.highest_metres = watch.highest_metres.max(position_metres);
            return Ok(());
        }
        let is_heated = watch.square_ampere_seconds > HEATED_SQUARE_AMPERES * watch.seconds;
        let is_still = watch.highest_metres - watch.lowest_metres < MOTION_METRES_MIN;
        *watch = Watch {
            lowest_metres: position_metres,
            highest_metres: position_metres,
            ..Watch::default()
        };
        if is_heated && is_still && position_metres < TOP_METRES {
            return Err(Cause::PositionFrozen);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1e-3;

    /// Takes samples in millimetres, one a cycle, under a current.
    fn check(current: f64, samples: impl Iterator<Item = f64>) -> Vec<Result<(), Cause>> {
        let mut plausibility = Plausibility::default();
        let check = |millimetres: f64| {
            plausibility.advance(PERIOD, current);
            plausibility.check(millimetres * 1e-3)
        };
        samples.map(check).collect()
    }

    #[test]
    fn a_spike_is_no_position_and_the_next_sample_is_one_again() {
        let samples = [10.0, 10.1, 25.0, 10.2, 59.9, 10.2, -5.0];
        let checked = check(0.5, samples.into_iter());
        let (fast, outside) = (Cause::PositionTooFast, Cause::PositionOutsideTravel);
        let expected = [
            Ok(()),
            Ok(()),
            Err(fast),
            Ok(()),
            Err(outside),
            Ok(()),
            Err(outside),
        ];
        assert_eq!(checked, expected);
    }

    #[test]
    fn the_fastest_true_motion_passes() {
        // 25 mm in 0.1 s, twice what 1 A does.
        let motion = (0..100).map(|cycle| 10.0 + 0.25 * f64::from(cycle));
        assert!(check(1.0, motion).iter().all(Result::is_ok));
    }

    #[test]
    fn a_position_that_stands_still_under_full_current_is_found_within_two_seconds() {
        let still = |current, millimetres| {
            let checked = check(current, (0..3000).map(|_| millimetres));
            checked.iter().position(Result::is_err)
        };
        assert!(still(1.0, 20.0).is_some_and(|cycle| cycle <= 2000));
        assert_eq!(still(0.85, 20.0), None, "a warm hold");
        assert_eq!(still(1.0, 57.0), None, "at the top");
        let creeping = (0..3000).map(|cycle| 20.0 + 2e-3 * f64::from(cycle));
        assert!(check(1.0, creeping).iter().all(Result::is_ok));
    }
}
