//! Support of this system for SocketCAN.

use rustix::io::Errno;
use rustix::net::{AddressFamily, Protocol, SocketFlags, SocketType, socket_with};

use crate::bus::BusError;

/// Protocol number `CAN_RAW` of `linux/can.h`.
const CAN_RAW: u32 = 1;

/// Checks that this kernel provides CAN sockets.
///
/// # Errors
/// With the reason if it does not.
pub fn kernel_can() -> Result<(), BusError> {
    let raw = std::num::NonZeroU32::new(CAN_RAW).map(Protocol::from_raw);
    let (family, kind) = (AddressFamily::CAN, SocketType::RAW);
    let opened = socket_with(family, kind, SocketFlags::CLOEXEC, raw);
    opened.map(drop).map_err(|errno| {
        BusError(match errno {
            Errno::AFNOSUPPORT => "this kernel has no CAN (AF_CAN is not supported); load it with: sudo modprobe -a can-raw vcan (or use the embedded bus)".to_owned(),
            Errno::PROTONOSUPPORT => "this kernel has CAN but no raw sockets for it; load them with: sudo modprobe can-raw".to_owned(),
            Errno::PERM | Errno::ACCESS => "CAN sockets are not permitted here (a sandbox or a seccomp filter refuses AF_CAN)".to_owned(),
            errno => format!("a CAN socket could not be opened: {errno}"),
        })
    })
}
