//! Real-time scheduling and locked memory: requests, and for each refusal one line that says how to permit it.
#![expect(
    unsafe_code,
    reason = "sched_setscheduler has no safe wrapper in our dependencies"
)]

use std::hint::black_box;
use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};

/// Priority of a node's loop.
pub const NODE_PRIORITY: u8 = 50;
/// Priority of a worker whose node waits for it: below all nodes, so that a worker that hangs holds up only its own node.
pub(crate) const WORKER_PRIORITY: u8 = NODE_PRIORITY - 1;

/// Niceness of a background thread.
const NICENESS: i32 = 10;

/// Bytes of the stack that are touched before it is locked; the loops need a fraction of it.
const STACK_BYTES: usize = 128 * 1024;

/// Requests a real-time priority (1 to 99) for this thread. Threads and processes that it starts do not inherit it.
///
/// # Errors
/// If it is not permitted. A loop runs without it, its deadlines at the mercy of the machine's load.
pub fn request_fifo(priority: u8) -> Result<(), String> {
    set_fifo(priority).map_err(|source| {
        format!(
            "real-time priority {priority} (SCHED_FIFO) was refused: {source}; permit it to this shell with: sudo prlimit --pid $$ --rtprio=99"
        )
    })
}

fn set_fifo(priority: u8) -> io::Result<()> {
    let parameter = libc::sched_param {
        sched_priority: priority.into(),
    };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: the call only reads the parameter; 0 is the calling thread.
    match unsafe { libc::sched_setscheduler(0, policy, &raw const parameter) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

/// Makes the process of a command request the priority of a worker before it begins, if this thread has a real-time priority. If
/// refused, it runs without.
pub(crate) fn pass_on_fifo(command: &mut Command) {
    // SAFETY: the call takes a number only; 0 is the calling thread.
    let policy = unsafe { libc::sched_getscheduler(0) };
    if policy < 0 || policy & !libc::SCHED_RESET_ON_FORK != libc::SCHED_FIFO {
        return;
    }
    let ask = || {
        let _ = set_fifo(WORKER_PRIORITY);
        Ok(())
    };
    // SAFETY: the closure makes one system call and does not allocate.
    unsafe { command.pre_exec(ask) };
}

/// Locks the memory that the process has now, each page from its first use on.
///
/// The loops do not allocate later, and locking future memory too would make allocations of other threads fail at the limit.
/// Pages that are never used, most of a large program, are not loaded.
///
/// # Errors
/// If it is not permitted.
pub fn lock_memory() -> Result<(), String> {
    touch_stack();
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::ONFAULT).map_err(|source| {
        format!(
            "locking memory was refused: {source}; permit it to this shell with: sudo prlimit --pid $$ --memlock=unlimited"
        )
    })
}

/// Lowers the priority of this thread, and of its future children, below all others, unless the system refuses.
pub fn step_back() {
    let _ = rustix::process::nice(NICENESS);
}

/// Guard that keeps this thread, and the processes that it starts meanwhile, on the present processor until dropped, unless the
/// system refuses. Threads that only take turns lose no time by it: waking a process on another processor costs more than most
/// turns.
#[derive(Debug)]
pub struct OneProcessor {
    before: Option<CpuSet>,
}

impl OneProcessor {
    /// Pins this thread from now on.
    pub fn stay() -> Self {
        let before = sched_getaffinity(None).ok();
        let mut here = CpuSet::new();
        let processor = sched_getcpu();
        if before.is_some() && processor < CpuSet::MAX_CPU {
            here.set(processor);
            let _ = sched_setaffinity(None, &here);
        }
        Self { before }
    }
}

impl Drop for OneProcessor {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _ = sched_setaffinity(None, before);
        }
    }
}

/// Makes the kernel map the stack that the loop will use, so that it can be locked.
#[inline(never)]
fn touch_stack() {
    black_box([0_u8; STACK_BYTES]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_processor_is_given_back() {
        let before = sched_getaffinity(None).unwrap();
        {
            let _here = OneProcessor::stay();
            assert_eq!(sched_getaffinity(None).unwrap().count(), 1);
        }
        assert_eq!(sched_getaffinity(None).unwrap(), before);
    }

    #[test]
    fn a_refusal_is_one_line_that_says_how_to_permit_it() {
        // Priority 0 is refused to everyone.
        let refused = request_fifo(0).unwrap_err().to_string();
        assert!(refused.contains("prlimit"), "{refused}");
        assert_eq!(refused.lines().count(), 1);
    }
}
