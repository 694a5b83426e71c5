//! Interpolation between the targets of cyclic synchronous position.
//!
//! In: the targets as they take effect, and the interpolation time (0x60C2). Out: position and velocity at any time. The cascade
//! in [`super::motion`] calls it once a step; where a target is missing it goes on at the same speed for a while.

use std::time::Duration;

use super::demand::Demand;

/// Interpolation times without a target for which the motion goes on at the last speed; then the drive stops by a ramp.
const EXTRAPOLATED_MAX: f64 = 3.0;

/// The latest target, and the way to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interpolation {
    from: f64,
    to: f64,
    begun: Duration,
    period_seconds: f64,
}

impl Interpolation {
    /// Begins at a target that stands.
    pub(super) fn at_rest(target: f64, now: Duration) -> Self {
        Self {
            from: target,
            to: target,
            begun: now,
            period_seconds: 1.0,
        }
    }

    /// Takes a target over: it is to be reached after the interpolation time. After a stop the way begins at `present`.
    pub(super) fn receive(
        &mut self,
        target: f64,
        present: f64,
        now: Duration,
        period_seconds: f64,
    ) {
        *self = Self {
            from: self.at(now).map_or(present, |demand| demand.position),
            to: target,
            begun: now,
            period_seconds,
        };
    }

    /// Returns the position at a time; `None` if no target has come for too long.
    pub(super) fn at(&self, time: Duration) -> Option<Demand> {
        let way = self.to - self.from;
        let elapsed = time.saturating_sub(self.begun).as_secs_f64() / self.period_seconds;
        if way != 0.0 && elapsed > 1.0 + EXTRAPOLATED_MAX {
            return None;
        }
        Some(Demand {
            position: self.from + way * elapsed,
            velocity: way / self.period_seconds,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn milliseconds(number: u64) -> Duration {
        Duration::from_millis(number)
    }

    #[test]
    fn a_target_is_reached_linearly_after_the_interpolation_time() {
        let mut way = Interpolation::at_rest(100.0, Duration::ZERO);
        way.receive(140.0, 0.0, milliseconds(8), 4e-3);
        for (time, position) in [(8, 100.0), (9, 110.0), (10, 120.0), (12, 140.0)] {
            let demand = way.at(milliseconds(time)).unwrap();
            assert!((demand.position - position).abs() < 1e-9, "{time} ms");
            assert_eq!(demand.velocity, 10_000.0);
        }
        way.receive(140.0, 0.0, milliseconds(12), 4e-3);
        let demand = way.at(milliseconds(500)).unwrap();
        assert_eq!((demand.position, demand.velocity), (140.0, 0.0));
    }

    #[test]
    fn a_missing_target_is_extrapolated_for_three_periods() {
        let mut way = Interpolation::at_rest(0.0, Duration::ZERO);
        way.receive(10.0, 0.0, Duration::ZERO, 1e-3);
        assert_eq!(way.at(milliseconds(3)).unwrap().position, 30.0);
        assert!(way.at(milliseconds(5)).is_none());
        way.receive(50.0, 35.0, milliseconds(5), 1e-3);
        assert_eq!(way.at(milliseconds(5)).unwrap().position, 35.0);
        assert_eq!(way.at(milliseconds(6)).unwrap().position, 50.0);
    }
}
