//! A program of somebody else that takes a seat: how it is started, how it is spoken with, how it is ended.

use std::fs::Permissions;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

use rustix::event::PollFlags;
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::io::Errno;
use rustix::net::sockopt::socket_peercred;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, accept_with,
    bind, connect, listen, recv, send, socket_with,
};
use rustix::process::{Signal, getuid, kill_process_group};
use tempfile::TempDir;

use crate::bus::wait_ready;
use crate::clock::Clock;
use crate::keeper::{STOP_PATIENCE, SUBCOMMAND, TERM_PATIENCE, children_of};
use crate::process::myself;
use crate::scheduling::{WORKER_PRIORITY, has_fifo, with_fifo};
use crate::seat::{
    Header, Kind, MESSAGE_BYTES_MAX, STOPPED, numbers, read_welcome, write_done, write_failure,
    write_hello, write_numbers,
};
use crate::worker::Channel;

/// The variable that names the socket of a law's seat.
pub const PORTS_VARIABLE: &str = "CANRIG_PORTS";
/// The variable that names the bus of a node.
pub const BUS_VARIABLE: &str = "CANRIG_BUS";

/// Variables that are set where the environment of canrig does not have them: without them Python repeats nothing.
const DEFAULTS: [(&str, &str); 3] = [
    ("OMP_NUM_THREADS", "1"),
    ("PYTHONHASHSEED", "0"),
    ("PYTHONUNBUFFERED", "1"),
];

/// Time that a program has to come to its seat, and to get ready there: some start an interpreter.
pub const START_PATIENCE: Duration = Duration::from_secs(60);
/// Time that the end of a program may take, with some to spare for the machine.
pub const END_PATIENCE: Duration = STOP_PATIENCE
    .saturating_add(TERM_PATIENCE)
    .saturating_add(Duration::from_secs(3));
/// Time between two looks whether a program has ended that is waited for.
const LOOK: Duration = Duration::from_millis(20);

/// How a program ended by itself, or when it was asked to.
pub const ORDERLY: &str = "exited with code 0";

/// What is started.
#[derive(Clone, Copy, Debug)]
pub struct Order<'a> {
    /// The program and its arguments.
    pub command: &'a [String],
    /// Its working directory.
    pub folder: &'a Path,
    /// The file of what it prints.
    pub log: Option<&'a Path>,
    /// Variables that are added to its environment.
    pub environment: &'a [(&'a str, String)],
}

/// What came of waiting for a message.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Received {
    /// A message of so many bytes.
    Message(usize),
    /// None came.
    Nothing,
    /// The program closed its end.
    Closed,
}

/// A program at a seat, which ends when this is dropped.
#[derive(Debug)]
pub struct Program {
    keeper: Child,
    /// Where it is expected, until it comes.
    listener: Option<Listener>,
    channel: Option<OwnedFd>,
    /// The keeper's words on its end so far; whole once `has_ended`.
    told: Vec<u8>,
    has_ended: bool,
}

impl Program {
    /// Starts a program that comes to a seat, or to none; it ends with the thread that started it.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn start(order: &Order<'_>, listener: Option<Listener>) -> io::Result<Self> {
        let mut command = myself()?;
        let log = order.log.map(std::path::absolute).transpose()?;
        command.arg(SUBCOMMAND);
        if let Some(log) = log {
            command.arg("--log").arg(log);
        }
        command.arg("--").args(order.command);
        command.current_dir(order.folder).stdout(Stdio::piped());
        for (name, value) in DEFAULTS {
            if std::env::var_os(name).is_none() {
                command.env(name, value);
            }
        }
        command.envs(order.environment.iter().map(|(name, value)| (name, value)));
        if has_fifo() {
            with_fifo(&mut command, WORKER_PRIORITY);
        }
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

    /// Waits for the program to come to its seat; false if it ended before, or its time is over. Then nobody can come any more.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn accept(&mut self) -> io::Result<bool> {
        let clock = Clock::start();
        while let Some(listener) = &self.listener {
            self.channel = listener.accept(LOOK)?;
            if self.channel.is_some() || self.look() || clock.now() > START_PATIENCE {
                self.listener = None;
            }
        }
        Ok(self.channel.is_some())
    }

    /// The channel to the program, for who speaks with it otherwise.
    #[must_use]
    pub fn take_channel(&mut self) -> Option<OwnedFd> {
        self.channel.take()
    }

    /// Kills the program, and all in its group.
    pub fn kill(&self) {
        self.signal(Signal::KILL);
    }

    /// Stops the program and all in its group where they are, or lets them go on.
    pub fn suspend(&self, is_suspended: bool) {
        self.signal(if is_suspended {
            Signal::STOP
        } else {
            Signal::CONT
        });
    }

    fn signal(&self, signal: Signal) {
        for program in children_of(self.keeper.id()) {
            // One that has ended meanwhile is seen by its keeper.
            let _ = kill_process_group(program, signal);
        }
    }

    /// Number of the process that keeps it.
    #[must_use]
    pub fn keeper(&self) -> u32 {
        self.keeper.id()
    }

    /// Tells the program that there is no more to do, by the end of its lifeline. It is ended if it does not end.
    pub fn dismiss(&mut self) {
        self.keeper.stdin = None;
    }

    /// Sends a message. Never waits.
    ///
    /// # Errors
    /// The program is gone, or does not read.
    pub fn send(&self, message: &[u8]) -> io::Result<()> {
        let channel = self.channel.as_ref().ok_or(Errno::NOTCONN)?;
        send(channel, message, SendFlags::NOSIGNAL | SendFlags::DONTWAIT)?;
        Ok(())
    }

    /// Waits for a message, no longer than `patience`. One that is longer than the room for it is cut.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn receive(&self, message: &mut [u8], patience: Duration) -> io::Result<Received> {
        let channel = self.channel.as_ref().ok_or(Errno::NOTCONN)?;
        if !wait_ready(channel.as_fd(), PollFlags::IN, patience)? {
            return Ok(Received::Nothing);
        }
        match recv(channel, message, RecvFlags::DONTWAIT) {
            Ok((0, _)) | Err(Errno::CONNRESET | Errno::PIPE) => Ok(Received::Closed),
            Ok((length, _)) => Ok(Received::Message(length)),
            Err(errno) => Err(errno.into()),
        }
    }

    /// Waits for the end of a program that closed its end of the channel, no longer than `patience`: how it ended, after the words
    /// "the program", and the end of its output; `None` if it did not.
    pub fn ended(&mut self, patience: Duration) -> Option<(String, String)> {
        let clock = Clock::start();
        while !self.look() {
            if clock.now() >= patience {
                return None;
            }
            if let Some(told) = &self.keeper.stdout {
                // What cannot be waited for is looked at again.
                let _ = wait_ready(told.as_fd(), PollFlags::IN, LOOK.min(patience));
            }
        }
        let told = String::from_utf8_lossy(&self.told).into_owned();
        let (how, output) = told.split_once('\n').unwrap_or((&told, ""));
        Some((how.to_owned(), output.trim_end().to_owned()))
    }

    /// Whether the keeper has told all.
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
    /// Asks the program for its end, and waits for that.
    fn drop(&mut self) {
        let mut stop = Vec::new();
        Header::of(Kind::Stop).begin(&mut stop);
        // A program that is gone needs no asking.
        let _ = self.send(&stop);
        self.keeper.stdin = None;
        if self.ended(END_PATIENCE).is_none() {
            let _ = self.keeper.kill();
        }
        let _ = self.keeper.wait();
    }
}

/// A program's end of its seat: for a process of this program that plays a law.
pub struct Seat {
    channel: Channel,
    message: Vec<u8>,
    answer: Vec<u8>,
}

impl Seat {
    /// Takes the seat that the environment names.
    ///
    /// # Errors
    /// There is no such variable, or nobody listens there.
    pub fn join(name: &str) -> io::Result<Self> {
        let path = std::env::var_os(PORTS_VARIABLE).map(PathBuf::from);
        let path = path.ok_or_else(|| io::Error::other("no seat is named: runs start this"))?;
        let socket = seqpacket()?;
        connect(&socket, &SocketAddrUnix::new(path.as_path())?)?;
        let mut seat = Self {
            channel: Channel::new(socket),
            message: vec![0; MESSAGE_BYTES_MAX],
            answer: Vec::with_capacity(MESSAGE_BYTES_MAX),
        };
        write_hello(&mut seat.answer, name);
        seat.channel.send(&seat.answer)?;
        Ok(seat)
    }

    /// Waits for WELCOME: its JSON, and the seed.
    ///
    /// # Errors
    /// canrig is gone, or speaks another protocol.
    pub fn welcome(&mut self) -> io::Result<(&[u8], u64)> {
        let length = self.channel.receive(&mut self.message, None)?;
        read_welcome(&self.message[..length]).map_err(io::Error::other)
    }

    /// Plays a law, or says why there is none, until it is asked to stop.
    ///
    /// # Errors
    /// canrig speaks another protocol.
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
                return self.channel.send(&self.answer);
            }
        };
        write_done(&mut self.answer, 0, 0);
        self.channel.send(&self.answer)?;
        let (mut read, mut written) = (vec![0.0; reads], vec![0.0; writes]);
        loop {
            let length = self.channel.receive(&mut self.message, None)?;
            if length == 0 {
                return Ok(());
            }
            let message = &self.message[..length];
            let (header, body) = Header::split(message).map_err(io::Error::other)?;
            let mut values = numbers(body);
            if header.kind == Kind::Stop as u8 {
                write_done(&mut self.answer, header.number, STOPPED);
                return self.channel.send(&self.answer);
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
            self.channel.send(&self.answer)?;
        }
    }
}

fn seqpacket() -> io::Result<OwnedFd> {
    let (family, kind) = (AddressFamily::UNIX, SocketType::SEQPACKET);
    Ok(socket_with(family, kind, SocketFlags::CLOEXEC, None)?)
}

/// A seat that waits for its program: a socket in a folder that nobody else can enter.
#[derive(Debug)]
pub struct Listener {
    socket: OwnedFd,
    folder: TempDir,
}

impl Listener {
    /// Opens a seat.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn open() -> io::Result<Self> {
        let folder = tempfile::Builder::new()
            .prefix("canrig-seat-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir()?;
        let socket = seqpacket()?;
        let listener = Self { socket, folder };
        bind(&listener.socket, &SocketAddrUnix::new(listener.path())?)?;
        listen(&listener.socket, 1)?;
        Ok(listener)
    }

    /// The socket.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("socket")
    }

    /// Waits for a program of the same user; `None` if none comes in time.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn accept(&self, patience: Duration) -> io::Result<Option<OwnedFd>> {
        if !wait_ready(self.socket.as_fd(), PollFlags::IN, patience)? {
            return Ok(None);
        }
        let channel = accept_with(&self.socket, SocketFlags::CLOEXEC)?;
        let is_ours = socket_peercred(&channel)?.uid == getuid();
        Ok(is_ours.then_some(channel))
    }
}
