//! The clock of the position and velocity loops.
//!
//! In: the times of SYNCs and of the steps that were taken. Out: the time of the next step. The drive asks it for its
//! deadline, so that the loops go on without SYNC.

use std::time::Duration;

/// The drive's own clock of the loops, in phase with SYNC while it comes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LoopClock {
    /// Next step; `None` if none is due, as in the modes of torque.
    pub(super) next: Option<Duration>,
    synced: Option<Duration>,
    /// Steps of the own clock before the next SYNC is expected.
    steps_to_sync: u32,
}

impl LoopClock {
    /// Plans the step after one at a SYNC.
    pub(super) fn on_sync(&mut self, now: Duration, period: Duration) {
        let since = self.synced.map(|before| now.saturating_sub(before));
        let steps = since.map_or(1.0, |since| {
            (since.as_secs_f64() / period.as_secs_f64()).round()
        });
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the cast saturates"
        )]
        let steps = steps as u32;
        self.synced = Some(now);
        self.steps_to_sync = steps.saturating_sub(1);
        self.plan(now, period, self.steps_to_sync == 0);
    }

    /// Plans the step after one by the own clock.
    pub(super) fn on_step(&mut self, now: Duration, period: Duration) {
        let is_last = self.steps_to_sync == 1;
        self.steps_to_sync = self.steps_to_sync.saturating_sub(1);
        self.plan(now, period, is_last);
    }

    /// A step that coincides with an expected SYNC leaves it half a period of time to come.
    fn plan(&mut self, now: Duration, period: Duration, is_sync_expected: bool) {
        let pause = if is_sync_expected {
            period * 3 / 2
        } else {
            period
        };
        self.next = Some(now + pause);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(1);

    #[test]
    fn steps_fill_the_time_between_syncs_and_leave_the_syncs_room() {
        let mut clock = LoopClock::default();
        let at = |microseconds| Some(Duration::from_micros(microseconds));
        clock.on_sync(Duration::ZERO, PERIOD);
        assert_eq!(clock.next, at(1500));
        clock.on_sync(PERIOD * 3, PERIOD);
        assert_eq!(clock.next, at(4000));
        clock.on_step(PERIOD * 4, PERIOD);
        assert_eq!(clock.next, at(5000));
        clock.on_step(PERIOD * 5, PERIOD);
        assert_eq!(clock.next, at(6500), "a SYNC is expected at 6 ms");
        clock.on_step(Duration::from_micros(6500), PERIOD);
        assert_eq!(clock.next, at(7500), "no SYNC came");
    }
}
