//! Support of this system for SocketCAN.

use std::io;

use rustix::io::Errno;
use rustix::net::{AddressFamily, Protocol, SocketFlags, SocketType};

/// Protocol number `CAN_RAW` of `linux/can.h`.
const CAN_RAW: u32 = 1;

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
