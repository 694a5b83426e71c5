//! Exclusive use of a CAN interface by one process of this machine.
//!
//! The claim is a socket with an abstract name. The kernel keeps such names for each network namespace, as it does interfaces,
//! across all users, and removes them when the process ends in any way. No file is left.
#![expect(
    unsafe_code,
    reason = "a process of another container has no number here, for which rustix has no type"
)]

use std::os::fd::{AsRawFd, OwnedFd};

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, netdevice,
    socket_with,
};

/// Number of pending connections that the kernel holds. Other processes connect to ask for the holder; none is accepted.
const BACKLOG: i32 = 4096;

/// Reason why an interface cannot be claimed.
#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    /// Another process holds it; it is named if it is visible from this namespace.
    #[error("{0}")]
    Taken(String),
    /// The system refuses.
    #[error("{0}")]
    System(String),
}

/// Exclusive claim on an interface; released on drop.
#[derive(Debug)]
pub struct Claim {
    _socket: OwnedFd,
}

impl Claim {
    /// Claims an interface of this network namespace.
    ///
    /// # Errors
    /// Another process has it, or the system refuses.
    pub fn on(interface: &str) -> Result<Self, ClaimError> {
        // An interface may have several names, and get another one.
        let index = socket().and_then(|socket| netdevice::name_to_index(socket, interface));
        let index = index.map_err(|errno| refused(interface, errno))?;
        Self::named(&format!("canrig/interface/{index}"), interface)
    }

    fn named(name: &str, interface: &str) -> Result<Self, ClaimError> {
        let system = |errno| refused(interface, errno);
        let address = SocketAddrUnix::new_abstract_name(name.as_bytes()).map_err(system)?;
        let socket = socket().map_err(system)?;
        match bind(&socket, &address) {
            Err(Errno::ADDRINUSE) => {
                let holder = holder(&address).map(|process| format!("process {process}"));
                let holder = holder.unwrap_or_else(|| "another canrig".to_owned());
                return Err(ClaimError::Taken(format!(
                    "{holder} of this machine plays on {interface} already; wait until it ends, or take another bus"
                )));
            }
            bound => bound.map_err(system)?,
        }
        listen(&socket, BACKLOG).map_err(system)?;
        Ok(Self { _socket: socket })
    }
}

fn refused(interface: &str, errno: Errno) -> ClaimError {
    ClaimError::System(format!("{interface} cannot be claimed: {errno}"))
}

fn socket() -> rustix::io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)
}

/// Returns the process that listens at an address, if it is visible from this namespace.
fn holder(address: &SocketAddrUnix) -> Option<u32> {
    let socket = socket().ok()?;
    connect(&socket, address).ok()?;
    peer_process(&socket)
}

/// Returns the process at the other end of a socket, if it is visible from this namespace.
pub(crate) fn peer_process(socket: &OwnedFd) -> Option<u32> {
    let mut peer = libc::ucred {
        pid: 0,
        uid: 0,
        gid: 0,
    };
    let mut length = libc::socklen_t::try_from(size_of::<libc::ucred>()).ok()?;
    // SAFETY: the kernel writes three numbers into a structure of three numbers, whose size it is given.
    let result = unsafe {
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERCRED,
            (&raw mut peer).cast(),
            &raw mut length,
        )
    };
    let process = u32::try_from(peer.pid).ok()?;
    (result == 0 && process != 0).then_some(process)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::clock::Clock;

    #[test]
    fn a_claim_holds_until_it_is_dropped_and_names_its_process() {
        let name = format!("canrig/test/{}", std::process::id());
        let claim = Claim::named(&name, "can9").unwrap();
        let said = Claim::named(&name, "can9").unwrap_err().to_string();
        let expected = format!(
            "process {} of this machine plays on can9",
            std::process::id()
        );
        assert!(said.starts_with(&expected), "{said}");
        drop(claim);
        // A process that another test is starting has a copy until it runs its program.
        let clock = Clock::start();
        while let Err(error) = Claim::named(&name, "can9") {
            assert!(clock.now() < Duration::from_secs(60), "{error}");
            std::thread::yield_now();
        }
    }

    #[test]
    fn an_interface_that_is_not_there_cannot_be_claimed() {
        let said = Claim::on("no-such-one").unwrap_err().to_string();
        assert!(said.starts_with("no-such-one cannot be claimed"), "{said}");
    }
}
