//! Stopping a process: by its parent's death, by the end of its standard input, by a signal, by a program.
#![expect(unsafe_code, reason = "signal handlers")]

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rustix::event::{EventfdFlags, PollFlags, eventfd};
use rustix::io::Errno;
use rustix::pipe::{PipeFlags, pipe_with};

use crate::wait::wait_once;

/// Seconds after a signal to stop in which the process must end by itself; then the kernel ends it.
const KILL_AFTER_SECONDS: libc::c_uint = 3;

/// Event that the signal handler raises; -1 before there is one.
static SIGNAL_EVENT: AtomicI32 = AtomicI32::new(-1);
/// Exit code of a program that a signal ends at once.
static AT_ONCE_CODE: AtomicI32 = AtomicI32::new(0);
/// Event that wakes the thread of [`end_at_once_after`]; -1 before there is one.
static AT_ONCE_EVENT: AtomicI32 = AtomicI32::new(-1);

/// Whether this process was asked to end.
static IS_REQUESTED: AtomicBool = AtomicBool::new(false);
/// Longest time for another process to answer once this one was asked to end.
const PATIENCE_AFTER_REQUEST: Duration = Duration::from_millis(500);

/// Signals that a terminal sends to all its processes: Ctrl-C, Ctrl-\, and its end.
pub const OF_TERMINAL: [libc::c_int; 3] = [libc::SIGINT, libc::SIGQUIT, libc::SIGHUP];

/// Signal for a loop to stop.
#[derive(Debug)]
pub struct StopSignal {
    /// Pipe whose end means stop; bytes written to it are ignored.
    pipe: Option<OwnedFd>,
    /// Event that the signal handler raises.
    event: Option<BorrowedFd<'static>>,
}

/// Guard that raises a [`StopSignal`] when dropped.
#[derive(Debug)]
pub struct Stopper {
    _pipe: OwnedFd,
}

impl StopSignal {
    /// Makes the signal of a child of the bench. It is raised by SIGTERM and by the end of the standard input, which also shows
    /// the parent's death. Signals from the bench's terminal ([`OF_TERMINAL`]) reach the children too, which must outlive the
    /// bench for an orderly end, so they are ignored.
    ///
    /// # Errors
    /// If the system refuses the handler.
    pub fn from_parent() -> io::Result<Self> {
        ignore(&OF_TERMINAL)?;
        Ok(Self {
            pipe: Some(io::stdin().as_fd().try_clone_to_owned()?),
            event: Some(signal_event(&[libc::SIGTERM])?),
        })
    }

    /// Makes the signal of a program that is started by hand. It is raised by Ctrl-C and SIGTERM, and when the terminal is closed
    /// or sends SIGQUIT, unless the parent had these two ignored (nohup).
    ///
    /// # Errors
    /// If the system refuses the handler.
    pub fn from_signals() -> io::Result<Self> {
        Ok(Self {
            pipe: None,
            event: Some(signal_event(&Vec::from_iter(heard()))?),
        })
    }

    /// Makes the signal of a loop in a thread; it is raised when the [`Stopper`] is dropped.
    ///
    /// # Errors
    /// If the system refuses the pipe.
    pub fn manual() -> io::Result<(Stopper, Self)> {
        let (reader, stopper) = stop_pipe()?;
        let signal = Self {
            pipe: Some(reader),
            event: None,
        };
        Ok((stopper, signal))
    }

    /// Returns whether it is time to stop. Never waits.
    pub fn is_raised(&self) -> bool {
        let [pipe, event] = self.fds();
        event.is_some_and(is_readable) || pipe.is_some_and(has_ended)
    }

    /// Descriptors that become readable when [`StopSignal::is_raised`] may have changed.
    pub(crate) fn fds(&self) -> [Option<BorrowedFd<'_>>; 2] {
        [self.pipe.as_ref().map(AsFd::as_fd), self.event]
    }
}

/// Notes that this process was asked to end. From now on it waits for no other process for long.
pub fn request() {
    IS_REQUESTED.store(true, Ordering::Relaxed);
}

/// Returns whether this process was asked to end, by [`request`] or by a signal that raises a [`StopSignal`].
pub fn is_requested() -> bool {
    IS_REQUESTED.load(Ordering::Relaxed)
}

/// Returns the time that is left to wait for another process, of this much; without limit if `None`.
pub(crate) fn patience_left(patience: Option<Duration>) -> Option<Duration> {
    if is_requested() {
        let left = patience.unwrap_or(PATIENCE_AFTER_REQUEST);
        return Some(left.min(PATIENCE_AFTER_REQUEST));
    }
    patience
}

/// Thread that works until it is told to end; the drop tells it and waits.
#[derive(Debug)]
pub(crate) struct StoppedThread {
    stopper: Option<Stopper>,
    thread: Option<JoinHandle<()>>,
}

impl StoppedThread {
    /// Starts a thread. `prepare` makes its work, and gets a descriptor that becomes readable when the thread is to end.
    ///
    /// # Errors
    /// If the system refuses.
    pub(crate) fn start<Work: FnOnce() + Send + 'static>(
        name: &str,
        prepare: impl FnOnce(OwnedFd) -> io::Result<Work>,
    ) -> io::Result<Self> {
        let (reader, stopper) = stop_pipe()?;
        let work = prepare(reader)?;
        let thread = thread::Builder::new().name(name.to_owned());
        Ok(Self {
            stopper: Some(stopper),
            thread: Some(thread.spawn(work)?),
        })
    }
}

impl Drop for StoppedThread {
    fn drop(&mut self) {
        self.stopper = None;
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// Makes a pipe that ends when the stopper is dropped.
fn stop_pipe() -> io::Result<(OwnedFd, Stopper)> {
    let (reader, writer) = pipe_with(PipeFlags::CLOEXEC | PipeFlags::NONBLOCK)?;
    Ok((reader, Stopper { _pipe: writer }))
}

fn is_readable(fd: BorrowedFd<'_>) -> bool {
    wait_once(fd, PollFlags::IN, Duration::ZERO).unwrap_or(false)
}

/// Discards the pending bytes; returns whether the pipe has ended.
fn has_ended(fd: BorrowedFd<'_>) -> bool {
    let mut bytes = [0; 256];
    while is_readable(fd) {
        match rustix::io::read(fd, &mut bytes) {
            Ok(0) => return true,
            Ok(_) | Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => return false,
            // After an error no more bytes can come.
            Err(_) => return true,
        }
    }
    false
}

/// Returns the signals that stop a program that is started by hand: those of a terminal and SIGTERM, without those that its
/// parent had ignored (nohup).
pub fn heard() -> impl Iterator<Item = libc::c_int> {
    let may_be_ignored = [libc::SIGHUP, libc::SIGQUIT].into_iter();
    let heard = may_be_ignored.filter(|signal| !is_ignored(*signal));
    [libc::SIGINT, libc::SIGTERM].into_iter().chain(heard)
}

/// Makes the signals that stop a program end this one at once, with an exit code.
///
/// # Errors
/// If the system refuses the handler.
pub fn end_at_once(code: u8) -> io::Result<()> {
    AT_ONCE_CODE.store(code.into(), Ordering::Relaxed);
    heard().try_for_each(|signal| set_handler(signal, at_once()))
}

/// Undoes [`end_at_once`], for a program with an orderly end by its own handlers. Handlers that are set already stay.
///
/// # Errors
/// If the system refuses.
pub fn end_in_order() -> io::Result<()> {
    heard()
        .filter(|signal| has_handler(*signal, at_once()))
        .try_for_each(|signal| set_handler(signal, libc::SIG_DFL))
}

fn at_once() -> libc::sighandler_t {
    let handler: extern "C" fn(libc::c_int) = on_end;
    handler as libc::sighandler_t
}

extern "C" fn on_end(_signal: libc::c_int) {
    let event = AT_ONCE_EVENT.load(Ordering::Relaxed);
    match event {
        // SAFETY: it is async-signal-safe.
        -1 => unsafe { libc::_exit(AT_ONCE_CODE.load(Ordering::Relaxed)) },
        event => raise(event),
    }
}

/// Makes a program that a signal ends at once do something first, in a thread, since a handler may not do much. The action of the
/// first call is used for all.
pub(crate) fn end_at_once_after(act: fn()) {
    static EVENT: OnceLock<Option<OwnedFd>> = OnceLock::new();
    if !heard().any(|signal| has_handler(signal, at_once())) {
        return;
    }
    let event = EVENT.get_or_init(|| {
        let event = eventfd(0, EventfdFlags::CLOEXEC).ok()?;
        let called = event.try_clone().ok()?;
        let wait = move || {
            while rustix::io::read(&called, &mut [0; 8]) == Err(Errno::INTR) {}
            act();
            // SAFETY: it ends the program, as the handler would.
            unsafe { libc::_exit(AT_ONCE_CODE.load(Ordering::Relaxed)) }
        };
        thread::Builder::new().spawn(wait).ok()?;
        Some(event)
    });
    let event = event.as_ref().map_or(-1, AsRawFd::as_raw_fd);
    AT_ONCE_EVENT.store(event, Ordering::Relaxed);
}

/// Ignores these signals from now on.
pub(crate) fn ignore(signals: &[libc::c_int]) -> io::Result<()> {
    signals
        .iter()
        .try_for_each(|signal| set_handler(*signal, libc::SIG_IGN))
}

/// Returns whether this process ignores a signal, as its parent may have arranged (nohup).
fn is_ignored(signal: libc::c_int) -> bool {
    has_handler(signal, libc::SIG_IGN)
}

fn has_handler(signal: libc::c_int, handler: libc::sighandler_t) -> bool {
    // SAFETY: without a new action, sigaction only writes the present one.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &raw mut action) == 0
            && action.sa_sigaction == handler
    }
}

/// Turns a write beyond the permitted size of a file into an error, in place of the signal that ends the process.
///
/// # Errors
/// If the system refuses.
pub fn take_long_files_as_errors() -> io::Result<()> {
    ignore(&[libc::SIGXFSZ])
}

/// Returns an event that `signals` raise.
fn signal_event(signals: &[libc::c_int]) -> io::Result<BorrowedFd<'static>> {
    static EVENT: OnceLock<OwnedFd> = OnceLock::new();
    let fresh = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
    let event = EVENT.get_or_init(|| fresh);
    SIGNAL_EVENT.store(event.as_raw_fd(), Ordering::Relaxed);
    let handler: extern "C" fn(libc::c_int) = on_signal;
    for signal in signals {
        set_handler(*signal, handler as libc::sighandler_t)?;
    }
    Ok(event.as_fd())
}

/// Raises the event, and sets an alarm for a process that no longer looks at it: SIGALRM ends it.
extern "C" fn on_signal(_signal: libc::c_int) {
    request();
    raise(SIGNAL_EVENT.load(Ordering::Relaxed));
}

fn raise(event: libc::c_int) {
    // SAFETY: errno is this thread's; write and alarm are async-signal-safe; the event is never closed, and before there
    // is one the write fails harmlessly.
    unsafe {
        let errno = *libc::__errno_location();
        let one = 1_u64;
        libc::write(event, (&raw const one).cast(), size_of::<u64>());
        libc::alarm(KILL_AFTER_SECONDS);
        *libc::__errno_location() = errno;
    }
}

fn set_handler(signal: libc::c_int, handler: libc::sighandler_t) -> io::Result<()> {
    // SAFETY: a sigaction of zeros has no flags and an empty mask; the handler is async-signal-safe or SIG_IGN.
    let result = unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = handler;
        action.sa_flags = libc::SA_RESTART;
        libc::sigaction(signal, &raw const action, std::ptr::null_mut())
    };
    if result == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropping_the_stopper_raises_the_signal() {
        let (stopper, signal) = StopSignal::manual().unwrap();
        assert!(!signal.is_raised());
        drop(stopper);
        assert!(signal.is_raised());
    }

    #[test]
    fn who_started_the_program_decides_whether_a_signal_is_ignored() {
        // The test runner leaves this signal at its default.
        assert!(!is_ignored(libc::SIGWINCH));
        ignore(&[libc::SIGWINCH]).unwrap();
        assert!(is_ignored(libc::SIGWINCH));
    }

    #[test]
    fn what_is_written_is_not_the_end() {
        let (stopper, signal) = StopSignal::manual().unwrap();
        rustix::io::write(&stopper._pipe, &[0; 1000]).unwrap();
        assert!(!signal.is_raised());
        drop(stopper);
        assert!(signal.is_raised());
    }
}
