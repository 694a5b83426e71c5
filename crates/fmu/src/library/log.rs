//! Messages of an FMU, kept for the report of its failure.

use std::ffi::{CStr, c_char};
use std::sync::{Mutex, PoisonError};

/// Number of messages that are kept, the latest ones.
const MESSAGES_MAX: usize = 4;
/// Largest length of a message.
const CHARACTERS_MAX: usize = 400;

/// The last messages of an instance.
#[derive(Default)]
pub(super) struct Log(Mutex<Vec<String>>);

impl Log {
    /// Keeps a message.
    ///
    /// # Safety
    /// `message` is null or a C string.
    pub(super) unsafe fn keep(&self, message: *const c_char) {
        if message.is_null() {
            return;
        }
        // SAFETY: a C string, by the caller.
        let message = unsafe { CStr::from_ptr(message) };
        let message = message.to_string_lossy();
        let message = String::from_iter(message.trim().chars().take(CHARACTERS_MAX));
        let mut messages = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if messages.len() == MESSAGES_MAX {
            messages.remove(0);
        }
        messages.push(message);
    }

    /// Takes the messages.
    pub(super) fn take(&self) -> String {
        let messages = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        messages.join("; ")
    }
}
