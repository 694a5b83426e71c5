//! Child processes of the bench, and the descriptors that they inherit.
#![expect(
    unsafe_code,
    reason = "what happens between fork and exec, and descriptors passed by number"
)]

use std::io;
use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicI32, Ordering};

use rustix::io::{Errno, FdFlags, fcntl_setfd};
use rustix::net::SocketType;
use rustix::net::sockopt::socket_type;
use rustix::process::{
    Pid, Resource, Rlimit, Signal, getpid, getppid, getrlimit, kill_process,
    set_parent_process_death_signal, setrlimit, setsid,
};

use crate::stop::OF_TERMINAL;

/// Returns a command that starts this program again, as a child that does not outlive us:
/// - its standard input is a pipe from us, whose end stops it ([`crate::stop::StopSignal::from_parent`]);
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

/// Error: fewer files than a run needs may be open at once.
#[derive(Debug, thiserror::Error)]
#[error(
    "only {permitted} files may be open at once, and {needed} are needed; permit them with: ulimit -n {needed}"
)]
pub struct TooFewFiles {
    permitted: u64,
    needed: u64,
}

/// Raises this process's limit of open files if it is below `needed`.
///
/// # Errors
/// If more are not permitted.
pub fn permit_open_files(needed: u64) -> Result<(), TooFewFiles> {
    let limit = getrlimit(Resource::Nofile);
    let (Some(current), maximum) = (limit.current, limit.maximum) else {
        return Ok(());
    };
    if current >= needed {
        return Ok(());
    }
    let raised = Rlimit {
        current: Some(needed),
        maximum,
    };
    setrlimit(Resource::Nofile, raised).map_err(|_| TooFewFiles {
        permitted: current,
        needed,
    })
}

/// Makes the child inherit `descriptor`; returns the number to pass to the child. The descriptor is closed here when `command` is
/// dropped: drop it once the child is spawned, or its end of a side channel stays open after its death.
pub fn inherit(command: &mut Command, descriptor: OwnedFd) -> RawFd {
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
    let child = i32::try_from(number).ok().and_then(Pid::from_raw);
    Ok(kill_process(
        child.ok_or(Errno::SRCH)?,
        suspension(is_suspended),
    )?)
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

/// Opens the side channel that the parent passed under `number`.
///
/// # Errors
/// If `number` is no `SOCK_SEQPACKET` socket, or was taken before.
pub fn inherited_channel(number: RawFd) -> io::Result<OwnedFd> {
    static TAKEN: AtomicI32 = AtomicI32::new(-1);
    if number <= 2 {
        return Err(io::Error::other(format!(
            "descriptor {number} is a standard stream, not a side channel"
        )));
    }
    if TAKEN
        .compare_exchange(-1, number, Ordering::Relaxed, Ordering::Relaxed)
        .is_err()
    {
        return Err(io::Error::other("the side channel was taken before"));
    }
    // SAFETY: the number is not used here before or after, as long as it is a socket, which is checked next; if it is
    // not, it is given back unclosed.
    let channel = unsafe { OwnedFd::from_raw_fd(number) };
    match socket_type(&channel) {
        Ok(SocketType::SEQPACKET) => {
            fcntl_setfd(&channel, FdFlags::CLOEXEC)?;
            Ok(channel)
        }
        _ => {
            std::mem::forget(channel);
            TAKEN.store(-1, Ordering::Relaxed);
            Err(io::Error::other(format!(
                "descriptor {number} is no side channel"
            )))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;
    use std::process::{Child, ExitStatus};
    use std::time::Duration;

    use rustix::event::PollFlags;
    use rustix::net::{RecvFlags, SendFlags, recv, send};
    use rustix::process::{Pid, kill_process};

    use super::*;
    use crate::clock::Clock;
    use crate::lockstep::channel;
    use crate::stop::StopSignal;
    use crate::wait::wait_ready;

    const SOON: Duration = Duration::from_secs(10);
    const CHANNEL: &str = "PLATFORM_TEST_CHANNEL";
    const HANGS: &str = "PLATFORM_TEST_HANGS";

    /// Child of the tests below; not a test by itself.
    #[test]
    #[ignore = "not a test: the child of the other tests"]
    fn child() {
        let Ok(number) = std::env::var(CHANNEL) else {
            return;
        };
        let stop = StopSignal::from_parent().unwrap();
        let number = number.parse().unwrap();
        let channel = inherited_channel(number).unwrap();
        assert!(inherited_channel(number).is_err());
        send(&channel, b"up", SendFlags::NOSIGNAL).unwrap();
        while std::env::var_os(HANGS).is_some() || !stop.is_raised() {
            std::thread::yield_now();
        }
        std::process::exit(42);
    }

    /// Starts a child; returns it once it is up, with our end of its channel.
    fn child_that(hangs: bool) -> (Child, OwnedFd) {
        let (ours, theirs) = channel().unwrap();
        let mut command = myself().unwrap();
        command.args(["--exact", "process::tests::child", "--ignored"]);
        let number = inherit(&mut command, theirs);
        command.env(CHANNEL, number.to_string());
        if hangs {
            command.env(HANGS, "yes");
        }
        let child = command.stdout(Stdio::null()).spawn().unwrap();
        drop(command);
        assert!(wait_ready(ours.as_fd(), PollFlags::IN, SOON).unwrap());
        let mut bytes = [0; 8];
        let (_, length) = recv(&ours, &mut bytes, RecvFlags::empty()).unwrap();
        assert_eq!(&bytes[..length], b"up");
        (child, ours)
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
    fn the_end_of_its_input_stops_a_child_and_its_channel_ends_with_it() {
        let (mut child, channel) = child_that(false);
        drop(child.stdin.take());
        assert_eq!(ended(&mut child).code(), Some(42));
        let (_, length) = recv(&channel, &mut [0; 8], RecvFlags::empty()).unwrap();
        assert_eq!(length, 0);
    }

    #[test]
    fn no_signal_of_a_terminal_ends_a_child_but_sigterm_stops_it() {
        let (mut child, _channel) = child_that(false);
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
        let (mut child, _channel) = std::thread::spawn(|| child_that(false)).join().unwrap();
        assert_eq!(ended(&mut child).code(), Some(42));
    }

    #[test]
    fn a_child_that_hangs_is_ended_by_the_kernel() {
        let (mut child, _channel) = child_that(true);
        signal(&child, Signal::TERM);
        assert_eq!(ended(&mut child).signal(), Some(Signal::ALARM.as_raw()));
    }

    #[test]
    fn what_is_no_side_channel_is_refused() {
        let error = inherited_channel(0).unwrap_err().to_string();
        assert!(error.contains("standard stream"), "{error}");
        let file = std::fs::File::open("/dev/null").unwrap();
        let error = inherited_channel(file.as_raw_fd()).unwrap_err().to_string();
        assert!(error.contains("is no side channel"), "{error}");
        assert!(inherited_channel(9999).is_err());
    }
}
