//! Timer for absolute deadlines.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::time::Duration;

use rustix::io::Errno;
use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, timerfd_create,
    timerfd_settime,
};

use crate::clock::Clock;

/// Timer that becomes readable at a deadline on `CLOCK_MONOTONIC`. Unlike a wait with a time-out it does not lose the time
/// between reading the clock and waiting, and the kernel adds no slack to it.
pub(super) struct Timer {
    clock: Clock,
    timer: OwnedFd,
    set_to: Option<Duration>,
}

impl Timer {
    pub(super) fn new(clock: Clock) -> Result<Self, Errno> {
        let flags = TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK;
        Ok(Self {
            clock,
            timer: timerfd_create(TimerfdClockId::Monotonic, flags)?,
            set_to: None,
        })
    }

    /// Sets the deadline. The timer is readable at once if the deadline has passed, and never if there is none. Another deadline
    /// also clears the readiness of the last one.
    pub(super) fn set(&mut self, deadline: Option<Duration>) -> Result<(), Errno> {
        if self.set_to == deadline {
            return Ok(());
        }
        // All zeros disarm; no absolute time of this clock is zero.
        let value = deadline.map_or(Ok(Timespec::default()), |deadline| {
            Timespec::try_from(self.clock.on_monotonic(deadline)).map_err(|_| Errno::INVAL)
        })?;
        let once = Itimerspec {
            it_interval: Timespec::default(),
            it_value: value,
        };
        timerfd_settime(&self.timer, TimerfdTimerFlags::ABSTIME, &once)?;
        self.set_to = deadline;
        Ok(())
    }

    pub(super) fn as_fd(&self) -> BorrowedFd<'_> {
        self.timer.as_fd()
    }
}
