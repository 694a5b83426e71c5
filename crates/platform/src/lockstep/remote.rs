//! Coordinator's end of the channel to a node in another process.

use std::io;
use std::os::fd::OwnedFd;
use std::time::Duration;

use can::{CanFrame, Filter, FilterSet, Progress};
use rustix::io::Errno;
use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{AddressFamily, SendFlags, SocketFlags, SocketType};

use super::audience::Audience;
use super::participant::{Answer, Failure, Participant};
use super::protocol::{self, Asked, FRAMES_MAX, Hello, Setting};
use super::step::{StepError, TICKS_PER_INSTANT_MAX};
use crate::seat::{MESSAGE_BYTES_MAX, receive_packet};
use crate::stop::{is_requested, patience_left};

/// Longest wall time for a process to answer.
pub const ANSWER_PATIENCE: Duration = Duration::from_secs(10);
/// Length of one wait for an answer. A standstill of the machine takes one such wait of the patience.
const WAIT: Duration = Duration::from_millis(100);

/// Makes a side channel: the coordinator's end and the process's end. Both close on `exec`; the second one becomes the standard
/// input of the process. Drop it once the process is started, or its death goes unnoticed.
///
/// # Errors
/// If the system refuses the socket pair.
pub fn channel() -> io::Result<(OwnedFd, OwnedFd)> {
    Ok(rustix::net::socketpair(
        AddressFamily::UNIX,
        SocketType::SEQPACKET,
        SocketFlags::CLOEXEC,
        None,
    )?)
}

/// Node in another process, at a bus seat.
#[derive(Debug)]
pub struct Remote {
    name: String,
    channel: OwnedFd,
    /// Longest wall time for an answer; no limit if `None`.
    patience: Option<Duration>,
    setting: Setting,
    hello: Hello,
    /// Frames of the node that no participant answers.
    quiet: FilterSet,
    /// Time that it has reached, and how often in a row it was asked there.
    reached: (Duration, u32),
    number: u32,
    is_welcome: bool,
    was_halted: bool,
    packet: Vec<u8>,
}

impl Remote {
    /// Waits for the process at the other end to introduce itself; `name` is for messages. Each answer may take as long as
    /// `patience`, without limit if it is `None`.
    ///
    /// # Errors
    /// If it does not, is gone, or speaks another protocol.
    pub fn accept(
        name: impl Into<String>,
        channel: OwnedFd,
        patience: Option<Duration>,
        setting: Setting,
    ) -> Result<Self, Failure> {
        let mut remote = Self {
            name: name.into(),
            channel,
            patience,
            setting,
            hello: Hello::default(),
            quiet: Vec::new().into(),
            reached: (setting.now, 0),
            number: 0,
            is_welcome: false,
            was_halted: false,
            packet: Vec::with_capacity(MESSAGE_BYTES_MAX),
        };
        set_socket_timeout(&remote.channel, Timeout::Recv, Some(WAIT))
            .map_err(|errno| remote.failed(errno))?;
        remote.receive()?;
        remote.hello = protocol::decode_hello(&remote.packet)?;
        Ok(remote)
    }

    /// Tells the process, with the next question, that it was halted until then.
    pub fn was_halted(&mut self) {
        self.was_halted = true;
    }

    fn welcome(&mut self, quiet: &[Filter]) -> Result<(), Failure> {
        self.is_welcome = true;
        protocol::encode_welcome(&mut self.packet, &self.setting, quiet)?;
        self.send()
    }

    /// Asks for an answer to GRANT, or to STOP if `frames` is `None`.
    fn ask(
        &mut self,
        (to, until): (Duration, Duration),
        frames: Option<&[(Duration, CanFrame)]>,
        answer: &mut Answer,
    ) -> Result<(), Failure> {
        if !self.is_welcome {
            self.welcome(&[])?;
        }
        self.number = self.number.wrapping_add(1);
        let asked = Asked {
            number: self.number,
            from: self.reached.0,
            to,
            until,
            was_halted: std::mem::take(&mut self.was_halted),
        };
        match frames {
            Some(frames) => protocol::encode_grant(&mut self.packet, &asked, frames)?,
            None => protocol::encode_stop(&mut self.packet, &asked),
        }
        self.send()?;
        self.receive()?;
        protocol::decode_done(&self.packet, &asked, &self.quiet, answer)?;
        let (before, times) = self.reached;
        let times = if answer.reached == before {
            times + 1
        } else {
            0
        };
        self.reached = (answer.reached, times);
        Ok(())
    }

    /// Sends the packet. Only one at a time is under way and it is smaller than the socket's buffer, so this never waits.
    fn send(&self) -> Result<(), Failure> {
        let flags = SendFlags::NOSIGNAL | SendFlags::DONTWAIT;
        let sent = rustix::net::send(&self.channel, &self.packet, flags);
        sent.map(drop).map_err(|errno| self.failed(errno))
    }

    fn receive(&mut self) -> Result<(), Failure> {
        let mut left = self.patience;
        loop {
            left = patience_left(left);
            match receive_packet(&self.channel, &mut self.packet) {
                Ok(()) if self.packet.is_empty() => return Err(Failure::Ended),
                Ok(()) => return Ok(()),
                Err(Errno::AGAIN) if left != Some(Duration::ZERO) => {
                    left = left.map(|left| left.saturating_sub(WAIT));
                }
                Err(errno) => return Err(self.failed(errno)),
            }
        }
    }

    fn failed(&self, errno: Errno) -> Failure {
        match errno {
            Errno::AGAIN if is_requested() => Failure::Interrupted,
            Errno::AGAIN => Failure::NoAnswer(self.patience.unwrap_or_default()),
            Errno::PIPE | Errno::CONNRESET => Failure::Ended,
            errno => Failure::Channel(errno.into()),
        }
    }
}

impl Participant for Remote {
    fn name(&self) -> &str {
        &self.name
    }

    fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Ignores an error: WELCOME has no answer, and a channel that fails now fails at the first step too.
    fn meet(&mut self, audience: &Audience) {
        let quiet = audience.quiet();
        let _ = self.welcome(&quiet);
        self.quiet = quiet.into();
    }

    fn advance(
        &mut self,
        to: Duration,
        until: Duration,
        frames: &[(Duration, CanFrame)],
        answer: &mut Answer,
    ) -> Result<(), Failure> {
        let (mut rest, mut queued) = (frames, Vec::new());
        while let Some((part, later)) = rest.split_at_checked(FRAMES_MAX)
            && let (Some((last, _)), false) = (part.last(), later.is_empty())
        {
            self.ask((*last, *last), Some(part), answer)?;
            queued.append(&mut answer.frames);
            rest = later;
            if answer.progress != Progress::Running {
                answer.frames = queued;
                return Ok(());
            }
        }
        self.ask((to, until), Some(rest), answer)?;
        if !queued.is_empty() {
            queued.append(&mut answer.frames);
            answer.frames = queued;
        }
        let (at, times) = self.reached;
        // A node whose deadline does not move.
        if times > TICKS_PER_INSTANT_MAX {
            return Err(StepError::stuck(at).into());
        }
        Ok(())
    }

    fn stop(&mut self, at: Duration, answer: &mut Answer) -> Result<(), Failure> {
        self.ask((at, at), None, answer)
    }
}
