//! External programs at a seat: start, messages, end.

use std::io;
use std::ops::Range;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

use rustix::event::PollFlags;
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::io::Errno;
use rustix::net::{SendFlags, SocketAddrUnix, SocketFlags, connect, send};
use rustix::process::{Signal, kill_process_group};

use crate::bus::seqpacket;
use crate::keeper::{STOP_PATIENCE, SUBCOMMAND, TERM_PATIENCE, children};
use crate::listener::Listener;
use crate::process::{myself, suspension};
use crate::scheduling::pass_on_fifo;
use crate::seat::{
    Header, Kind, MESSAGE_BYTES_MAX, STOPPED, numbers, read_welcome, receive_packet, write_done,
    write_failure, write_hello, write_numbers,
};
use crate::stop::is_requested;
use crate::wait::{wait_for_process, wait_ready};

/// Variable with the socket of a law's seat.
pub const PORTS_VARIABLE: &str = "CANRIG_PORTS";
/// Variable with the bus of a node.
pub const BUS_VARIABLE: &str = "CANRIG_BUS";

/// Variables that are set if the environment of canrig lacks them: without them results of Python programs are not reproducible.
const DEFAULTS: [(&str, &str); 3] = [
    ("OMP_NUM_THREADS", "1"),
    ("PYTHONHASHSEED", "0"),
    ("PYTHONUNBUFFERED", "1"),
];

/// Longest time for a program to come to its seat, and to get ready there: some start an interpreter.
pub const START_PATIENCE: Duration = Duration::from_secs(60);
/// Longest time for the end of a program, with a reserve for a machine that is slow to take a killed process away.
pub const END_PATIENCE: Duration = STOP_PATIENCE
    .saturating_add(TERM_PATIENCE)
    .saturating_add(Duration::from_secs(10));
/// Time for a program to end by itself once this process was asked to end.
const PATIENCE_AFTER_REQUEST: Duration = Duration::from_secs(1);
/// Period of the check whether a program has ended. A standstill of the machine takes one such period of a patience.
const LOOK: Duration = Duration::from_millis(20);

/// Text for a program that ended by itself or on request.
pub const ORDERLY: &str = "exited with code 0";

/// Description of a program to start.
#[derive(Clone, Copy, Debug)]
pub struct Order<'a> {
    /// Program and its arguments.
    pub command: &'a [String],
    /// Working directory.
    pub folder: &'a Path,
    /// File for the output.
    pub log: Option<&'a Path>,
    /// File that is removed when the program has ended, even if canrig was killed.
    pub part: Option<&'a Path>,
    /// Variables to add to its environment.
    pub environment: &'a [(&'a str, String)],
}

/// Program at a seat; it ends on drop.
#[derive(Debug)]
pub struct Program {
    keeper: Child,
    /// Socket at which the program is expected, until it connects.
    listener: Option<Listener>,
    channel: Option<OwnedFd>,
    /// Report of the keeper on the end so far; whole once `has_ended`.
    told: Vec<u8>,
    has_ended: bool,
}

impl Program {
    /// Starts a program with a seat, or without one; it ends with the thread that started it.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn start(order: &Order<'_>, listener: Option<Listener>) -> io::Result<Self> {
        let mut command = myself()?;
        let log = order.log.map(std::path::absolute).transpose()?;
        command.arg(SUBCOMMAND);
        if let Some(log) = log {
            command.arg("--log").arg(log);
        }
        if let Some(part) = order.part {
            command.arg("--part").arg(part);
        }
        command.arg("--").args(order.command);
        command.current_dir(order.folder).stdout(Stdio::piped());
        for (name, value) in DEFAULTS {
            if std::env::var_os(name).is_none() {
                command.env(name, value);
            }
        }
        command.envs(order.environment.iter().map(|(name, value)| (name, value)));
        pass_on_fifo(&mut command);
        let keeper = command.spawn()?;
        if let Some(told) = &keeper.stdout {
            fcntl_setfl(told, OFlags::NONBLOCK)?;
        }
        Ok(Self {
            keeper,
            listener,
            channel: None,
            told: Vec::new(),
            has_ended: false,
        })
    }

    /// Waits for the program to connect to its seat; returns false if it ended before, or took too long, or this process was
    /// asked to end. Afterwards the seat is closed.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn accept(&mut self) -> io::Result<bool> {
        let listener = self.listener.take().ok_or(Errno::NOTCONN)?;
        for _ in looks(START_PATIENCE) {
            self.channel = listener.accept(LOOK)?;
            if self.channel.is_some() || self.look() || is_requested() {
                break;
            }
        }
        Ok(self.channel.is_some())
    }

    /// Takes the channel to the program, for a caller with another protocol.
    pub fn take_channel(&mut self) -> Option<OwnedFd> {
        self.channel.take()
    }

    /// Returns the number of the process whose descendants are the program.
    pub fn number(&self) -> u32 {
        self.keeper.id()
    }

    /// Kills the program, and all in its group.
    pub fn kill(&self) {
        self.signal(Signal::KILL);
    }

    /// Stops the program and all in its group where they are, or resumes them.
    pub fn suspend(&self, is_suspended: bool) {
        self.signal(suspension(is_suspended));
    }

    fn signal(&self, signal: Signal) {
        for program in children(self.keeper.id()) {
            // The keeper notices a program that has ended meanwhile.
            let _ = kill_process_group(program, signal);
        }
    }

    /// Asks the program to end, by the end of its lifeline, and waits for that; it is killed if it does not end. Returns as
    /// [`Program::ended`].
    pub fn dismiss(&mut self) -> Option<(String, String)> {
        self.keeper.stdin = None;
        if is_requested() {
            let ended = self.ended(PATIENCE_AFTER_REQUEST);
            if ended.is_some() {
                return ended;
            }
            self.kill();
        }
        self.ended(END_PATIENCE)
    }

    /// Sends a message without waiting.
    ///
    /// # Errors
    /// If the program is gone, or does not read.
    pub fn send(&self, message: &[u8]) -> io::Result<()> {
        let channel = self.channel.as_ref().ok_or(Errno::NOTCONN)?;
        send(channel, message, SendFlags::NOSIGNAL | SendFlags::DONTWAIT)?;
        Ok(())
    }

    /// Waits for a message, no longer than `patience`; returns whether one came. It is empty if the program closed its end, and cut
    /// to the capacity of the buffer.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn receive(&self, message: &mut Vec<u8>, patience: Duration) -> io::Result<bool> {
        let channel = self.channel.as_ref().ok_or(Errno::NOTCONN)?;
        let has_come = wait_for_process(channel.as_fd(), PollFlags::IN, patience)?;
        if has_come {
            receive_packet(channel, message)?;
        }
        Ok(has_come)
    }

    /// Waits for the end of a program that closed its end of the channel, no longer than `patience`. Returns a text that
    /// continues "the program", and its last output; `None` if it did not end.
    pub fn ended(&mut self, patience: Duration) -> Option<(String, String)> {
        let mut looks = looks(patience);
        while !self.look() {
            looks.next()?;
            if let Some(told) = &self.keeper.stdout {
                // After a failed wait the loop looks again.
                let _ = wait_ready(told.as_fd(), PollFlags::IN, LOOK);
            }
        }
        let told = String::from_utf8_lossy(&self.told).into_owned();
        let (how, output) = match told.split_once('\n') {
            Some(told) => told,
            // The keeper takes its program along.
            None if told.is_empty() => ("was killed with its keeper", ""),
            None => (told.as_str(), ""),
        };
        Some((how.to_owned(), output.trim_end().to_owned()))
    }

    /// Reads from the keeper; returns whether its report is complete.
    fn look(&mut self) -> bool {
        let mut part = [0; 4096];
        while let (false, Some(told)) = (self.has_ended, &self.keeper.stdout) {
            match rustix::io::read(told, &mut part) {
                Ok(length @ 1..) => self.told.extend_from_slice(&part[..length]),
                Err(Errno::AGAIN | Errno::INTR) => break,
                Ok(_) | Err(_) => self.has_ended = true,
            }
        }
        self.has_ended
    }
}

impl Drop for Program {
    /// Asks the program to end, and waits for it.
    fn drop(&mut self) {
        let mut stop = Vec::new();
        Header::of(Kind::Stop).begin(&mut stop);
        // A program that is gone need not be asked.
        let _ = self.send(&stop);
        if self.dismiss().is_none() {
            let _ = self.keeper.kill();
        }
        let _ = self.keeper.wait();
    }
}

/// Returns the checks within a patience.
fn looks(patience: Duration) -> Range<u128> {
    0..patience.as_nanos().div_ceil(LOOK.as_nanos())
}

/// The program's end of its seat, for a process of canrig that runs a law.
pub struct Seat {
    channel: OwnedFd,
    message: Vec<u8>,
    answer: Vec<u8>,
}

impl Seat {
    /// Takes the seat named by the environment.
    ///
    /// # Errors
    /// If there is no such variable, or no socket listens there.
    pub fn join(name: &str) -> io::Result<Self> {
        let path = std::env::var_os(PORTS_VARIABLE)
            .map(PathBuf::from)
            .ok_or_else(|| io::Error::other("no seat is named: runs start this"))?;
        let socket = seqpacket(SocketFlags::empty())?;
        connect(&socket, &SocketAddrUnix::new(path.as_path())?)?;
        let mut seat = Self {
            channel: socket,
            message: Vec::with_capacity(MESSAGE_BYTES_MAX),
            answer: Vec::with_capacity(MESSAGE_BYTES_MAX),
        };
        write_hello(&mut seat.answer, name);
        seat.send()?;
        Ok(seat)
    }

    fn send(&self) -> io::Result<()> {
        send(&self.channel, &self.answer, SendFlags::NOSIGNAL)?;
        Ok(())
    }

    /// Waits for a message, which is empty if canrig is gone.
    fn receive(&mut self) -> io::Result<()> {
        Ok(receive_packet(&self.channel, &mut self.message)?)
    }

    /// Waits for WELCOME; returns its content and the seed.
    ///
    /// # Errors
    /// If canrig is gone, or speaks another protocol.
    pub fn welcome(&mut self) -> io::Result<(&[u8], u64)> {
        self.receive()?;
        read_welcome(&self.message).map_err(io::Error::other)
    }

    /// Runs a law, or reports why there is none, until canrig asks it to stop.
    ///
    /// # Errors
    /// If canrig speaks another protocol.
    pub fn play<Law>(
        &mut self,
        law: Result<Law, String>,
        reads: usize,
        writes: usize,
    ) -> io::Result<()>
    where
        Law: FnMut(f64, f64, &[f64], &mut [f64]) -> Result<(), String>,
    {
        let mut law = match law {
            Ok(law) => law,
            Err(why) => {
                write_failure(&mut self.answer, Header::of(Kind::Done), &why);
                return self.send();
            }
        };
        write_done(&mut self.answer, 0, 0);
        self.send()?;
        let (mut read, mut written) = (vec![0.0; reads], vec![0.0; writes]);
        loop {
            self.receive()?;
            if self.message.is_empty() {
                return Ok(());
            }
            let (header, body) = Header::split(&self.message).map_err(io::Error::other)?;
            let mut values = numbers(body);
            if header.kind == Kind::Stop as u8 {
                // Its end is over when canrig hears of it.
                drop(law);
                write_done(&mut self.answer, header.number, STOPPED);
                return self.send();
            }
            if header.kind != Kind::Step as u8 || values.len() != 1 + reads {
                return Err(io::Error::other("the other end speaks another protocol"));
            }
            let period_seconds = values.next().unwrap_or_default();
            read.iter_mut()
                .zip(values)
                .for_each(|(read, value)| *read = value);
            let time_seconds = Duration::from_nanos(header.time).as_secs_f64();
            let answer = Header {
                number: header.number,
                time: header.time,
                ..Header::of(Kind::Values)
            };
            match law(time_seconds, period_seconds, &read, &mut written) {
                Ok(()) => write_numbers(&mut self.answer, answer, None, &written),
                Err(why) => write_failure(&mut self.answer, answer, &why),
            }
            self.send()?;
        }
    }
}

/// Opens a seat in the system's folder for temporary files.
///
/// # Errors
/// If the system refuses.
pub fn open_seat() -> io::Result<Listener> {
    Listener::open_in(&std::env::temp_dir(), "canrig-seat-", 1)
}

#[cfg(test)]
pub(crate) mod tests {
    use std::process::Command;

    use super::*;
    use crate::lockstep::channel;

    /// Makes a program that ends at once, with its seat or its channel.
    pub(crate) fn ending(listener: Option<Listener>, channel: Option<OwnedFd>) -> Program {
        let mut keeper = Command::new("true");
        Program {
            keeper: keeper.stdout(Stdio::piped()).spawn().unwrap(),
            listener,
            channel,
            told: Vec::new(),
            has_ended: false,
        }
    }

    #[test]
    fn a_program_that_has_ended_does_not_come_to_its_seat() {
        let mut program = ending(Some(open_seat().unwrap()), None);
        assert!(!program.accept().unwrap());
    }

    #[test]
    fn a_program_that_does_not_read_is_not_waited_for() {
        let (ours, _theirs) = channel().unwrap();
        let program = ending(None, Some(ours));
        let mut sent = (0..1_000_000).map(|_| program.send(&[0; 64]));
        let refused = sent.find_map(Result::err).unwrap();
        assert_eq!(refused.kind(), io::ErrorKind::WouldBlock);
    }
}
