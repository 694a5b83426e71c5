//! Whether a measured position can be true.
//!
//! A sample that cannot is no position; when too many in a row are none, the controller goes to its safe state. So a spike
//! costs one cycle, and a broken sensor the run.
//!
//! A position that stands still under a large current is suspicious, too. A wire under it moves, wherever the set-point is.
//! A motor does not: it holds a load by its current. There only a position that stays away from the set-point while the law
//! asks for all the current that there is cannot be meant.

use crate::cause::Cause;
use crate::law::CURRENT_AMPERES_MAX;

/// No wire lifts its load so high: the nominal travel is 60 mm, and any load stretches the wire. A converter at the end of
/// its range is beyond.
const POSITION_METRES_MAX: f64 = 59.5e-3;
/// Below the stop there is nothing but noise.
const POSITION_METRES_MIN: f64 = -2e-3;
/// Faster than the wire moves: 1 A takes it through its transformation, 60 mm, in 0.2 s.
const SPEED_METRES_PER_SECOND_MAX: f64 = 0.5;
/// Noise and quantisation of two samples.
const JUMP_METRES_MAX: f64 = 2e-3;

/// Mean square of a large current: the continuous current of the drive's protection. No position of the wire needs more:
/// either the wire moves, or it is at the top.
const LARGE_SQUARE_AMPERES: f64 = 0.9 * 0.9;
/// How long it is watched: longer than the nominal wire's time constant of 0.65 s.
const WATCH_SECONDS: f64 = 1.0;
/// What counts as motion.
const MOTION_METRES_MIN: f64 = 1e-3;
/// From here on the wire may be all austenite.
const TOP_METRES: f64 = 50e-3;
/// A motor is away from its set-point from here on.
const AWAY_METRES: f64 = 1e-3;

/// What was measured and commanded lately.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plausibility {
    /// Whether the plant is a wire, which a current heats.
    is_wire: bool,
    /// The latest position that can be true.
    last: Option<f64>,
    /// Since then.
    seconds_since: f64,
    /// The latest command.
    current_amperes: f64,
    watch: Watch,
}

/// A stretch of time in which a plant under a large current must move.
#[derive(Clone, Copy, Debug, Default)]
struct Watch {
    seconds: f64,
    square_ampere_seconds: f64,
    lowest_metres: f64,
    highest_metres: f64,
    /// The least distance from the set-point.
    distance_metres: f64,
}

impl Plausibility {
    pub(crate) fn new(is_wire: bool) -> Self {
        Self {
            is_wire,
            last: None,
            seconds_since: 0.0,
            current_amperes: 0.0,
            watch: Watch::default(),
        }
    }

    /// A cycle has passed under a current.
    pub(crate) fn advance(&mut self, period_seconds: f64, current_amperes: f64) {
        self.seconds_since += period_seconds;
        self.current_amperes = current_amperes;
        self.watch.seconds += period_seconds;
        self.watch.square_ampere_seconds += current_amperes * current_amperes * period_seconds;
    }

    /// Accepts a sample, unless it cannot be true.
    ///
    /// # Errors
    /// Why it cannot.
    pub(crate) fn check(
        &mut self,
        position_metres: f64,
        set_point_metres: f64,
    ) -> Result<(), Cause> {
        if !(POSITION_METRES_MIN..=POSITION_METRES_MAX).contains(&position_metres) {
            return Err(Cause::PositionOutsideTravel);
        }
        let reach = JUMP_METRES_MAX + SPEED_METRES_PER_SECOND_MAX * self.seconds_since;
        let jump = |last: f64| (position_metres - last).abs();
        if self.last.is_some_and(|last| jump(last) > reach) {
            return Err(Cause::PositionTooFast);
        }
        (self.last, self.seconds_since) = (Some(position_metres), 0.0);
        self.watch(position_metres, (set_point_metres - position_metres).abs())
    }

    fn watch(&mut self, position_metres: f64, distance_metres: f64) -> Result<(), Cause> {
        let watch = &mut self.watch;
        if watch.seconds < WATCH_SECONDS {
            watch.lowest_metres = watch.lowest_metres.min(position_metres);
            watch.highest_metres = watch.highest_metres.max(position_metres);
            watch.distance_metres = watch.distance_metres.min(distance_metres);
            return Ok(());
        }
        let is_current_large = watch.square_ampere_seconds > LARGE_SQUARE_AMPERES * watch.seconds;
        let is_still = watch.highest_metres - watch.lowest_metres < MOTION_METRES_MIN;
        let must_move = match self.is_wire {
            true => position_metres < TOP_METRES,
            false => {
                let is_at_limit = self.current_amperes.abs() >= CURRENT_AMPERES_MAX;
                is_at_limit && watch.distance_metres >= AWAY_METRES
            }
        };
        *watch = Watch {
            lowest_metres: position_metres,
            highest_metres: position_metres,
            distance_metres,
            ..Watch::default()
        };
        if is_current_large && is_still && must_move {
            return Err(Cause::PositionFrozen);
        }
        Ok(())
    }

    /// What is wrong with a position that stands still, for people.
    pub(crate) fn frozen_words(&self, position_metres: f64) -> String {
        let still = format!(
            "the position stands still at {:.1} mm",
            position_metres * 1e3
        );
        match self.is_wire {
            true => format!("{still} although the wire is heated"),
            false => format!(
                "{still}, away from the set-point, although the law commands the largest current: the plant is jammed or \
                 overloaded, or its sensor is stuck"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1e-3;

    /// What is said of samples of a wire in millimetres, one a cycle, under a current.
    fn check(current: f64, samples: impl Iterator<Item = f64>) -> Vec<Result<(), Cause>> {
        check_plant(true, current, 0.0, samples)
    }

    fn check_plant(
        is_wire: bool,
        current: f64,
        set_point_millimetres: f64,
        samples: impl Iterator<Item = f64>,
    ) -> Vec<Result<(), Cause>> {
        let mut plausibility = Plausibility::new(is_wire);
        let check = |millimetres: f64| {
            plausibility.advance(PERIOD, current);
            plausibility.check(millimetres * 1e-3, set_point_millimetres * 1e-3)
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

    /// A motor holds a load by its current: at the set-point by any, away from it (a law without an integral) by less than
    /// the largest.
    #[test]
    fn a_motor_that_holds_is_not_stuck_and_one_that_cannot_follow_is() {
        let still = |current, set_point| {
            let checked = check_plant(false, current, set_point, (0..3500).map(|_| 20.0));
            checked.iter().position(Result::is_err)
        };
        assert_eq!(still(1.0, 20.2), None, "at the set-point");
        assert_eq!(still(0.97, 35.0), None, "held by a part of the current");
        let found = |cycle: usize| (1000..=3000).contains(&cycle);
        assert!(still(1.0, 35.0).is_some_and(found), "jammed");
        assert!(still(-1.0, 5.0).is_some_and(found), "jammed, driven down");
        assert_eq!(still(1.0, f64::NAN), None, "without a set-point");
        let late = (0..3000).map(|cycle| 20.0 + 2e-3 * f64::from(cycle));
        assert!(
            check_plant(false, 1.0, 50.0, late)
                .iter()
                .all(Result::is_ok)
        );
    }
}
