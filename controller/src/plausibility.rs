//! Plausibility of a measured position.
//!
//! An implausible sample is no position. After too many of them in a row the controller goes to its safe state. So a
//! spike costs one cycle, and a broken sensor the run.
//!
//! A position that does not move under a large current is suspicious, too. A wire moves under it, wherever the
//! set-point is. A motor does not: it holds a load by its current. A motor's position is only implausible if it stays
//! away from the set-point while the law commands the largest current. At an end of the travel no current moves the
//! position outward.
//!
//! The limits of a position are data of the drive's node; see [`Plausible`].

use dbc::CommandRange;
use scenario::wiring::{Plausible, Wiring};

use crate::cause::Cause;

/// Recent positions and commands.
#[derive(Clone, Debug)]
pub(crate) struct Plausibility {
    plausible: Plausible,
    /// Ends of the travel.
    ends: [f64; 2],
    /// Range of the drive's commands.
    commands: CommandRange,
    /// Name and unit of the signal, for error texts.
    signal: String,
    symbol: String,
    /// Latest plausible position.
    last: Option<f64>,
    /// Time since then.
    seconds_since: f64,
    /// Time since the latest position that was not above the highest one.
    seconds_above: f64,
    /// Latest command.
    command: f64,
    watch: Watch,
}

/// A period in which a plant under a large current must move.
#[derive(Clone, Copy, Debug, Default)]
struct Watch {
    seconds: f64,
    squared_command_integral: f64,
    lowest: f64,
    highest: f64,
    /// Smallest distance from the set-point.
    distance: f64,
}

impl Plausibility {
    /// Makes the check for a drive with this wiring.
    pub(crate) fn new(wiring: &Wiring) -> Self {
        Self {
            plausible: wiring.plausible,
            ends: wiring.sensor.range(),
            commands: wiring.amplifier.range(),
            signal: wiring.sensor.quantity.name.replace('_', " "),
            symbol: wiring.sensor.quantity.unit.symbol().to_owned(),
            last: None,
            seconds_since: 0.0,
            seconds_above: 0.0,
            command: 0.0,
            watch: Watch::default(),
        }
    }

    /// Advances by a cycle under a command.
    pub(crate) fn advance(&mut self, period_seconds: f64, command: f64) {
        self.seconds_since += period_seconds;
        self.seconds_above += period_seconds;
        self.command = command;
        self.watch.seconds += period_seconds;
        self.watch.squared_command_integral += command * command * period_seconds;
    }

    /// Accepts a sample, unless it is implausible.
    ///
    /// # Errors The sample is implausible, or the position has not moved for too long.
    pub(crate) fn check(&mut self, position: f64, set_point: f64) -> Result<(), Cause> {
        let Plausible {
            min,
            max,
            rate_max,
            jump,
            thrown_seconds,
            ..
        } = self.plausible;
        let reach = rate_max.map(|rate| jump.unwrap_or_default() + rate * self.seconds_since);
        let is_near = |last: f64| reach.is_none_or(|reach| (position - last).abs() <= reach);
        let jumps = !self.last.is_none_or(is_near);
        let is_above = max.is_some_and(|max| position > max);
        let is_thrown = self.last.is_some()
            && !jumps
            && thrown_seconds.is_some_and(|seconds| self.seconds_above <= seconds);
        if !position.is_finite() || min.is_some_and(|min| position < min) || is_above && !is_thrown
        {
            return Err(Cause::PositionOutsideTravel);
        }
        if jumps {
            return Err(Cause::PositionTooFast);
        }
        if !is_above {
            self.seconds_above = 0.0;
        }
        (self.last, self.seconds_since) = (Some(position), 0.0);
        self.watch(position, (set_point - position).abs())
    }

    fn watch(&mut self, position: f64, distance: f64) -> Result<(), Cause> {
        let Some(stall) = self.plausible.stall else {
            return Ok(());
        };
        let is_outward = self.pushes_outward(position, stall.motion);
        let watch = &mut self.watch;
        if watch.seconds < stall.seconds {
            watch.lowest = watch.lowest.min(position);
            watch.highest = watch.highest.max(position);
            watch.distance = watch.distance.min(distance);
            return Ok(());
        }
        let large = stall.current_rms * stall.current_rms;
        let is_command_large = watch.squared_command_integral > large * watch.seconds;
        let is_still = watch.highest - watch.lowest < stall.motion;
        let is_at_limit = self.commands.is_at_end(self.command);
        let is_away = |away| is_at_limit && watch.distance >= away;
        let must_move = !is_outward
            && stall.below.is_none_or(|below| position < below)
            && stall.away.is_none_or(is_away);
        *watch = Watch {
            lowest: position,
            highest: position,
            distance,
            ..Watch::default()
        };
        if is_command_large && is_still && must_move {
            return Err(Cause::PositionFrozen);
        }
        Ok(())
    }

    /// Returns whether the plant is at an end of its travel and the command pushes it outward.
    fn pushes_outward(&self, position: f64, motion: f64) -> bool {
        let [lowest, highest] = self.ends;
        (position >= highest - motion && self.command > 0.0)
            || (position <= lowest + motion && self.command < 0.0)
    }

    /// Returns the name of the signal, for messages.
    pub(crate) fn signal(&self) -> &str {
        &self.signal
    }

    /// Returns the error text for a position that does not move.
    pub(crate) fn frozen_message(&self, position: f64) -> String {
        let Self { signal, symbol, .. } = self;
        let still = format!("the {signal} stands still at {position:.1} {symbol}");
        let away = self.plausible.stall.and_then(|stall| stall.away);
        match away {
            None => format!("{still} although the wire is heated"),
            Some(_) => format!(
                "{still}, away from the set-point, although the law commands the largest current: the plant is jammed or \
                 overloaded, or its sensor is stuck"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use scenario::wiring::Measured;

    use super::*;
    use dbc::{Quantity, Unit};
    use scenario::Scenario;
    use scenario::rig::shipped;

    const PERIOD: f64 = 1e-3;

    /// Returns the results for samples of a wire in millimetres, one a cycle, under a current.
    fn check(current: f64, samples: impl Iterator<Item = f64>) -> Vec<Result<(), Cause>> {
        check_on("sma_actuator", current, 0.0, samples)
    }

    /// Returns the same on a rig that ships.
    fn check_on(
        rig: &str,
        current: f64,
        set_point_millimetres: f64,
        samples: impl Iterator<Item = f64>,
    ) -> Vec<Result<(), Cause>> {
        let idle = Scenario::from_rig(shipped::text(rig).unwrap(), rig).unwrap();
        let mut plausibility = Plausibility::new(&idle.loops.first().unwrap().wiring);
        let check = |millimetres: f64| {
            plausibility.advance(PERIOD, current);
            plausibility.check(millimetres, set_point_millimetres)
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
        // This is 25 mm in 0.1 s, twice the speed under 1 A.
        let motion = (0..100).map(|cycle| 10.0 + 0.25 * f64::from(cycle));
        assert!(check(1.0, motion).iter().all(Result::is_ok));
    }

    /// A wire that transforms within few degrees throws its load to the end of the converter. A position that stays
    /// there is implausible.
    #[test]
    fn a_load_that_is_thrown_beyond_the_travel_is_believed_and_a_converter_at_its_end_is_not() {
        let rise = (0..120).map(|cycle| (0.5 * f64::from(cycle)).min(59.94));
        let fall = (0..100).map(|cycle| 59.94 - 0.3 * f64::from(cycle));
        let stays = |cycles: usize| std::iter::repeat_n(59.94, cycles);
        let back = rise.clone().chain(stays(150)).chain(fall);
        assert!(check(0.5, back).iter().all(Result::is_ok));
        let checked = check(0.5, rise.chain(stays(300)));
        let outside = Err(Cause::PositionOutsideTravel);
        let first = checked.iter().position(Result::is_err).unwrap();
        assert!((318..=322).contains(&first), "{first}");
        assert!(checked[first..].iter().all(|one| *one == outside));
        assert_eq!(check(0.5, stays(1)), [outside]);
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

    /// A motor holds a load by its current: at the set-point by any, away from it (a law without an integral) by less
    /// than the largest.
    #[test]
    fn a_motor_that_holds_is_not_stuck_and_one_that_cannot_follow_is() {
        let still = |current, set_point| {
            let checked = check_on("dc_motor", current, set_point, (0..3500).map(|_| 20.0));
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
            check_on("dc_motor", 1.0, 50.0, late)
                .iter()
                .all(Result::is_ok)
        );
    }

    /// A motor that pushes against an end of its travel holds there, whatever the law commands.
    #[test]
    fn a_current_that_pushes_outward_at_an_end_is_no_stall() {
        let stalls = |current, millimetres, set_point| {
            let samples = (0..3500).map(|_| millimetres);
            check_on("dc_motor", current, set_point, samples)
                .iter()
                .any(Result::is_err)
        };
        assert!(!stalls(-1.0, 0.0, -5.0), "down on the stop");
        assert!(!stalls(1.0, 59.2, 64.0), "up at the top");
        assert!(stalls(1.0, 0.0, 5.0), "up from the stop");
        assert!(stalls(-1.0, 59.2, 50.0), "down from the top");
    }

    #[test]
    fn what_a_node_says_is_watched_in_its_unit_and_nothing_else() {
        let watched = |plausible, samples: &[f64]| {
            let wiring = Wiring {
                sensor: Measured {
                    quantity: Quantity::position(Unit::Degrees),
                    min: -60.0,
                    max: Some(60.0),
                    ..Measured::default()
                },
                plausible,
                ..Wiring::default()
            };
            let mut plausibility = Plausibility::new(&wiring);
            let check = |degrees: &f64| {
                plausibility.advance(PERIOD, 1.0);
                plausibility.check(*degrees, f64::NAN)
            };
            Vec::from_iter(samples.iter().map(check))
        };
        assert_eq!(
            watched(Plausible::default(), &[0.0, 5e3, -5e3]),
            [Ok(()); 3]
        );
        let long = Wiring {
            sensor: Measured {
                max: Some(2e3),
                ..Measured::default()
            },
            ..Wiring::default()
        };
        let mut beyond_60_mm = Plausibility::new(&long);
        assert_eq!(beyond_60_mm.check(1.5, f64::NAN), Ok(()));
        assert!(watched(Plausible::default(), &[f64::NAN])[0].is_err());
        let plausible = Plausible {
            min: Some(-62.0),
            max: Some(62.0),
            rate_max: Some(1000.0),
            jump: Some(0.5),
            thrown_seconds: None,
            stall: None,
        };
        assert_eq!(
            watched(plausible, &[61.0, 62.4, 59.6, 58.0]),
            [
                Ok(()),
                Err(Cause::PositionOutsideTravel),
                Ok(()),
                Err(Cause::PositionTooFast)
            ]
        );
    }
}
