//! Process's end of the side channel.

use std::io;
use std::os::fd::OwnedFd;
use std::time::Duration;

use can::{CanFrame, Node, Progress};
use rustix::io::Errno;
use rustix::net::SendFlags;

use super::participant::Answer;
use super::protocol::{self, FRAMES_MAX, Hello, Request};

use super::step::Stepper;
use crate::bus::{Bus, BusError};
use crate::clock::Clock;
use crate::seat::{MESSAGE_BYTES_MAX, Misread, receive_packet};

/// Longest wall time for an announced frame to arrive on the wire.
pub const WIRE_PATIENCE: Duration = Duration::from_secs(10);

/// Reason why a process stopped following its coordinator.
#[derive(Debug, thiserror::Error)]
pub enum FollowError {
    /// The coordinator closed the side channel before the node had stopped.
    #[error("the coordinator ended before the node had stopped")]
    CoordinatorGone,
    /// The coordinator sent a packet that breaks the protocol.
    #[error("the coordinator sent bytes that are not a message of lock-step: {0}")]
    Protocol(#[from] Misread),
    /// The wire did not carry the frame that the coordinator announced.
    #[error("frame {announced} was announced but {found}")]
    Wire {
        /// Frame that the coordinator announced.
        announced: CanFrame,
        /// Frame or silence in its place.
        found: String,
    },
    /// The wire failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The node itself gave up.
    #[error("{0}")]
    Node(String),
    /// The side channel failed.
    #[error("the side channel failed: {0}")]
    Channel(#[from] io::Error),
}

/// Steps `node` as the coordinator at the other end of `channel` asks, until the node has stopped.
///
/// With a `wire`, every announced frame is received from it, and the node gets the wire's copy. The wire must be opened with the
/// node's filters as it is configured, and without its own frames. The coordinator puts the frames on it.
///
/// # Errors
/// If the coordinator is gone or breaks the protocol, if the wire does not carry the announced frames, or if the node fails or
/// cannot be stepped. The coordinator receives the last two; for the others it sees the channel close when the process ends.
pub fn follow(
    node: &mut dyn Node,
    channel: OwnedFd,
    wire: Option<&mut dyn Bus>,
) -> Result<(), FollowError> {
    Follower {
        wire: wire.map(|bus| Wire::new(bus, node)),
        stepper: Stepper::new(node),
        channel,
        packet: Vec::with_capacity(MESSAGE_BYTES_MAX),
        delivered: Vec::with_capacity(FRAMES_MAX),
        answer: Answer {
            frames: Vec::with_capacity(FRAMES_MAX),
            ..Answer::default()
        },
    }
    .run(node)
}

struct Follower<'a> {
    channel: OwnedFd,
    wire: Option<Wire<'a>>,
    stepper: Stepper,
    packet: Vec<u8>,
    delivered: Vec<(Duration, CanFrame)>,
    answer: Answer,
}

impl Follower<'_> {
    fn run(&mut self, node: &mut dyn Node) -> Result<(), FollowError> {
        protocol::encode_hello(&mut self.packet, &Hello::of(node))?;
        self.send()?;
        self.receive()?;
        let quiet = protocol::decode_welcome(&self.packet)?;
        self.stepper.meet(quiet.into());
        loop {
            self.receive()?;
            let (number, request) = protocol::decode_request(&self.packet, &mut self.delivered)?;
            self.serve(node, &request)?;
            protocol::encode_done(&mut self.packet, number, &self.answer)?;
            self.send()?;
            match &self.answer.progress {
                Progress::Running => {}
                Progress::Stopped => return Ok(()),
                Progress::Failed(text) => return Err(FollowError::Node(text.clone())),
            }
        }
    }

    /// Carries out the request and writes the answer. An impossible step is a failure of the node; a wrong frame on the wire is not.
    fn serve(&mut self, node: &mut dyn Node, request: &Request) -> Result<(), FollowError> {
        let stepped = match *request {
            Request::Grant { to, until } => {
                if let Some(wire) = &mut self.wire {
                    wire.replace_with_copies(&mut self.delivered)?;
                }
                let times = (to, until);
                self.stepper
                    .advance(node, times, &self.delivered, &mut self.answer)
            }
            Request::Stop { at } => self.stepper.stop(node, at, &mut self.answer),
        };
        if let Err(error) = stepped {
            self.answer.frames.clear();
            self.answer.progress = Progress::Failed(error.to_string());
        }
        if let Some(wire) = &mut self.wire {
            wire.expect_echoes(&self.answer.frames);
        }
        Ok(())
    }

    fn send(&self) -> Result<(), FollowError> {
        match rustix::net::send(&self.channel, &self.packet, SendFlags::NOSIGNAL) {
            Ok(_) => Ok(()),
            Err(Errno::PIPE | Errno::CONNRESET) => Err(FollowError::CoordinatorGone),
            Err(errno) => Err(FollowError::Channel(errno.into())),
        }
    }

    fn receive(&mut self) -> Result<(), FollowError> {
        match receive_packet(&self.channel, &mut self.packet) {
            Ok(()) if self.packet.is_empty() => Err(FollowError::CoordinatorGone),
            Ok(()) => Ok(()),
            Err(errno) => Err(FollowError::Channel(errno.into())),
        }
    }
}

/// Real bus that carries the announced frames.
struct Wire<'a> {
    bus: &'a mut dyn Bus,
    filters: Vec<can::Filter>,
    /// Frames of this node that its own filters accept. The coordinator puts them on the wire, so they come back here, but are
    /// not delivered. The oldest are forgotten, since a fault may keep a frame off the wire.
    echoes: Vec<CanFrame>,
}

impl<'a> Wire<'a> {
    fn new(bus: &'a mut dyn Bus, node: &dyn Node) -> Self {
        Self {
            bus,
            filters: node.filters_as_configured(),
            echoes: Vec::with_capacity(FRAMES_MAX),
        }
    }

    /// Receives each announced frame and replaces it with the wire's copy.
    fn replace_with_copies(
        &mut self,
        announced: &mut [(Duration, CanFrame)],
    ) -> Result<(), FollowError> {
        announced
            .iter_mut()
            .try_for_each(|(_, frame)| self.receive(*frame).map(|copy| *frame = copy))
    }

    fn receive(&mut self, announced: CanFrame) -> Result<CanFrame, FollowError> {
        // Usually the first frame is the right one, so no clock is needed.
        let mut clock: Option<Clock> = None;
        loop {
            let waited = clock.map_or(Duration::ZERO, |clock| clock.now());
            let patience = WIRE_PATIENCE.saturating_sub(waited);
            let Some(arrived) = self.bus.receive(patience)? else {
                let seconds = WIRE_PATIENCE.as_secs();
                let found = format!("nothing arrived within {seconds} s");
                return Err(FollowError::Wire { announced, found });
            };
            if arrived == announced {
                return Ok(arrived);
            }
            if let Some(index) = self.echoes.iter().position(|echo| *echo == arrived) {
                self.echoes.remove(index);
                continue;
            }
            clock.get_or_insert_with(Clock::start);
            if !arrived.is_error() {
                let found = format!("{arrived} arrived: is another program sending on this bus?");
                return Err(FollowError::Wire { announced, found });
            }
        }
    }

    /// Remembers the frames that will come back.
    fn expect_echoes(&mut self, queued: &[(Duration, CanFrame)]) {
        for (_, frame) in queued {
            if self.filters.iter().any(|filter| filter.accepts(frame)) {
                if self.echoes.len() == FRAMES_MAX {
                    self.echoes.remove(0);
                }
                self.echoes.push(*frame);
            }
        }
    }
}
