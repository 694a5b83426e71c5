//! Child processes of the bench, and the descriptors that they inherit.
#![expect(unsafe_code, reason = "what happens between fork and exec")]

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

use rustix::io::{Errno, FdFlags, fcntl_setfd};
use rustix::net::SocketType;
use rustix::net::sockopt::socket_type;
use rustix::process::{
    Pid, Resource, Signal, getpid, getppid, getrlimit, kill_process,
    set_parent_process_death_signal, setsid,
};

use crate::stop::OF_TERMINAL;

/// Returns a command that starts this program again, as a child that does not outlive us:
/// - its standard input is a pipe from us, or a channel that the caller puts in its place; the end of either stops it
///   ([`crate::stop::StopSignal::from_parent`]);
/// - the signals of its terminal ([`OF_TERMINAL`]) do not end it; that is our task;
/// - SIGTERM comes when the *thread* that spawned it ends (`PR_SET_PDEATHSIG`), so spawn from a thread that lives as
///   long as the run. It arms an alarm that ends even a child that hangs.
///
/// # Errors
/// Never on a system with `/proc`.
pub fn myself() -> io::Result<Command> {
    // The running file itself, even if another was put in its place meanwhile.
    let mut command = Command::new("/proc/self/exe");
    if let Some(name) = std::env::args_os().next() {
        command.arg0(name);
    }
    command.stdin(Stdio::piped());
    let parent = getpid();
    let prepare = move || {
        set_parent_process_death_signal(Some(Signal::TERM))?;
        if getppid() != Some(parent) {
            return Err(Errno::SRCH.into());
        }
        for signal in OF_TERMINAL {
            // SAFETY: signal is async-signal-safe, and ignoring is inherited by the program that exec starts.
            unsafe { libc::signal(signal, libc::SIG_IGN) };
        }
        Ok(())
    };
    // SAFETY: the closure makes system calls only and does not allocate.
    unsafe { command.pre_exec(prepare) };
    Ok(command)
}

/// Returns whether a process of this machine runs; one that has ended and that its parent has not
/// asked for yet does not.
pub fn is_running(process: u32) -> bool {
    let Ok(stat) = std::fs::read_to_string(format!("/proc/{process}/stat")) else {
        return false;
    };
    // The name of the program, in parentheses, may contain anything.
    let state = stat.rsplit_once(") ").map(|(_, rest)| rest);
    state.is_some_and(|state| !state.starts_with(['Z', 'X']))
}

/// Gives the process of a command a session and a group of its own, out of reach of any terminal, and restores the default
/// actions of signals. The process is killed when the thread that spawned it ends.
pub(crate) fn in_new_session(command: &mut Command) {
    let prepare = move || {
        setsid()?;
        set_parent_process_death_signal(Some(Signal::KILL))?;
        for signal in OF_TERMINAL.into_iter().chain([libc::SIGTERM]) {
            // SAFETY: signal is async-signal-safe.
            unsafe { libc::signal(signal, libc::SIG_DFL) };
        }
        Ok(())
    };
    // SAFETY: the closure makes system calls only and does not allocate.
    unsafe { command.pre_exec(prepare) };
}

/// Checks that this process may open as many files as it needs.
///
/// # Errors
/// If fewer are permitted.
pub fn require_open_files(needed: u64) -> Result<(), String> {
    match getrlimit(Resource::Nofile).current {
        Some(permitted) if permitted < needed => Err(format!(
            "only {permitted} files may be open at once, and {needed} are needed; permit them with: ulimit -n {needed}"
        )),
        _ => Ok(()),
    }
}

/// Makes the child inherit `descriptor`; returns the number to pass to the child. The descriptor is closed here when `command` is
/// dropped.
pub(crate) fn inherit(command: &mut Command, descriptor: OwnedFd) -> RawFd {
    let number = descriptor.as_raw_fd();
    let prepare = move || Ok(fcntl_setfd(descriptor.as_fd(), FdFlags::empty())?);
    // SAFETY: the closure makes one system call and does not allocate.
    unsafe { command.pre_exec(prepare) };
    number
}

/// Stops a child where it is (SIGSTOP), or resumes it (SIGCONT).
///
/// # Errors
/// If the child does not exist any more.
pub fn suspend(number: u32, is_suspended: bool) -> io::Result<()> {
    signal(number, suspension(is_suspended))
}

/// Sends SIGTERM to a process.
///
/// # Errors
/// If the system refuses.
pub fn terminate(number: u32) -> io::Result<()> {
    signal(number, Signal::TERM)
}

fn signal(number: u32, signal: Signal) -> io::Result<()> {
    let process = i32::try_from(number).ok().and_then(Pid::from_raw);
    Ok(kill_process(process.ok_or(Errno::SRCH)?, signal)?)
}

/// Returns the signal that stops a process where it is, or resumes it.
pub(crate) fn suspension(is_suspended: bool) -> Signal {
    if is_suspended {
        Signal::STOP
    } else {
        Signal::CONT
    }
}

/// Returns a number of `/proc/PID/stat`, by its place after the process's name; `None` if the process is gone.
pub(crate) fn stat(process: Pid, field: usize) -> Option<u32> {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", process.as_raw_nonzero())).ok()?;
    // The name may contain any character.
    let fields = stat.rsplit(") ").next()?;
    fields.split(' ').nth(field)?.parse().ok()
}

/// Returns whether a process killed by this signal crashed by itself: no other process sends these signals.
pub fn is_crash(signal: i32) -> bool {
    [
        libc::SIGSEGV,
        libc::SIGABRT,
        libc::SIGFPE,
        libc::SIGILL,
        libc::SIGBUS,
        libc::SIGTRAP,
        libc::SIGSYS,
    ]
    .contains(&signal)
}

/// Returns the side channel that the parent gave this process in place of a standard input.
///
/// # Errors
/// If there is none, or the system refuses.
pub fn channel_from_parent() -> io::Result<OwnedFd> {
    side_channel(io::stdin().as_fd())
}

fn side_channel(input: BorrowedFd<'_>) -> io::Result<OwnedFd> {
    if socket_type(input) != Ok(SocketType::SEQPACKET) {
        return Err(io::Error::other("standard input is no side channel"));
    }
    input.try_clone_to_owned()
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::os::unix::process::ExitStatusExt;
    use std::process::{Child, ExitStatus};
    use std::time::Duration;

    use rustix::event::PollFlags;
    use rustix::net::{RecvFlags, recv};
    use rustix::process::{Pid, kill_process};

    use super::*;
    use crate::clock::Clock;
    use crate::lockstep::channel;
    use crate::stop::StopSignal;
    use crate::wait::wait_ready;

    const SOON: Duration = Duration::from_secs(10);
    const CHILD: &str = "PLATFORM_TEST_CHILD";
    const STOPS: &str = "stops";
    const HANGS: &str = "hangs";
    const ENDS_AT_ONCE: &str = "ends at once";

    /// Child of the tests below; not a test by itself.
    #[test]
    #[ignore = "not a test: the child of the other tests"]
    fn child() {
        let Ok(kind) = std::env::var(CHILD) else {
            return;
        };
        let stop = StopSignal::from_parent().unwrap();
        if kind == ENDS_AT_ONCE {
            crate::stop::end_at_once(7).unwrap();
        }
        rustix::io::write(rustix::stdio::stdout(), b"up\n").unwrap();
        while kind != STOPS || !stop.is_raised() {
            std::thread::yield_now();
        }
        std::process::exit(42);
    }

    /// Starts a child with this standard input; returns it once it is up.
    fn child_that(kind: &str, input: Stdio) -> Child {
        let mut command = myself().unwrap();
        command.args(["--exact", "process::tests::child", "--ignored"]);
        command.env(CHILD, kind).stdin(input).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let output = child.stdout.take().unwrap();
        let mut said = Vec::new();
        while !said.ends_with(b"up\n") {
            let is_ready = wait_ready(output.as_fd(), PollFlags::IN, SOON).unwrap();
            assert!(is_ready, "the child did not come up");
            let mut part = [0; 256];
            let length = rustix::io::read(&output, &mut part).unwrap();
            assert_ne!(length, 0, "the child ended");
            said.extend_from_slice(&part[..length]);
        }
        child
    }

    fn signal(child: &Child, signal: Signal) {
        kill_process(Pid::from_child(child), signal).unwrap();
    }

    /// Waits for the child's end, without closing its standard input.
    fn ended(child: &mut Child) -> ExitStatus {
        let clock = Clock::start();
        loop {
            if let Some(status) = child.try_wait().unwrap() {
                return status;
            }
            if clock.now() > SOON {
                child.kill().unwrap();
                child.wait().unwrap();
                panic!("the child did not end");
            }
            crate::clock::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn only_a_channel_is_taken_for_one() {
        let (_ours, theirs) = channel().unwrap();
        assert!(side_channel(theirs.as_fd()).is_ok());
        let refused = side_channel(File::open("/dev/null").unwrap().as_fd()).unwrap_err();
        assert_eq!(refused.to_string(), "standard input is no side channel");
    }

    #[test]
    fn the_end_of_its_input_stops_a_child() {
        let mut child = child_that(STOPS, Stdio::piped());
        drop(child.stdin.take());
        assert_eq!(ended(&mut child).code(), Some(42));
    }

    #[test]
    fn the_channel_of_a_child_ends_with_it() {
        let (ours, theirs) = channel().unwrap();
        let mut child = child_that(STOPS, theirs.into());
        signal(&child, Signal::TERM);
        assert_eq!(ended(&mut child).code(), Some(42));
        let (_, length) = recv(&ours, &mut [0; 8], RecvFlags::empty()).unwrap();
        assert_eq!(length, 0);
    }

    #[test]
    fn the_end_of_its_channel_stops_a_child() {
        let (ours, theirs) = channel().unwrap();
        let mut child = child_that(STOPS, theirs.into());
        drop(ours);
        assert_eq!(ended(&mut child).code(), Some(42));
    }

    #[test]
    fn a_signal_ends_a_program_at_once_that_asks_for_it() {
        let mut child = child_that(ENDS_AT_ONCE, Stdio::piped());
        signal(&child, Signal::TERM);
        assert_eq!(ended(&mut child).code(), Some(7));
    }

    #[test]
    fn no_signal_of_a_terminal_ends_a_child_but_sigterm_stops_it() {
        let mut child = child_that(STOPS, Stdio::piped());
        signal(&child, Signal::INT);
        signal(&child, Signal::HUP);
        signal(&child, Signal::QUIT);
        crate::clock::sleep(Duration::from_millis(50));
        assert!(child.try_wait().unwrap().is_none());
        signal(&child, Signal::TERM);
        assert_eq!(ended(&mut child).code(), Some(42));
    }

    #[test]
    fn a_child_stops_when_the_thread_that_spawned_it_ends() {
        let start = || child_that(STOPS, Stdio::piped());
        let mut child = std::thread::spawn(start).join().unwrap();
        assert_eq!(ended(&mut child).code(), Some(42));
    }

    #[test]
    fn a_child_that_hangs_is_ended_by_the_kernel() {
        let mut child = child_that(HANGS, Stdio::piped());
        signal(&child, Signal::TERM);
        assert_eq!(ended(&mut child).signal(), Some(Signal::ALARM.as_raw()));
    }
}
