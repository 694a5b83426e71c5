//! Interface to a CAN bus: the operations that a participant needs, the address of a bus, and the errors.

use std::fmt;
use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use can::CanFrame;
use rustix::event::PollFlags;
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, socket_with};

use crate::clock;
use crate::probe;
use crate::wait::wait_once;

/// Longest time that [`Bus::send`] waits for room in a full queue.
pub const SEND_PATIENCE: Duration = Duration::from_millis(50);

/// CAN bus as one participant sees it. Its own frames do not come back.
pub trait Bus: Send {
    /// Sends a frame. Waits up to [`SEND_PATIENCE`] where the bus's queue is full.
    ///
    /// # Errors
    /// If the queue stays full or the bus is gone.
    fn send(&mut self, frame: &CanFrame) -> Result<(), BusError>;

    /// Returns the oldest frame that passes the filters and was not taken yet; `None` if none comes within `timeout`. With a
    /// `timeout` of zero it never waits. The kernel's error messages come as frames with [`CanFrame::is_error`] if a filter
    /// accepts them.
    ///
    /// # Errors
    /// If the bus is gone.
    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>, BusError>;

    /// Becomes readable when a frame is there.
    fn as_fd(&self) -> BorrowedFd<'_>;

    /// Number of frames that were lost because they were not received in time, as far as known.
    fn dropped(&self) -> u64;

    /// Number of frames that had to wait for room in a full queue before they were sent.
    fn delayed(&self) -> u64;

    /// Makes [`Bus::fd_frames`] count. An embedded bus carries no CAN FD, so this does nothing by default.
    fn count_fd_frames(&mut self) {}

    /// Number of CAN FD frames that passed the filters and were not received, since the bench reads classic CAN.
    fn fd_frames(&self) -> u64 {
        0
    }
}

/// Address of a bus: `can0`, `vcan0` (a SocketCAN interface), `embedded:/path/to/socket`, or `private:1234`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BusAddress {
    /// A CAN network interface.
    Interface(String),
    /// The socket of an embedded bus, see [`crate::hub`].
    Embedded(PathBuf),
    /// The private bus in the namespaces of this process, see [`crate::private_bus`].
    Private(u32),
}

/// Error in the text of an address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("\"{text}\" is not a bus: name a CAN interface such as vcan0, or embedded:/path/to/socket")]
pub struct BadAddress {
    text: String,
}

impl FromStr for BusAddress {
    type Err = BadAddress;

    fn from_str(text: &str) -> Result<Self, BadAddress> {
        let bad = || BadAddress { text: text.into() };
        if let Some(path) = text.strip_prefix("embedded:") {
            let valid = !path.is_empty();
            return valid.then(|| Self::Embedded(path.into())).ok_or_else(bad);
        }
        if let Some(process) = text.strip_prefix("private:") {
            return process.parse().map(Self::Private).map_err(|_| bad());
        }
        // The kernel's `dev_valid_name`.
        let valid = (1..=15).contains(&text.len())
            && text != "."
            && text != ".."
            && !text.contains(|c: char| c.is_whitespace() || c == '/' || c == ':' || c == '\0');
        valid.then(|| Self::Interface(text.into())).ok_or_else(bad)
    }
}

impl fmt::Display for BusAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Interface(name) => formatter.write_str(name),
            Self::Embedded(path) => write!(formatter, "embedded:{}", path.display()),
            Self::Private(process) => write!(formatter, "private:{process}"),
        }
    }
}

/// Error of a bus, with a hint for the next step.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// SocketCAN is missing, or the process has no right to it.
    #[error(transparent)]
    NoKernelCan(#[from] probe::NoKernelCan),
    /// No interface of this name.
    #[error(
        "CAN interface {name} does not exist; make a virtual one with: ip link add dev {name} type vcan && ip link set {name} up"
    )]
    NoInterface {
        /// Name that was asked for.
        name: String,
    },
    /// The interface is not for CAN.
    #[error(
        "{name} is no CAN interface; `ip -brief link show type can` and `... type vcan` list those there are"
    )]
    NotCan {
        /// Name of the interface.
        name: String,
    },
    /// The interface is not up.
    #[error(
        "CAN interface {name} is down; bring it up with: ip link set {name} up (a real one with: ip link set {name} up type can bitrate 1000000)"
    )]
    InterfaceDown {
        /// Name of the interface.
        name: String,
    },
    /// No embedded bus at this path.
    #[error("no bus is at {path}: has the run that made it ended?", path = path.display())]
    NoHub {
        /// The socket's path.
        path: PathBuf,
    },
    /// The path does not fit a socket address.
    #[error("the path {path} is too long for a socket ({length} bytes, limit {limit})", path = path.display(), length = path.as_os_str().len(), limit = PATH_BYTES_MAX)]
    PathTooLong {
        /// The path.
        path: PathBuf,
    },
    /// The embedded bus belongs to another user.
    #[error("the bus at {path} belongs to user {owner}, not to you", path = path.display())]
    ForeignHub {
        /// The socket's path.
        path: PathBuf,
        /// The other user's id.
        owner: u32,
    },
    /// The hub did not take this participant: it is full, or too busy.
    #[error("the bus at {path} did not let us join", path = path.display())]
    Refused {
        /// The socket's path.
        path: PathBuf,
    },
    /// The system's permission is missing.
    #[error("no permission to open {address}")]
    NoPermission {
        /// The bus.
        address: BusAddress,
    },
    /// The queue stayed full.
    #[error(
        "frame {frame} could not be sent within {} ms: the queue of {address} is full ({})",
        SEND_PATIENCE.as_millis(),
        why_full(address)
    )]
    NotSent {
        /// The frame.
        frame: CanFrame,
        /// The bus.
        address: BusAddress,
    },
    /// The hub of an embedded bus ended.
    #[error("the bus {address} ended")]
    Closed {
        /// The bus.
        address: BusAddress,
    },
    /// Error of the system for which no better message is known.
    #[error("{address} failed to {action}: {source}")]
    System {
        /// The bus.
        address: BusAddress,
        /// Action that failed.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
}

/// Longest path of a socket in bytes: `sun_path` less its final zero.
pub const PATH_BYTES_MAX: usize = 107;

/// Receives with `attempt` until it gives a frame or `timeout` is over.
pub(crate) fn receive_within(
    fd: BorrowedFd<'_>,
    timeout: Duration,
    attempt: impl Fn() -> Result<Option<CanFrame>, BusError>,
    failed: impl Fn(Errno) -> BusError,
) -> Result<Option<CanFrame>, BusError> {
    if let Some(frame) = attempt()? {
        return Ok(Some(frame));
    }
    if timeout.is_zero() {
        return Ok(None);
    }
    let end = clock::monotonic().saturating_add(timeout);
    let mut patience = timeout;
    while !patience.is_zero() {
        wait_once(fd, PollFlags::IN, patience).map_err(&failed)?;
        if let Some(frame) = attempt()? {
            return Ok(Some(frame));
        }
        patience = end.saturating_sub(clock::monotonic());
    }
    Ok(None)
}

/// Makes a socket for whole messages between processes. It closes on `exec`.
pub(crate) fn seqpacket(flags: SocketFlags) -> Result<OwnedFd, Errno> {
    let (family, kind) = (AddressFamily::UNIX, SocketType::SEQPACKET);
    socket_with(family, kind, SocketFlags::CLOEXEC | flags, None)
}

/// Returns a likely reason for a full queue, for the error message.
fn why_full(address: &BusAddress) -> &'static str {
    match address {
        BusAddress::Interface(_) => "is anyone else on the bus to acknowledge?",
        BusAddress::Embedded(_) | BusAddress::Private(_) => "the machine is too busy to empty it",
    }
}
