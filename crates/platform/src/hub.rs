//! The embedded bus: a CAN bus without a kernel's CAN, for the processes of one user on one machine.
//!
//! The hub listens on a `SOCK_SEQPACKET` socket of the file system. Packets:
//!
//! - The first packet of a client is its receive filters, an array of the kernel's `struct can_filter` (8 bytes each, up
//!   to 512). Identifier 0 with mask 0 accepts everything but error messages. There are no inverted filters. An empty
//!   packet would read as the end of the connection: a client that wants no frames sends one filter that none passes,
//!   identifier 0 with mask 0x20000000.
//! - The hub answers with a notice: the number of frames that it dropped for this client, 8 bytes (now zero). A client
//!   is on the bus when it has this answer.
//! - From then on each packet is a frame, the kernel's 16-byte `struct can_frame`, native byte order, in both directions.
//!   The hub passes it on to all other clients whose filters accept it.
//!
//! A client that does not drain its socket (the kernel holds 278 packets) is dropped from, never waited for, and gets
//! another notice before its next frame. A packet that is not a frame is ignored. Only clients of the hub's
//! own user may join; the socket has mode 0600 in a directory of mode 0700.
//!
//! Each frame is stamped where it passes and handed to the [`Recorder`], with the process of its client.

mod place;
mod switch;
#[cfg(test)]
mod tests;

use std::io;
use std::path::PathBuf;

use crate::bus::{BusAddress, BusError};
use crate::listener::Listener;
use crate::recorder::{self, Recorder};
use crate::scheduling;
use crate::stop::StoppedThread;

pub use place::remove_orphaned;
pub use switch::CLIENTS_MAX;
use switch::Switch;

/// Priority of the hub's thread, above the nodes: a frame under way is worth more than the next one.
const PRIORITY: u8 = 60;

/// Returns the buses of this user's hubs that are running on this machine, without disturbing them.
pub fn running() -> Vec<BusAddress> {
    let sockets = place::running_in(&place::candidates());
    sockets.into_iter().map(BusAddress::Embedded).collect()
}

/// Running hub; dropping it ends the bus and removes its socket.
#[derive(Debug)]
pub struct Hub {
    // The thread ends before its socket is removed.
    _thread: StoppedThread,
    listener: Listener,
}

impl Hub {
    /// Starts a hub on its own thread, and the recorder of its bus.
    ///
    /// # Errors
    /// If no socket can be made.
    pub fn start() -> Result<(Self, Recorder), BusError> {
        Self::start_in(&place::candidates())
    }

    fn start_in(directories: &[PathBuf]) -> Result<(Self, Recorder), BusError> {
        let listener = place::listen(directories)?;
        let refused =
            |error: io::Error| BusError(format!("the embedded bus could not be started: {error}"));
        let socket = listener.socket().map_err(refused)?;
        let (ring, recorder) = recorder::ring();
        let thread = StoppedThread::start("hub", |stop| {
            let switch = Switch::new(socket, stop, ring)?;
            Ok(move || {
                // Without that priority the bus is only slower.
                let _ = scheduling::request_fifo(PRIORITY);
                switch.run();
            })
        });
        let hub = Self {
            _thread: thread.map_err(refused)?,
            listener,
        };
        Ok((hub, recorder))
    }

    /// Returns the address of the bus.
    pub fn address(&self) -> BusAddress {
        BusAddress::Embedded(self.listener.path())
    }
}
