//! Bus through a socket for the kernel's `struct can_frame`: that of a CAN interface (SocketCAN), virtual or on real hardware, or
//! that of an embedded bus, see [`crate::hub`].

use std::cell::Cell;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use can::frame::ERROR_FLAG;
use can::{CanFrame, Filter};
use rustix::event::PollFlags;
use rustix::io::Errno;
use rustix::net::sockopt::socket_peercred;
use rustix::net::{RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, connect, recv, send};
use socketcan::{CanFilter, CanSocket, Socket, SocketOptions};

use crate::bus::{Bus, BusAddress, BusError, PATH_BYTES_MAX, SEND_PATIENCE, seqpacket};
use crate::clock::{Clock, monotonic, sleep};
use crate::kernel_format::{FRAME_BYTES, decode_frame, encode_filters, encode_frame};
use crate::link::link;
use crate::probe;
use crate::wait::{wait_once, wait_ready};

/// Time between two attempts to send into the full queue of an interface: about one frame at 1 Mbit/s.
const SEND_RETRY: Duration = Duration::from_micros(100);

/// Longest time that the hub may take to let a participant join.
const JOIN_PATIENCE: Duration = Duration::from_secs(5);

/// Filter that no frame passes, for a participant of a hub without filters: it accepts error messages of no kind. An empty packet
/// would read as the end of the connection.
const NOTHING: Filter = Filter {
    id: 0,
    mask: ERROR_FLAG,
};

/// Index of the drop counter in the answer to `SO_MEMINFO` (`SK_MEMINFO_DROPS`).
const MEMINFO_DROPS: usize = 8;

/// Bytes of the kernel's `struct canfd_frame`.
const FD_FRAME_BYTES: usize = 72;

/// Socket of one participant.
pub(crate) struct SocketBus {
    address: BusAddress,
    /// Socket on the interface, or to the hub.
    socket: CanSocket,
    /// Number of lost frames that the hub reported last. It reports before the first frame after a loss.
    dropped: Cell<u64>,
    delayed: u64,
    fd_frames: Cell<u64>,
}

impl SocketBus {
    /// Takes an open socket on an interface, and sets the kernel's receive filters.
    ///
    /// # Errors
    /// If the system refuses.
    pub(crate) fn on_interface(
        name: &str,
        socket: CanSocket,
        filters: &[Filter],
    ) -> Result<Self, BusError> {
        let address = BusAddress::Interface(name.into());
        set_filters(&socket, filters)
            .map_err(|error| BusError::system(&address, "set its filters", error))?;
        let bus = Self::new(address, socket);
        // Frames that came between the opening and the filters are discarded.
        while bus.try_receive()?.is_some() {}
        Ok(bus)
    }

    /// Joins the embedded bus at `path`. When this returns, the hub knows the filters.
    ///
    /// # Errors
    /// If no hub of this user is there, or it does not let us join within 5 s.
    pub(crate) fn on_hub(path: &Path, filters: &[Filter]) -> Result<Self, BusError> {
        let address = BusAddress::Embedded(path.into());
        let socket = connect_to(path, &address)?;
        let bus = Self::new(address, socket.into());
        bus.join(path, filters)?;
        Ok(bus)
    }

    fn new(address: BusAddress, socket: CanSocket) -> Self {
        Self {
            address,
            socket,
            dropped: Cell::new(0),
            delayed: 0,
            fd_frames: Cell::new(0),
        }
    }

    fn join(&self, path: &Path, filters: &[Filter]) -> Result<(), BusError> {
        let filters = if filters.is_empty() {
            &[NOTHING]
        } else {
            filters
        };
        let refused = || BusError(format!("the bus at {} did not let us join", path.display()));
        send(&self.socket, &encode_filters(filters), SendFlags::NOSIGNAL).map_err(|_| refused())?;
        let answered = wait_ready(self.as_fd(), PollFlags::IN, JOIN_PATIENCE)
            .map_err(|errno| self.failed("join", errno))?;
        let mut bytes = [0; FRAME_BYTES];
        match recv(&self.socket, &mut bytes, RecvFlags::DONTWAIT) {
            Ok((_, length)) if answered && decode_notice(&bytes[..length]).is_some() => Ok(()),
            _ => Err(refused()),
        }
    }

    fn try_receive(&self) -> Result<Option<CanFrame>, BusError> {
        let mut bytes = [0; FD_FRAME_BYTES];
        loop {
            match recv(&self.socket, &mut bytes, RecvFlags::DONTWAIT) {
                Ok((_, 0)) => return Err(self.failed("receive", Errno::PIPE)),
                Ok((_, FD_FRAME_BYTES)) => self.fd_frames.set(self.fd_frames.get() + 1),
                Ok((_, length)) => {
                    let packet = bytes.get(..length).unwrap_or_default();
                    if let Some(frame) = decode_frame(packet) {
                        return Ok(Some(frame));
                    }
                    if let Some(dropped) = decode_notice(packet) {
                        self.dropped.set(dropped);
                    }
                }
                Err(Errno::AGAIN) => return Ok(None),
                Err(Errno::INTR) => {}
                Err(errno) => return Err(self.failed("receive", errno)),
            }
        }
    }

    fn failed(&self, action: &str, errno: Errno) -> BusError {
        match (&self.address, errno) {
            (BusAddress::Interface(name), Errno::NETDOWN) => BusError::interface_down(name),
            (BusAddress::Interface(name), Errno::NODEV | Errno::NXIO) => {
                BusError::no_interface(name)
            }
            (address @ BusAddress::Embedded(_), Errno::PIPE | Errno::CONNRESET) => {
                BusError(format!("the bus {address} ended"))
            }
            (address, errno) => BusError::system(address, action, errno),
        }
    }
}

impl Bus for SocketBus {
    fn send(&mut self, frame: &CanFrame) -> Result<(), BusError> {
        let bytes = encode_frame(frame);
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        // Where reading a clock is a system call, as in user-mode Linux, it costs as much as the frame.
        let mut clock = None;
        loop {
            let full = match send(&self.socket, &bytes, flags) {
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => continue,
                Err(full @ (Errno::NOBUFS | Errno::AGAIN)) => full,
                Err(errno) => return Err(self.failed("send", errno)),
            };
            self.delayed += u64::from(clock.is_none());
            let patience =
                SEND_PATIENCE.saturating_sub(clock.get_or_insert_with(Clock::start).now());
            if patience.is_zero() {
                return Err(BusError::not_sent(&self.address, frame));
            }
            // ENOBUFS is the device's queue, which poll does not see: it would call the socket writable.
            if full == Errno::NOBUFS {
                sleep(SEND_RETRY);
            } else {
                wait_ready(self.as_fd(), PollFlags::OUT, patience)
                    .map_err(|errno| self.failed("send", errno))?;
            }
        }
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>, BusError> {
        if let Some(frame) = self.try_receive()? {
            return Ok(Some(frame));
        }
        if timeout.is_zero() {
            return Ok(None);
        }
        let end = monotonic().saturating_add(timeout);
        let mut patience = timeout;
        while !patience.is_zero() {
            wait_once(self.as_fd(), PollFlags::IN, patience)
                .map_err(|errno| self.failed("receive", errno))?;
            if let Some(frame) = self.try_receive()? {
                return Ok(Some(frame));
            }
            patience = end.saturating_sub(monotonic());
        }
        Ok(None)
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    fn dropped(&self) -> u64 {
        match self.address {
            BusAddress::Embedded(_) => self.dropped.get(),
            _ => kernel_drops(&self.socket),
        }
    }

    fn delayed(&self) -> u64 {
        self.delayed
    }

    fn count_fd_frames(&mut self) {
        // A kernel without CAN FD refuses the option, and so does a socket to a hub; then none are counted.
        let option = libc::CAN_RAW_FD_FRAMES;
        let _ = self
            .socket
            .set_socket_option_int(libc::SOL_CAN_RAW, option, 1);
    }

    fn fd_frames(&self) -> u64 {
        self.fd_frames.get()
    }
}

/// Returns the number of lost frames in a notice of the hub; `None` if the packet is none.
fn decode_notice(packet: &[u8]) -> Option<u64> {
    packet.try_into().ok().map(u64::from_ne_bytes)
}

/// Returns a socket that is connected to the hub at `path`. A hub of another user, which could feed us any frame, is refused.
fn connect_to(path: &Path, address: &BusAddress) -> Result<OwnedFd, BusError> {
    let place = path.display();
    let failed = |errno| match errno {
        Errno::NOENT | Errno::CONNREFUSED | Errno::NOTDIR => BusError(format!(
            "no bus is at {place}: has the run that made it ended?"
        )),
        Errno::ACCESS | Errno::PERM => BusError::no_permission(address),
        errno => BusError::system(address, "open", errno),
    };
    let at = SocketAddrUnix::new(path).map_err(|_| {
        let length = path.as_os_str().len();
        BusError(format!(
            "the path {place} is too long for a socket ({length} bytes, limit {PATH_BYTES_MAX})"
        ))
    })?;
    let socket = seqpacket(SocketFlags::empty()).map_err(failed)?;
    connect(&socket, &at).map_err(failed)?;
    let owner = socket_peercred(&socket).map_err(failed)?.uid;
    if owner != rustix::process::geteuid() {
        let owner = owner.as_raw();
        return Err(BusError(format!(
            "the bus at {place} belongs to user {owner}, not to you"
        )));
    }
    Ok(socket)
}

/// Opens an unfiltered socket on an interface, after a check of the system's support.
pub(crate) fn open_socket(name: &str) -> Result<CanSocket, BusError> {
    probe::kernel_can()?;
    let address = BusAddress::Interface(name.into());
    check_interface(name, &address)?;
    CanSocket::open(name).map_err(|error| match error.kind() {
        io::ErrorKind::PermissionDenied => BusError::no_permission(&address),
        _ => BusError::system(&address, "open", error),
    })
}

/// Checks that there is an interface of this name, for CAN and up.
fn check_interface(name: &str, address: &BusAddress) -> Result<(), BusError> {
    let link = link(name).map_err(|error| match error.raw_os_error() {
        Some(libc::ENODEV) => BusError::no_interface(name),
        _ => BusError::system(address, "open", error),
    })?;
    if !link.is_can {
        return Err(BusError(format!(
            "{name} is no CAN interface; `ip -brief link show type can` and `... type vcan` list those there are"
        )));
    }
    if !link.is_up {
        return Err(BusError::interface_down(name));
    }
    Ok(())
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
        let refused = |name: &str| {
            let address = BusAddress::Interface(name.into());
            check_interface(name, &address).unwrap_err().to_string()
        };
        let missing = refused("no-such-one");
        assert!(missing.starts_with("CAN interface no-such-one does not exist"));
        assert!(refused("lo").starts_with("lo is no CAN interface"));
    }
}
