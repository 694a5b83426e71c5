//! Bus of the kernel (SocketCAN), virtual or on real hardware.

use std::cell::Cell;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use can::frame::ERROR_FLAG;
use can::{CanFrame, Filter};
use rustix::event::PollFlags;
use rustix::io::Errno;
use rustix::net::{RecvFlags, SendFlags};
use socketcan::{CanFilter, CanSocket, Socket, SocketOptions};

use crate::bus::{Bus, BusAddress, BusError, SEND_PATIENCE, receive_within};
use crate::clock::{self, Clock};
use crate::kernel_format::{decode_frame, encode_frame};
use crate::link::link;
use crate::probe;
use crate::wait::wait_ready;

/// Time between two attempts to send into a full queue: about one frame at 1 Mbit/s.
const SEND_RETRY: Duration = Duration::from_micros(100);

/// Index of the drop counter in the answer to `SO_MEMINFO` (`SK_MEMINFO_DROPS`).
const MEMINFO_DROPS: usize = 8;

/// Bytes of the kernel's `struct canfd_frame`.
const FD_FRAME_BYTES: usize = 72;

/// Socket of one participant on a CAN interface.
pub(crate) struct SocketCanBus {
    name: String,
    socket: CanSocket,
    delayed: u64,
    fd_frames: Cell<u64>,
}

impl SocketCanBus {
    /// Opens the interface with the kernel's receive filters.
    ///
    /// # Errors
    /// With a message that names the missing part and a remedy.
    pub(crate) fn open(name: &str, filters: &[Filter]) -> Result<Self, BusError> {
        Self::on_socket(name, open_socket(name)?, filters)
    }

    /// As [`SocketCanBus::open`] with an open socket.
    pub(crate) fn on_socket(
        name: &str,
        socket: CanSocket,
        filters: &[Filter],
    ) -> Result<Self, BusError> {
        let bus = Self {
            name: name.into(),
            socket,
            delayed: 0,
            fd_frames: Cell::new(0),
        };
        set_filters(&bus.socket, filters)
            .map_err(|error| system(name, "set its filters", error))?;
        // Frames that came between the opening and the filters are discarded.
        while bus.try_receive()?.is_some() {}
        Ok(bus)
    }

    fn try_receive(&self) -> Result<Option<CanFrame>, BusError> {
        let mut bytes = [0; FD_FRAME_BYTES];
        loop {
            match rustix::net::recv(&self.socket, &mut bytes, RecvFlags::DONTWAIT) {
                Ok((_, FD_FRAME_BYTES)) => self.fd_frames.set(self.fd_frames.get() + 1),
                // Everything else is a classical frame; the kernel checks the length.
                Ok((_, length)) => {
                    if let Some(frame) = decode_frame(bytes.get(..length).unwrap_or_default()) {
                        return Ok(Some(frame));
                    }
                }
                Err(Errno::AGAIN) => return Ok(None),
                Err(Errno::INTR) => {}
                Err(errno) => return Err(self.failed("receive", errno)),
            }
        }
    }

    fn address(&self) -> BusAddress {
        BusAddress::Interface(self.name.clone())
    }

    fn failed(&self, action: &'static str, errno: Errno) -> BusError {
        match errno {
            Errno::NETDOWN => BusError::InterfaceDown {
                name: self.name.clone(),
            },
            Errno::NODEV | Errno::NXIO => BusError::NoInterface {
                name: self.name.clone(),
            },
            errno => system(&self.name, action, errno.into()),
        }
    }
}

impl Bus for SocketCanBus {
    fn send(&mut self, frame: &CanFrame) -> Result<(), BusError> {
        let bytes = encode_frame(frame);
        // Where reading a clock is a system call, as in user-mode Linux, it costs as much as the frame.
        let mut clock = None;
        loop {
            let full = match rustix::net::send(&self.socket, &bytes, SendFlags::DONTWAIT) {
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => continue,
                Err(full @ (Errno::NOBUFS | Errno::AGAIN)) => full,
                Err(errno) => return Err(self.failed("send", errno)),
            };
            self.delayed += u64::from(clock.is_none());
            let patience =
                SEND_PATIENCE.saturating_sub(clock.get_or_insert_with(Clock::start).now());
            if patience.is_zero() {
                return Err(BusError::NotSent {
                    frame: *frame,
                    address: self.address(),
                });
            }
            // ENOBUFS is the device's queue, which poll does not see: it would call the socket writable.
            if full == Errno::NOBUFS {
                clock::sleep(SEND_RETRY);
            } else {
                wait_ready(self.socket.as_fd(), PollFlags::OUT, patience)
                    .map_err(|errno| self.failed("send", errno))?;
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

    fn dropped(&self) -> u64 {
        kernel_drops(&self.socket)
    }

    fn delayed(&self) -> u64 {
        self.delayed
    }

    fn count_fd_frames(&mut self) {
        // A kernel without CAN FD refuses the option; then none are counted.
        let option = libc::CAN_RAW_FD_FRAMES;
        let _ = self
            .socket
            .set_socket_option_int(libc::SOL_CAN_RAW, option, 1);
    }

    fn fd_frames(&self) -> u64 {
        self.fd_frames.get()
    }
}

/// Opens an unfiltered socket on an interface, after a check of the system's support.
pub(crate) fn open_socket(name: &str) -> Result<CanSocket, BusError> {
    probe::kernel_can()?;
    check_interface(name)?;
    CanSocket::open(name).map_err(|error| match error.kind() {
        io::ErrorKind::PermissionDenied => BusError::NoPermission {
            address: BusAddress::Interface(name.into()),
        },
        _ => system(name, "open", error),
    })
}

/// Checks that there is an interface of this name, for CAN and up.
fn check_interface(name: &str) -> Result<(), BusError> {
    let link = link(name).map_err(|error| match error.raw_os_error() {
        Some(libc::ENODEV) => BusError::NoInterface { name: name.into() },
        _ => system(name, "open", error),
    })?;
    if !link.is_can {
        return Err(BusError::NotCan { name: name.into() });
    }
    if !link.is_up {
        return Err(BusError::InterfaceDown { name: name.into() });
    }
    Ok(())
}

fn system(name: &str, action: &'static str, source: io::Error) -> BusError {
    BusError::System {
        address: BusAddress::Interface(name.into()),
        action,
        source,
    }
}

/// Sets the kernel's receive filters. The kernel reads the error flag in an identifier as an inversion of the filter, which our
/// filters do not have.
fn set_filters(socket: &CanSocket, filters: &[Filter]) -> io::Result<()> {
    if filters.is_empty() {
        return socket.set_filter_drop_all();
    }
    let filters: Vec<CanFilter> = filters
        .iter()
        .map(|filter| CanFilter::new(filter.id & !ERROR_FLAG, filter.mask))
        .collect();
    socket.set_filters(&filters)
}

/// Returns the number of frames that the kernel discarded because the socket's buffer was full; 0 if the kernel does not say.
pub(crate) fn kernel_drops(socket: &impl SocketOptions) -> u64 {
    let mut bytes = [0; 64];
    let length = socket
        .get_socket_option_bytes(libc::SOL_SOCKET, libc::SO_MEMINFO, &mut bytes)
        .unwrap_or(0);
    let (words, _) = bytes[..length.min(64)].as_chunks::<4>();
    words
        .get(MEMINFO_DROPS)
        .map_or(0, |word| u64::from(u32::from_ne_bytes(*word)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interfaces_are_distinguished() {
        let missing = check_interface("no-such-one");
        assert!(matches!(missing, Err(BusError::NoInterface { .. })));
        let loopback = check_interface("lo");
        assert!(matches!(loopback, Err(BusError::NotCan { .. })));
    }
}
