//! Waiting for descriptors.

use std::os::fd::BorrowedFd;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use crate::{clock, stop};

/// Period of the check whether this process was asked to end.
const LOOK: Duration = Duration::from_millis(100);

/// Waits until `fd` is ready or `timeout` is over; returns whether it is ready. An interrupted wait is resumed.
pub(crate) fn wait_ready(
    fd: BorrowedFd<'_>,
    flags: PollFlags,
    timeout: Duration,
) -> Result<bool, Errno> {
    let end = clock::monotonic().saturating_add(timeout);
    let mut patience = timeout;
    loop {
        if wait_once(fd, flags, patience)? {
            return Ok(true);
        }
        patience = end.saturating_sub(clock::monotonic());
        if patience.is_zero() {
            return Ok(false);
        }
    }
}

/// Waits for another process: as [`wait_ready`], but not for long once this process was asked to end.
pub(crate) fn wait_for_process(
    fd: BorrowedFd<'_>,
    flags: PollFlags,
    patience: Duration,
) -> Result<bool, Errno> {
    let end = clock::monotonic().saturating_add(patience);
    let mut end_of_request = None;
    loop {
        let now = clock::monotonic();
        let mut left = end.saturating_sub(now);
        if let Some(patience) = stop::patience_left(None) {
            let end = *end_of_request.get_or_insert(now + patience);
            left = left.min(end.saturating_sub(now));
        }
        if wait_once(fd, flags, left.min(LOOK))? {
            return Ok(true);
        }
        if left.is_zero() {
            return Ok(false);
        }
    }
}

/// Waits until `fd` is ready, `timeout` is over or a signal comes; returns whether `fd` is ready.
pub(crate) fn wait_once(
    fd: BorrowedFd<'_>,
    flags: PollFlags,
    timeout: Duration,
) -> Result<bool, Errno> {
    let timeout = Timespec::try_from(timeout).map_err(|_| Errno::INVAL)?;
    match poll(&mut [PollFd::from_borrowed_fd(fd, flags)], Some(&timeout)) {
        Ok(count) => Ok(count > 0),
        Err(Errno::INTR) => Ok(false),
        Err(errno) => Err(errno),
    }
}

/// Waits until one of these descriptors is readable or has ended, `timeout` is over or a signal comes; without a `timeout`, for
/// ever. Returns which of them are readable or have ended.
pub(crate) fn wait_for_any<const COUNT: usize>(
    fds: [Option<BorrowedFd<'_>>; COUNT],
    timeout: Option<Duration>,
) -> Result<[bool; COUNT], Errno> {
    let timeout = timeout.map(Timespec::try_from).transpose();
    let timeout = timeout.map_err(|_| Errno::INVAL)?;
    // One that is watched anyway takes the place of a missing one.
    let watched = fds.into_iter().flatten().next().ok_or(Errno::INVAL)?;
    let watch = |fd: Option<_>| PollFd::from_borrowed_fd(fd.unwrap_or(watched), PollFlags::IN);
    let mut polled = fds.map(watch);
    match poll(&mut polled, timeout.as_ref()) {
        Ok(_) | Err(Errno::INTR) => {}
        Err(errno) => return Err(errno),
    }
    Ok(std::array::from_fn(|place| {
        fds[place].is_some() && !polled[place].revents().is_empty()
    }))
}
