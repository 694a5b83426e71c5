//! The monotonic clock, and its relation to the wall clock.

use std::time::Duration;

use rustix::thread::{NanosleepRelativeResult, nanosleep};
use rustix::time::{ClockId, Timespec, clock_gettime};

/// Less than this is no step: the clocks drift, and the process may be held up between reading one and the other.
const WALL_STEP_MIN: Duration = Duration::from_millis(10);

/// Time since the clock was started, from `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Duration,
    wall_at_start: Duration,
}

impl Clock {
    /// A clock that begins now.
    #[must_use]
    pub fn start() -> Self {
        Self {
            start: monotonic(),
            wall_at_start: wall(),
        }
    }

    /// Time since the start; never decreases.
    #[must_use]
    pub fn now(&self) -> Duration {
        monotonic().saturating_sub(self.start)
    }

    /// The wall-clock time of the start, since 1970.
    #[must_use]
    pub fn wall_epoch(&self) -> Duration {
        self.wall_at_start
    }

    /// A wall-clock time on this clock, as if the wall clock had not been stepped since the start.
    #[must_use]
    pub fn from_wall(&self, wall: Duration) -> Duration {
        wall.saturating_sub(self.wall_at_start)
    }

    /// Where the wall clock was stepped, later wall-clock times go on from here as if it had always been as it is now.
    pub(crate) fn follow_wall_steps(&mut self) {
        let (now, wall) = (self.now(), wall());
        if wall.abs_diff(self.wall_at_start + now) > WALL_STEP_MIN {
            self.wall_at_start = wall.saturating_sub(now);
        }
    }

    /// By how much the wall clock went away from the monotonic clock since the start: more than a few milliseconds mean
    /// that it was stepped, and wall-clock receive stamps are not to be trusted.
    #[must_use]
    pub fn wall_clock_step(&self) -> Duration {
        let expected = self.wall_at_start + self.now();
        wall().abs_diff(expected)
    }

    /// A time of the system's monotonic clock on this clock; zero before its start.
    #[must_use]
    pub fn from_monotonic(&self, time: Duration) -> Duration {
        time.saturating_sub(self.start)
    }

    /// This clock's `time` on `CLOCK_MONOTONIC`, for absolute timers.
    pub(crate) fn on_monotonic(&self, time: Duration) -> Duration {
        self.start.saturating_add(time)
    }
}

/// `CLOCK_MONOTONIC` itself. Where reading it is a system call, as in user-mode Linux, it costs as much as a frame.
pub(crate) fn monotonic() -> Duration {
    duration(clock_gettime(ClockId::Monotonic))
}

fn wall() -> Duration {
    duration(clock_gettime(ClockId::Realtime))
}

/// A time of the system that is not negative.
fn duration(time: Timespec) -> Duration {
    Duration::try_from(time).unwrap_or_default()
}

/// Waits; longer when the system is busy, not shorter.
pub fn sleep(time: Duration) {
    let Ok(mut remaining) = Timespec::try_from(time) else {
        return;
    };
    while let NanosleepRelativeResult::Interrupted(rest) = nanosleep(&remaining) {
        remaining = rest;
    }
}
