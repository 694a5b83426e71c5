//! A participant of the embedded bus, see [`crate::hub`].

use std::cell::Cell;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::time::Duration;

use can::frame::ERROR_FLAG;
use can::{CanFrame, Filter};
use rustix::event::PollFlags;
use rustix::io::Errno;
use rustix::net::sockopt::socket_peercred;
use rustix::net::{RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, connect};

use crate::bus::{Bus, BusAddress, BusError, SEND_PATIENCE, receive_within, seqpacket};
use crate::hub;
use crate::kernel_format::{FRAME_BYTES, decode_frame, encode_filters, encode_frame};
use crate::wait::wait_ready;

/// Longest time that the hub may take to let a participant join.
const JOIN_PATIENCE: Duration = Duration::from_secs(5);

/// Filter that no frame passes, for a participant without filters: it accepts error messages of no kind. An empty packet
/// would read as the end of the connection.
const NOTHING: Filter = Filter {
    id: 0,
    mask: ERROR_FLAG,
};

/// Connection of one participant to a hub.
pub(crate) struct EmbeddedBus {
    path: PathBuf,
    socket: OwnedFd,
    dropped: Cell<u64>,
    delayed: u64,
}

impl EmbeddedBus {
    /// Joins the bus at `path`. When this returns, the hub knows the filters.
    ///
    /// # Errors
    /// If no hub of this user is there, or it does not let us join within 5 s.
    pub(crate) fn open(path: &Path, filters: &[Filter]) -> Result<Self, BusError> {
        let bus = Self {
            path: path.into(),
            socket: connect_to(path)?,
            dropped: Cell::new(0),
            delayed: 0,
        };
        bus.check_owner()?;
        bus.join(filters)?;
        Ok(bus)
    }

    /// Refuses a hub of another user, which could feed us any frame.
    fn check_owner(&self) -> Result<(), BusError> {
        let owner = socket_peercred(&self.socket)
            .map_err(|errno| self.failed("ask for its owner", errno))?
            .uid;
        if owner == rustix::process::geteuid() {
            return Ok(());
        }
        Err(BusError::ForeignHub {
            path: self.path.clone(),
            owner: owner.as_raw(),
        })
    }

    fn join(&self, filters: &[Filter]) -> Result<(), BusError> {
        let filters = if filters.is_empty() {
            &[NOTHING]
        } else {
            filters
        };
        let refused = || BusError::Refused {
            path: self.path.clone(),
        };
        rustix::net::send(&self.socket, &encode_filters(filters), SendFlags::NOSIGNAL)
            .map_err(|_| refused())?;
        let answered = wait_ready(self.socket.as_fd(), PollFlags::IN, JOIN_PATIENCE)
            .map_err(|errno| self.failed("join", errno))?;
        let mut bytes = [0; FRAME_BYTES];
        let answer = rustix::net::recv(&self.socket, &mut bytes, RecvFlags::DONTWAIT);
        match answer {
            Ok((_, length)) if answered && decode_notice(&bytes[..length]).is_some() => Ok(()),
            _ => Err(refused()),
        }
    }

    fn try_receive(&self) -> Result<Option<CanFrame>, BusError> {
        let mut bytes = [0; FRAME_BYTES];
        loop {
            match rustix::net::recv(&self.socket, &mut bytes, RecvFlags::DONTWAIT) {
                Ok((_, 0)) | Err(Errno::CONNRESET) => return Err(self.closed()),
                Ok((_, length)) => {
                    if let Some(frame) = decode_frame(&bytes[..length]) {
                        return Ok(Some(frame));
                    }
                    if let Some(dropped) = decode_notice(&bytes[..length]) {
                        self.dropped.set(dropped);
                    }
                }
                Err(Errno::AGAIN) => return Ok(None),
                Err(Errno::INTR) => {}
                Err(errno) => return Err(self.failed("receive", errno)),
            }
        }
    }

    /// Returns the error for a hub that is gone. The socket of a killed hub still exists; it is removed here.
    fn closed(&self) -> BusError {
        hub::remove_silent(&self.path);
        BusError::Closed {
            address: self.address(),
        }
    }

    fn address(&self) -> BusAddress {
        BusAddress::Embedded(self.path.clone())
    }

    fn failed(&self, action: &'static str, errno: Errno) -> BusError {
        BusError::System {
            address: self.address(),
            action,
            source: errno.into(),
        }
    }
}

impl Bus for EmbeddedBus {
    fn send(&mut self, frame: &CanFrame) -> Result<(), BusError> {
        let bytes = encode_frame(frame);
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        loop {
            match rustix::net::send(&self.socket, &bytes, flags) {
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => {}
                Err(Errno::PIPE | Errno::CONNRESET) => return Err(self.closed()),
                Err(Errno::AGAIN) => {
                    self.delayed += 1;
                    let ready = wait_ready(self.socket.as_fd(), PollFlags::OUT, SEND_PATIENCE)
                        .map_err(|errno| self.failed("send", errno))?;
                    if !ready {
                        return Err(BusError::NotSent {
                            frame: *frame,
                            address: self.address(),
                        });
                    }
                }
                Err(errno) => return Err(self.failed("send", errno)),
            }
        }
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>, BusError> {
        let attempt = || self.try_receive();
        receive_within(self.as_fd(), timeout, attempt, |errno| {
            self.failed("receive", errno)
        })
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    /// Number that the hub reported last. It reports before the first frame after a loss.
    fn dropped(&self) -> u64 {
        self.dropped.get()
    }

    fn delayed(&self) -> u64 {
        self.delayed
    }
}

/// Returns the number of lost frames in a notice of the hub; `None` if the packet is none.
fn decode_notice(packet: &[u8]) -> Option<u64> {
    packet.try_into().ok().map(u64::from_ne_bytes)
}

/// Returns a socket that is connected to the hub at `path`.
fn connect_to(path: &Path) -> Result<OwnedFd, BusError> {
    let address =
        SocketAddrUnix::new(path).map_err(|_| BusError::PathTooLong { path: path.into() })?;
    let failed = |errno| match errno {
        Errno::NOENT | Errno::CONNREFUSED | Errno::NOTDIR => BusError::NoHub { path: path.into() },
        Errno::ACCESS | Errno::PERM => BusError::NoPermission {
            address: BusAddress::Embedded(path.into()),
        },
        errno => BusError::System {
            address: BusAddress::Embedded(path.into()),
            action: "open",
            source: errno.into(),
        },
    };
    let socket = seqpacket(SocketFlags::empty()).map_err(failed)?;
    connect(&socket, &address).map_err(failed)?;
    Ok(socket)
}
