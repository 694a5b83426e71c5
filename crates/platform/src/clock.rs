//! The monotonic clock, and its relation to the wall clock.

use std::time::Duration;

use rustix::thread::{NanosleepRelativeResult, nanosleep};
use rustix::time::{ClockId, Timespec, clock_gettime};

/// Smallest difference that counts as a step: the clocks drift, and the process may be held up between reading the two.
const WALL_STEP_MIN: Duration = Duration::from_millis(10);

/// Time since the clock was started, from `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Duration,
    wall_at_start: Duration,
}

impl Clock {
    /// Starts a clock.
    pub fn start() -> Self {
        Self {
            start: monotonic(),
            wall_at_start: wall(),
        }
    }

    /// Returns the time since the start; it never decreases.
    pub fn now(&self) -> Duration {
        monotonic().saturating_sub(self.start)
    }

    /// Returns the wall-clock time of the start, since 1970.
    pub fn wall_epoch(&self) -> Duration {
        self.wall_at_start
    }

    /// Converts a wall-clock time to this clock, as if the wall clock had not been stepped since the start.
    pub fn from_wall(&self, wall: Duration) -> Duration {
        wall.saturating_sub(self.wall_at_start)
    }

    /// After a step of the wall clock, maps later wall-clock times to this clock as if the wall clock had always been as it is
    /// now.
    pub(crate) fn follow_wall_steps(&mut self) {
        let (now, wall) = (self.now(), wall());
        if wall.abs_diff(self.wall_at_start + now) > WALL_STEP_MIN {
            self.wall_at_start = wall.saturating_sub(now);
        }
    }

    /// Returns the clock as it was if the wall clock has been set ahead since.
    #[cfg(test)]
    pub(crate) fn before_step(self, ahead: Duration) -> Self {
        Self {
            wall_at_start: self.wall_at_start - ahead,
            ..self
        }
    }

    /// Returns the difference that the wall clock has gained on the monotonic clock since the start, without its sign. More than
    /// a few milliseconds mean that it was stepped, and wall-clock receive stamps are not to be trusted.
    pub fn wall_clock_step(&self) -> Duration {
        let expected = self.wall_at_start + self.now();
        wall().abs_diff(expected)
    }

    /// Converts a time of the system's monotonic clock to this clock; zero before its start.
    pub fn from_monotonic(&self, time: Duration) -> Duration {
        time.saturating_sub(self.start)
    }

    /// Converts this clock's `time` to `CLOCK_MONOTONIC`, for absolute timers.
    pub(crate) fn on_monotonic(&self, time: Duration) -> Duration {
        self.start.saturating_add(time)
    }
}

/// Converts a time, which fits: 64 bits are 584 years.
pub(crate) fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Reads `CLOCK_MONOTONIC`. Where that is a system call, as in user-mode Linux, it costs as much as a frame.
pub(crate) fn monotonic() -> Duration {
    duration(clock_gettime(ClockId::Monotonic))
}

fn wall() -> Duration {
    duration(clock_gettime(ClockId::Realtime))
}

/// Converts a time of the system; a negative one becomes zero.
fn duration(time: Timespec) -> Duration {
    Duration::try_from(time).unwrap_or_default()
}

/// Sleeps for `time`; longer when the system is busy, never shorter.
pub fn sleep(time: Duration) {
    let Ok(mut remaining) = Timespec::try_from(time) else {
        return;
    };
    while let NanosleepRelativeResult::Interrupted(rest) = nanosleep(&remaining) {
        remaining = rest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_of_the_wall_clock_is_seen_and_followed() {
        let hour = Duration::from_secs(3600);
        let mut clock = Clock::start().before_step(hour);
        assert!(clock.wall_clock_step() > hour / 2);
        clock.follow_wall_steps();
        assert!(clock.wall_clock_step() < hour / 2);
    }
}
