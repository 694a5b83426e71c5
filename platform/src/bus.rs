//! The seam to a CAN bus.

use std::io;
use std::os::fd::BorrowedFd;
use std::time::Duration;

use canopen::CanFrame;

/// A CAN bus as one participant sees it. Its own frames do not come back.
pub trait Bus: Send {
    /// Sends a frame. Waits a bounded time where the bus's queue is full.
    ///
    /// # Errors
    /// When the queue stays full or the bus is gone.
    fn send(&mut self, frame: &CanFrame) -> Result<(), BusError>;

    /// The next frame that passes the filters, oldest first; `None` when none came within `timeout`. With a `timeout`
    /// of zero it never waits. The kernel's error messages come as frames with [`CanFrame::is_error`].
    ///
    /// # Errors
    /// When the bus is gone.
    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>, BusError>;

    /// Becomes readable when a frame is there.
    fn as_fd(&self) -> BorrowedFd<'_>;

    /// Frames that were lost because they were not received in time, as far as known.
    fn dropped(&self) -> u64;
}

/// What is wrong with a bus.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The system's error, where nothing better is known.
    #[error("the bus failed to {action}: {source}")]
    System {
        /// What was tried.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
}
