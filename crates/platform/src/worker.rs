//! Worker process of this program for code that may crash: the process that started it sees how it ended, and continues.

use std::io;
use std::os::fd::{OwnedFd, RawFd};
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, ExitStatus, Stdio};
use std::time::Duration;

use rustix::io::Errno;
use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{RecvFlags, SendFlags, recv, send};
use rustix::pipe::{PipeFlags, pipe_with};
use rustix::process::{Signal, set_parent_process_death_signal};

use crate::lockstep::channel;
use crate::process::{inherit, inherited_channel, myself};
use crate::scheduling::pass_on_fifo;

/// Largest part of a worker's standard error that is told at its end.
const TOLD_BYTES_MAX: usize = 2_000;
/// Time for a worker to end after it closed its channel, in steps of a millisecond.
const END_PATIENCE_MILLISECONDS: u32 = 1_000;

/// One end of the channel between a worker and its parent. Messages arrive whole.
pub struct Channel {
    socket: OwnedFd,
    patience: Option<Duration>,
}

impl Channel {
    pub(crate) fn new(socket: OwnedFd) -> Self {
        Self {
            socket,
            patience: None,
        }
    }

    /// Opens the worker's end, which the parent passed under `number`. From now on the worker is killed when the parent ends,
    /// whatever it does.
    ///
    /// # Errors
    /// If there is no channel of this number.
    pub fn inherited(number: RawFd) -> io::Result<Self> {
        set_parent_process_death_signal(Some(Signal::KILL))?;
        inherited_channel(number).map(Self::new)
    }

    /// Sends a message.
    ///
    /// # Errors
    /// If the other end is gone.
    pub fn send(&self, message: &[u8]) -> io::Result<()> {
        send(&self.socket, message, SendFlags::NOSIGNAL)?;
        Ok(())
    }

    /// Waits for a message, no longer than `patience`; returns its length, 0 if the other end is gone.
    ///
    /// # Errors
    /// [`io::ErrorKind::TimedOut`] if none came, or the error of a failed channel.
    pub fn receive(&mut self, message: &mut [u8], patience: Option<Duration>) -> io::Result<usize> {
        if self.patience != patience {
            set_socket_timeout(&self.socket, Timeout::Recv, patience)?;
            self.patience = patience;
        }
        loop {
            return match recv(&self.socket, &mut *message, RecvFlags::empty()) {
                Ok((length, _)) => Ok(length),
                Err(Errno::INTR) => continue,
                Err(Errno::CONNRESET | Errno::PIPE) => Ok(0),
                Err(Errno::AGAIN) => Err(io::ErrorKind::TimedOut.into()),
                Err(errno) => Err(errno.into()),
            };
        }
    }
}

/// Worker; it ends on drop.
pub struct Worker {
    /// Channel to the worker.
    pub channel: Channel,
    child: Child,
    /// Standard error of the worker. Output that does not fit is lost, so that the worker never waits.
    errors: OwnedFd,
}

impl Worker {
    /// Starts this program again, with these arguments followed by the number of its end of the channel. It ends with the thread
    /// that started it ([`myself`]). If that thread has a real-time priority, so has the worker, which the thread waits for.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn start(arguments: &[&str]) -> io::Result<Self> {
        let (ours, theirs) = channel()?;
        let (errors, their_errors) = pipe_with(PipeFlags::CLOEXEC | PipeFlags::NONBLOCK)?;
        let mut command = myself()?;
        let number = inherit(&mut command, theirs);
        command.args(arguments).arg(number.to_string());
        command.stdout(Stdio::null()).stderr(their_errors);
        pass_on_fifo(&mut command);
        let child = command.spawn()?;
        Ok(Self {
            channel: Channel::new(ours),
            child,
            errors,
        })
    }

    /// Returns a text that continues "the process", such as "exited with code 0", and the last part of its standard error. A
    /// process that does not end soon is killed.
    pub fn ended(&mut self) -> (String, String) {
        let mut left = END_PATIENCE_MILLISECONDS;
        let status = loop {
            match self.child.try_wait() {
                Ok(None) if left > 0 => crate::clock::sleep(Duration::from_millis(1)),
                Ok(None) => {
                    self.kill();
                    break None;
                }
                Ok(Some(status)) => break Some(status),
                Err(_) => break None,
            }
            left -= 1;
        };
        let how = status.map_or_else(|| "closed its channel".to_owned(), how);
        (how, self.told())
    }

    fn told(&self) -> String {
        let mut told = Vec::new();
        let mut bytes = [0; 4096];
        while let Ok(length @ 1..) = rustix::io::read(&self.errors, &mut bytes) {
            told.extend_from_slice(&bytes[..length]);
        }
        let start = told.len().saturating_sub(TOLD_BYTES_MAX);
        String::from_utf8_lossy(&told[start..]).trim().to_owned()
    }

    fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Describes how a process ended.
pub(crate) fn how(status: ExitStatus) -> String {
    let name = |signal| match signal {
        libc::SIGSEGV => " (SIGSEGV: it used memory that is not its own)",
        libc::SIGABRT => " (SIGABRT: it gave up)",
        libc::SIGFPE => " (SIGFPE: it computed what cannot be)",
        libc::SIGILL => " (SIGILL: it ran what is no instruction here)",
        libc::SIGBUS => " (SIGBUS: it used memory that is not there)",
        libc::SIGKILL => " (SIGKILL: somebody ended it, or memory ran out)",
        _ => "",
    };
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exited with code {code}"),
        (None, Some(signal)) => format!("was ended by signal {signal}{}", name(signal)),
        (None, None) => "ended".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;
    use crate::scheduling::{NODE_PRIORITY, WORKER_PRIORITY, request_fifo};

    const SOON: Option<Duration> = Some(Duration::from_secs(10));

    /// Worker of the tests below; not a test by itself.
    #[test]
    #[ignore = "not a test: the worker of the other tests"]
    fn work() {
        let Ok(number) = std::env::args().next_back().unwrap_or_default().parse() else {
            return;
        };
        let mut channel = Channel::inherited(number).unwrap();
        let mut message = [0; 16];
        loop {
            match channel.receive(&mut message, None).unwrap() {
                0 => return,
                length if message[0] == b'e' => {
                    channel.send(&message[..length]).unwrap();
                }
                _ if message[0] == b'x' => {
                    io::stderr().write_all(b"on purpose\n").unwrap();
                    std::process::exit(7);
                }
                _ if message[0] == b'a' => std::process::abort(),
                _ => crate::clock::sleep(Duration::from_secs(60)),
            }
        }
    }

    fn worker() -> Worker {
        let arguments = ["--exact", "worker::tests::work", "--ignored", "--nocapture"];
        Worker::start(&arguments).unwrap()
    }

    #[test]
    fn a_worker_answers() {
        let mut worker = worker();
        let mut answer = [0; 16];
        for message in [&b"e1"[..], b"e23"] {
            worker.channel.send(message).unwrap();
            let length = worker.channel.receive(&mut answer, SOON).unwrap();
            assert_eq!(&answer[..length], message);
        }
    }

    /// Returns policy and priority of a process's first thread: 1 is SCHED_FIFO, 0 the ordinary one.
    fn scheduling(number: u32) -> [u32; 2] {
        let stat = std::fs::read_to_string(format!("/proc/{number}/stat")).unwrap();
        let (_, fields) = stat.rsplit_once(')').unwrap();
        let fields = Vec::from_iter(fields.split_whitespace());
        [fields[38], fields[37]].map(|field| field.parse().unwrap())
    }

    #[test]
    fn a_worker_has_a_priority_where_its_node_has_one() {
        let ours = scheduling(std::process::id());
        assert_eq!(scheduling(worker().child.id()), ours);
        let beside_a_node = || {
            let is_granted = request_fifo(NODE_PRIORITY).is_ok();
            (is_granted, scheduling(worker().child.id()))
        };
        let (is_granted, scheduling) = std::thread::spawn(beside_a_node).join().unwrap();
        let expected = if is_granted {
            [1, WORKER_PRIORITY.into()]
        } else {
            ours
        };
        assert_eq!(scheduling, expected);
    }

    #[test]
    fn how_a_worker_ended_is_known() {
        let mut exiting = worker();
        exiting.channel.send(b"x").unwrap();
        assert_eq!(exiting.channel.receive(&mut [0; 16], SOON).unwrap(), 0);
        let (how, told) = exiting.ended();
        assert_eq!(how, "exited with code 7");
        assert!(told.ends_with("on purpose"), "{told}");
        let mut aborting = worker();
        aborting.channel.send(b"a").unwrap();
        assert_eq!(aborting.channel.receive(&mut [0; 16], SOON).unwrap(), 0);
        let (how, _) = aborting.ended();
        assert!(how.starts_with("was ended by signal 6"), "{how}");
    }

    #[test]
    fn a_worker_that_hangs_is_ended() {
        let mut worker = worker();
        worker.channel.send(b"h").unwrap();
        let patience = Some(Duration::from_millis(50));
        let error = worker.channel.receive(&mut [0; 16], patience).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        worker.ended();
        assert!(worker.child.try_wait().unwrap().is_some());
    }
}
