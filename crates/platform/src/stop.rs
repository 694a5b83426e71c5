//! How a process is stopped: by its parent's death, by the end of its standard input, by a signal, by a program.
#![expect(unsafe_code, reason = "signal handlers")]

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicI32, Ordering};
use std::thread;

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::Errno;
use rustix::pipe::{PipeFlags, pipe_with};

/// After a signal to stop, the kernel ends the process when it has not ended by itself for so long.
const KILL_AFTER_SECONDS: libc::c_uint = 3;

/// The event that the signal handler raises; -1 before there is one.
static SIGNAL_EVENT: AtomicI32 = AtomicI32::new(-1);
/// The exit code of a program that a signal ends at once.
static AT_ONCE_CODE: AtomicI32 = AtomicI32::new(0);
/// What calls the thread that does something before that end; -1 where nothing is to be done.
static AT_ONCE_EVENT: AtomicI32 = AtomicI32::new(-1);

/// What a terminal sends to all processes in it: Ctrl-C, Ctrl-\, and its end.
pub const OF_TERMINAL: [libc::c_int; 3] = [libc::SIGINT, libc::SIGQUIT, libc::SIGHUP];

/// Says to a loop that it is to stop.
#[derive(Debug)]
pub struct StopSignal {
    /// Its end means stop; what is written to it means nothing.
    pipe: Option<Pipe>,
    /// Raised by the signal handler.
    event: Option<BorrowedFd<'static>>,
}

#[derive(Debug)]
enum Pipe {
    Stdin,
    Owned(OwnedFd),
}

/// Raises a [`StopSignal`] when dropped.
#[derive(Debug)]
pub struct Stopper {
    _pipe: OwnedFd,
}

impl StopSignal {
    /// For a child of the bench: stops when the standard input ends, which is also how the parent's death shows, and at
    /// SIGTERM. What ends the bench from its terminal reaches the children too, who must outlive it for an orderly end:
    /// [`OF_TERMINAL`] are ignored.
    ///
    /// # Errors
    /// When the system refuses the handler.
    pub fn from_parent() -> io::Result<Self> {
        ignore(&OF_TERMINAL)?;
        Ok(Self {
            pipe: Some(Pipe::Stdin),
            event: Some(signal_event(&[libc::SIGTERM])?),
        })
    }

    /// For a program that is started by hand: stops at Ctrl-C, SIGTERM, and when its terminal is closed or sends SIGQUIT,
    /// unless whoever started it has these two ignored (nohup).
    ///
    /// # Errors
    /// When the system refuses the handler.
    pub fn from_signals() -> io::Result<Self> {
        Ok(Self {
            pipe: None,
            event: Some(signal_event(&Vec::from_iter(heard()))?),
        })
    }

    /// For a loop in a thread: stops when the [`Stopper`] is dropped.
    ///
    /// # Errors
    /// When the system refuses the pipe.
    pub fn manual() -> io::Result<(Stopper, Self)> {
        let (reader, writer) = pipe_with(PipeFlags::CLOEXEC | PipeFlags::NONBLOCK)?;
        let signal = Self {
            pipe: Some(Pipe::Owned(reader)),
            event: None,
        };
        Ok((Stopper { _pipe: writer }, signal))
    }

    /// True when it is time to stop. Never waits.
    #[must_use]
    pub fn is_raised(&self) -> bool {
        self.event.is_some_and(is_readable) || self.pipe_fd().is_some_and(has_ended)
    }

    /// What becomes readable when [`StopSignal::is_raised`] may have changed.
    pub(crate) fn fds(&self) -> [Option<BorrowedFd<'_>>; 2] {
        [self.pipe_fd(), self.event]
    }

    fn pipe_fd(&self) -> Option<BorrowedFd<'_>> {
        self.pipe.as_ref().map(|pipe| match pipe {
            Pipe::Stdin => rustix::stdio::stdin(),
            Pipe::Owned(fd) => fd.as_fd(),
        })
    }
}

fn is_readable(fd: BorrowedFd<'_>) -> bool {
    let now = Timespec::default();
    poll(
        &mut [PollFd::from_borrowed_fd(fd, PollFlags::IN)],
        Some(&now),
    )
    .is_ok_and(|ready| ready > 0)
}

/// Reads away what is there; true at the end.
fn has_ended(fd: BorrowedFd<'_>) -> bool {
    let mut bytes = [0; 256];
    while is_readable(fd) {
        match rustix::io::read(fd, &mut bytes) {
            Ok(0) => return true,
            Ok(_) | Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => return false,
            // Nobody can send us anything any more.
            Err(_) => return true,
        }
    }
    false
}

/// Which signals are to stop a program that is started by hand: those of a terminal and SIGTERM, but not what whoever started it
/// has ignored (nohup).
fn heard() -> impl Iterator<Item = libc::c_int> {
    let may_be_ignored = [libc::SIGHUP, libc::SIGQUIT].into_iter();
    let heard = may_be_ignored.filter(|signal| !is_ignored(*signal));
    [libc::SIGINT, libc::SIGTERM].into_iter().chain(heard)
}

/// From now on the signals that stop a program end this one at once, with an exit code.
///
/// # Errors
/// When the system refuses the handler.
pub fn end_at_once(code: u8) -> io::Result<()> {
    AT_ONCE_CODE.store(code.into(), Ordering::Relaxed);
    heard().try_for_each(|signal| set_handler(signal, at_once()))
}

/// Takes [`end_at_once`] back, for who ends in order by handlers of their own; where these are there already, they stay.
///
/// # Errors
/// When the system refuses.
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

/// From now on a program that a signal ends at once does something first, in a thread: a handler may not do much. What it does is
/// always the same.
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

/// Takes [`end_at_once_after`] back.
pub(crate) fn end_at_once_after_nothing() {
    AT_ONCE_EVENT.store(-1, Ordering::Relaxed);
}

/// From now on these signals do nothing.
pub(crate) fn ignore(signals: &[libc::c_int]) -> io::Result<()> {
    signals
        .iter()
        .try_for_each(|signal| set_handler(*signal, libc::SIG_IGN))
}

/// Whether a signal does nothing to this process, as whoever started it wanted (nohup).
#[must_use]
pub fn is_ignored(signal: libc::c_int) -> bool {
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

/// Makes a file that grows beyond what this process may write an error, in place of the signal that ends it.
///
/// # Errors
/// When the system refuses.
pub fn take_long_files_as_errors() -> io::Result<()> {
    ignore(&[libc::SIGXFSZ])
}

/// Turns `signals` into an event.
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

/// Raises the event, and arms the kernel against a process that no longer looks at it: SIGALRM ends it.
extern "C" fn on_signal(_signal: libc::c_int) {
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
        // The test runner leaves it as it is.
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
