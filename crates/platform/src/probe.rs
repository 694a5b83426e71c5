//! Support of this system for SocketCAN.
#![expect(unsafe_code, reason = "the interface flags come from an ioctl")]

use std::io;
use std::os::fd::AsRawFd;

use rustix::io::Errno;
use rustix::net::{AddressFamily, Protocol, SocketFlags, SocketType, netdevice};

/// Protocol number `CAN_RAW` of `linux/can.h`.
const CAN_RAW: u32 = 1;
/// Hardware type `ARPHRD_CAN` of `linux/if_arp.h`.
const ARPHRD_CAN: libc::sa_family_t = 280;

/// Reason why SocketCAN is not available.
#[derive(Debug, thiserror::Error)]
pub enum NoKernelCan {
    /// The kernel is built without CAN, or its module is not there.
    #[error(
        "this kernel has no CAN (AF_CAN is not supported); load it with: sudo modprobe -a can-raw vcan (or use the embedded bus)"
    )]
    NotSupported,
    /// The kernel has CAN, but not raw sockets.
    #[error("this kernel has CAN but no raw sockets for it; load them with: sudo modprobe can-raw")]
    NoRawSockets,
    /// A sandbox refuses it.
    #[error("CAN sockets are not permitted here (a sandbox or a seccomp filter refuses AF_CAN)")]
    NotPermitted,
    /// Anything else.
    #[error("a CAN socket could not be opened: {0}")]
    System(io::Error),
}

/// State of a network interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interface {
    /// No interface has this name.
    Missing,
    /// The interface is not for CAN.
    NotCan,
    /// A CAN interface that is down.
    Down,
    /// A CAN interface that is up.
    Up,
}

/// Checks that this kernel provides CAN sockets.
///
/// # Errors
/// With the reason if it does not.
pub fn kernel_can() -> Result<(), NoKernelCan> {
    let raw = std::num::NonZeroU32::new(CAN_RAW).map(Protocol::from_raw);
    match rustix::net::socket_with(
        AddressFamily::CAN,
        SocketType::RAW,
        SocketFlags::CLOEXEC,
        raw,
    ) {
        Ok(_) => Ok(()),
        Err(Errno::AFNOSUPPORT) => Err(NoKernelCan::NotSupported),
        Err(Errno::PROTONOSUPPORT) => Err(NoKernelCan::NoRawSockets),
        Err(Errno::PERM | Errno::ACCESS) => Err(NoKernelCan::NotPermitted),
        Err(errno) => Err(NoKernelCan::System(errno.into())),
    }
}

/// Returns the state of the interface `name` in this process's network namespace.
///
/// # Errors
/// If the system does not answer.
pub fn interface(name: &str) -> io::Result<Interface> {
    let any = rustix::net::socket_with(
        AddressFamily::UNIX,
        SocketType::DGRAM,
        SocketFlags::CLOEXEC,
        None,
    )?;
    match netdevice::name_to_index(&any, name) {
        Ok(_) => {}
        Err(Errno::NODEV) => return Ok(Interface::Missing),
        Err(errno) => return Err(errno.into()),
    }
    let hardware = interface_request(&any, name, libc::SIOCGIFHWADDR)?;
    // SAFETY: SIOCGIFHWADDR has filled this member of the union.
    if unsafe { hardware.ifr_ifru.ifru_hwaddr }.sa_family != ARPHRD_CAN {
        return Ok(Interface::NotCan);
    }
    let flags = interface_request(&any, name, libc::SIOCGIFFLAGS)?;
    // SAFETY: SIOCGIFFLAGS has filled this member of the union.
    let flags = libc::c_int::from(unsafe { flags.ifr_ifru.ifru_flags });
    Ok(if flags & libc::IFF_UP == 0 {
        Interface::Down
    } else {
        Interface::Up
    })
}

/// Sends one of the `SIOCGIF...` requests for an interface.
fn interface_request(
    socket: &impl AsRawFd,
    name: &str,
    request: libc::Ioctl,
) -> io::Result<libc::ifreq> {
    // SAFETY: an ifreq of zeros is valid: numbers and a union of plain data.
    let mut question: libc::ifreq = unsafe { std::mem::zeroed() };
    let room = question.ifr_name.len() - 1;
    for (to, from) in question.ifr_name[..room].iter_mut().zip(name.bytes()) {
        *to = libc::c_char::from_ne_bytes([from]);
    }
    // SAFETY: these requests read the name and write within the ifreq.
    let result = unsafe { libc::ioctl(socket.as_raw_fd(), request, &raw mut question) };
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(question)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interfaces_are_distinguished() {
        assert_eq!(interface("no-such-one").unwrap(), Interface::Missing);
        assert_eq!(interface("lo").unwrap(), Interface::NotCan);
    }
}
