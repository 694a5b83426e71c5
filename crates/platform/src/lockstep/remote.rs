//! The coordinator's end of the side channel to a process.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::time::Duration;

use canopen::{CanFrame, Filter};
use rustix::io::Errno;
use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType};

use super::answer::Answer;
use super::audience::Audience;
use super::error::LockstepError;
use super::participant::Participant;
use super::protocol::{self, PACKET_MAX, ProtocolError};

/// How long a process may take to answer, in wall time.
pub const ANSWER_PATIENCE: Duration = Duration::from_secs(10);

/// A side channel: the coordinator's end and the process's end. Both close on `exec`; `process::child` hands the second
/// one on. Drop the process's end once it is handed on, or its death goes unnoticed.
///
/// # Errors
/// When the system refuses the socket pair.
pub fn channel() -> io::Result<(OwnedFd, OwnedFd)> {
    Ok(rustix::net::socketpair(
        AddressFamily::UNIX,
        SocketType::SEQPACKET,
        SocketFlags::CLOEXEC,
        None,
    )?)
}

/// A node in another process, which runs [`super::follow`].
pub struct Remote {
    name: String,
    channel: OwnedFd,
    patience: Duration,
    filters: Vec<Filter>,
    silent_filters: Vec<Filter>,
    next_deadline: Option<Duration>,
    packet: Vec<u8>,
}

/// What went wrong on the channel, not yet with the participant's name.
enum Failure {
    Protocol(ProtocolError),
    Channel(Errno),
}

impl Remote {
    /// Waits for the process at the other end to introduce itself; `name` is for messages.
    ///
    /// # Errors
    /// When it does not within [`ANSWER_PATIENCE`], is gone, or speaks another protocol.
    pub fn accept(name: impl Into<String>, channel: OwnedFd) -> Result<Self, LockstepError> {
        Self::accept_within(name, channel, ANSWER_PATIENCE)
    }

    /// As [`Remote::accept`] with another patience, for the introduction and for every answer.
    ///
    /// # Errors
    /// As [`Remote::accept`].
    pub fn accept_within(
        name: impl Into<String>,
        channel: OwnedFd,
        patience: Duration,
    ) -> Result<Self, LockstepError> {
        let mut remote = Self {
            name: name.into(),
            channel,
            patience,
            filters: Vec::new(),
            silent_filters: Vec::new(),
            next_deadline: None,
            packet: Vec::with_capacity(PACKET_MAX),
        };
        set_socket_timeout(&remote.channel, Timeout::Recv, Some(patience))
            .map_err(|errno| remote.error(Failure::Channel(errno)))?;
        remote.receive()?;
        let hello = protocol::decode_hello(&remote.packet)
            .map_err(|error| remote.error(Failure::Protocol(error)))?;
        remote.filters = hello.filters;
        remote.silent_filters = hello.silent_filters;
        remote.next_deadline = hello.next_deadline;
        Ok(remote)
    }

    /// Sends what an encoder wrote to the packet.
    fn send(&mut self, encoded: Result<(), ProtocolError>) -> Result<(), LockstepError> {
        encoded.map_err(|error| self.error(Failure::Protocol(error)))?;
        // One packet at a time is under way and it is smaller than the socket's buffer, so this never waits.
        let flags = SendFlags::NOSIGNAL | SendFlags::DONTWAIT;
        let sent = rustix::net::send(&self.channel, &self.packet, flags);
        sent.map(drop)
            .map_err(|errno| self.error(Failure::Channel(errno)))
    }

    fn read_answer(&mut self, answer: &mut Answer) -> Result<(), LockstepError> {
        self.receive()?;
        protocol::decode_done(&self.packet, answer)
            .map_err(|error| self.error(Failure::Protocol(error)))?;
        self.next_deadline = answer.next_deadline;
        Ok(())
    }

    fn receive(&mut self) -> Result<(), LockstepError> {
        receive_packet(&self.channel, &mut self.packet)
            .map_err(|errno| self.error(Failure::Channel(errno)))?;
        if self.packet.is_empty() {
            return Err(self.error(Failure::Channel(Errno::PIPE)));
        }
        Ok(())
    }

    fn error(&self, failure: Failure) -> LockstepError {
        let name = self.name.clone();
        match failure {
            Failure::Protocol(source) => LockstepError::Protocol { name, source },
            Failure::Channel(Errno::AGAIN) => LockstepError::NoAnswer {
                name,
                patience: self.patience,
            },
            Failure::Channel(Errno::PIPE | Errno::CONNRESET) => LockstepError::Ended { name },
            Failure::Channel(errno) => LockstepError::Channel {
                name,
                source: errno.into(),
            },
        }
    }
}

impl Participant for Remote {
    fn name(&self) -> &str {
        &self.name
    }

    fn filters(&self) -> &[Filter] {
        &self.filters
    }

    fn next_deadline(&self) -> Option<Duration> {
        self.next_deadline
    }

    fn silent_filters(&self) -> &[Filter] {
        &self.silent_filters
    }

    /// Nothing is answered to it; a channel that fails now fails at the first step too.
    fn meet(&mut self, audience: &Audience) {
        let encoded = protocol::encode_audience(&mut self.packet, audience);
        let _ = self.send(encoded);
    }

    fn advance(
        &mut self,
        to: Duration,
        until: Duration,
        frames: &[(Duration, CanFrame)],
        answer: &mut Answer,
    ) -> Result<(), LockstepError> {
        let encoded = protocol::encode_advance(&mut self.packet, to, until, frames);
        self.send(encoded)?;
        self.read_answer(answer)
    }

    fn stop(&mut self, at: Duration, answer: &mut Answer) -> Result<(), LockstepError> {
        let encoded = protocol::encode_stop(&mut self.packet, at);
        self.send(encoded)?;
        self.read_answer(answer)
    }
}

/// Receives one packet over `packet`; empty when the other end is closed.
pub(super) fn receive_packet(channel: impl AsFd, packet: &mut Vec<u8>) -> Result<(), Errno> {
    packet.clear();
    loop {
        let spare = rustix::buffer::spare_capacity(packet);
        match rustix::net::recv(channel.as_fd(), spare, RecvFlags::empty()) {
            Ok(_) => return Ok(()),
            Err(Errno::INTR) => {}
            Err(errno) => return Err(errno),
        }
    }
}
