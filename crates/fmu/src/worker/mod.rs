//! The worker: a process that alone loads an FMU. A crash, a hang or an exit of the FMU ends the worker, and costs that
//! run.
//!
//! [`serve`] is the worker, [`Remote`] the plant's side. They communicate through a [`Channel`], which the caller
//! makes.

mod protocol;
mod remote;
mod serve;

use std::io;
use std::time::Duration;

pub use remote::{LOAD_PATIENCE, Remote, STEP_PATIENCE};
pub use serve::serve;

/// A channel of whole messages to and from a worker.
pub trait Channel: Send {
    /// Sends a message.
    ///
    /// # Errors
    /// The other end is gone.
    fn send(&mut self, message: &[u8]) -> io::Result<()>;

    /// Waits for a message, at most for `patience`. Returns its length; 0 if the other end is gone.
    ///
    /// # Errors
    /// [`io::ErrorKind::TimedOut`] if no message came, or another one if the channel failed.
    fn receive(&mut self, message: &mut [u8], patience: Option<Duration>) -> io::Result<usize>;

    /// Returns the end of the process at the other end, such as `was ended by signal 11`, and the last part of its
    /// standard error. It is called when the other end is gone or does not answer; it ends the process.
    fn ended(&mut self) -> (String, String);
}

#[cfg(test)]
mod tests;
