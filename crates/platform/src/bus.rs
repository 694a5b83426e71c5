//! Interface to a CAN bus: the operations that a participant needs, the address of a bus, and the errors.

use std::fmt;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use can::CanFrame;
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, socket_with};

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

impl FromStr for BusAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || {
            format!(
                "\"{text}\" is not a bus: name a CAN interface such as vcan0, or embedded:/path/to/socket"
            )
        };
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
#[error("{0}")]
pub struct BusError(pub(crate) String);

impl BusError {
    /// Returns the error for a missing interface.
    pub(crate) fn no_interface(name: &str) -> Self {
        Self(format!(
            "CAN interface {name} does not exist; make a virtual one with: ip link add dev {name} type vcan && ip link set {name} up"
        ))
    }

    /// Returns the error for an interface that is not up.
    pub(crate) fn interface_down(name: &str) -> Self {
        Self(format!(
            "CAN interface {name} is down; bring it up with: ip link set {name} up (a real one with: ip link set {name} up type can bitrate 1000000)"
        ))
    }

    /// Returns the error for a missing permission of the system.
    pub(crate) fn no_permission(address: &BusAddress) -> Self {
        Self(format!("no permission to open {address}"))
    }

    /// Returns the error for a queue that stayed full, with a likely reason.
    pub(crate) fn not_sent(address: &BusAddress, frame: &CanFrame) -> Self {
        let why = match address {
            BusAddress::Interface(_) => "is anyone else on the bus to acknowledge?",
            _ => "the machine is too busy to empty it",
        };
        let patience = SEND_PATIENCE.as_millis();
        Self(format!(
            "frame {frame} could not be sent within {patience} ms: the queue of {address} is full ({why})"
        ))
    }

    /// Returns an error of the system for which no better message is known.
    pub(crate) fn system(address: &BusAddress, action: &str, source: impl fmt::Display) -> Self {
        Self(format!("{address} failed to {action}: {source}"))
    }
}

/// Longest path of a socket in bytes: `sun_path` less its final zero.
pub(crate) const PATH_BYTES_MAX: usize = 107;

/// Makes a socket for whole messages between processes. It closes on `exec`.
pub(crate) fn seqpacket(flags: SocketFlags) -> Result<OwnedFd, Errno> {
    let (family, kind) = (AddressFamily::UNIX, SocketType::SEQPACKET);
    socket_with(family, kind, SocketFlags::CLOEXEC | flags, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_an_interface_that_the_kernel_can_have_or_a_socket() {
        for good in [
            "can0",
            "vcan_15_letters",
            "embedded:/run/x/socket",
            "private:7",
        ] {
            let address = good.parse::<BusAddress>();
            assert_eq!(address.unwrap().to_string(), good);
        }
        for bad in [
            "",
            ".",
            "..",
            "vcan_of_16_chars",
            "can 0",
            "a/b",
            "can:0",
            "embedded:",
            "private:x",
        ] {
            let said = bad.parse::<BusAddress>().unwrap_err();
            assert!(
                said.starts_with(&format!("\"{bad}\" is not a bus: ")),
                "{said}"
            );
        }
    }
}
