//! The worker: a process that alone loads an FMU. A crash, a hang or an exit of the FMU ends the worker, and costs that run.
//!
//! [`serve`] is the worker, [`Remote`] the plant's side. Both speak through a [`Channel`], which somebody else made.

mod protocol;
mod remote;
mod serve;

use std::io;
use std::time::Duration;

pub use remote::{LOAD_PATIENCE, Remote, STEP_PATIENCE};
pub use serve::serve;

/// Messages to and from a worker, each whole.
pub trait Channel: Send {
    /// Sends a message.
    ///
    /// # Errors
    /// The other end is gone.
    fn send(&mut self, message: &[u8]) -> io::Result<()>;

    /// Waits for a message, no longer than `patience`; its length, 0 where the other end is gone.
    ///
    /// # Errors
    /// [`io::ErrorKind::TimedOut`] where none came, or the channel failed.
    fn receive(&mut self, message: &mut [u8], patience: Option<Duration>) -> io::Result<usize>;

    /// How the process at the other end ended, such as `was ended by signal 11`, and the end of what it wrote on its standard
    /// error. It is asked when the other end is gone, or does not answer; then the process is ended.
    fn ended(&mut self) -> (String, String);
}

#[cfg(test)]
mod tests;
