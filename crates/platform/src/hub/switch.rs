//! The hub's thread: takes a frame from one client and passes it on to the others.

use std::io;
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;

use can::{CanFrame, Filter};
use rustix::event::epoll::{self, EventFlags};
use rustix::io::Errno;
use rustix::net::sockopt::socket_peercred;
use rustix::net::{RecvFlags, SendFlags, SocketFlags, accept_with};

use crate::claim::peer_process;
use crate::kernel_format::{FILTER_BYTES, FRAME_BYTES, decode_filters, decode_frame, encode_frame};
use crate::recorder::Ring;

/// Largest number of participants at once.
pub const CLIENTS_MAX: usize = 32;

/// Largest number of filters of a client (the kernel's `CAN_RAW_FILTER_MAX`).
const FILTERS_MAX: usize = 512;
const PACKET_MAX: usize = FILTERS_MAX * FILTER_BYTES;

/// Epoll data of the descriptors that are not clients.
const LISTENER: u64 = u64::MAX;
const STOP: u64 = u64::MAX - 1;

struct Client {
    socket: OwnedFd,
    /// Process at the other end; `None` if it is one of another container.
    process: Option<u32>,
    /// Filters of the client; `None` until its first packet.
    filters: Option<Vec<Filter>>,
    dropped: u64,
    dropped_reported: u64,
}

pub(super) struct Switch {
    epoll: OwnedFd,
    listener: OwnedFd,
    // Kept open for the epoll.
    _stop: OwnedFd,
    clients: [Option<Client>; CLIENTS_MAX],
    ring: Ring,
    packet: Box<[u8; PACKET_MAX]>,
}

impl Switch {
    pub(super) fn new(listener: OwnedFd, stop: OwnedFd, ring: Ring) -> io::Result<Self> {
        let epoll = epoll::create(epoll::CreateFlags::CLOEXEC)?;
        watch(&epoll, &listener, LISTENER)?;
        watch(&epoll, &stop, STOP)?;
        Ok(Self {
            epoll,
            listener,
            _stop: stop,
            clients: [const { None }; CLIENTS_MAX],
            ring,
            packet: Box::new([0; PACKET_MAX]),
        })
    }

    /// Serves the clients until the other end of the pipe `stop` closes. One packet per client and round, so that no client
    /// starves the others.
    pub(super) fn run(mut self) {
        let mut events = [MaybeUninit::uninit(); CLIENTS_MAX];
        loop {
            let ready = match epoll::wait(&self.epoll, &mut events[..], None) {
                Ok((ready, _)) => ready,
                Err(Errno::INTR) => continue,
                // Ending the bus is better than spinning at real-time priority.
                Err(_) => return,
            };
            for event in ready {
                let flags = event.flags;
                match event.data.u64() {
                    STOP => return,
                    LISTENER => self.accept_client(),
                    index => {
                        let index = usize::try_from(index).unwrap_or(CLIENTS_MAX);
                        // All packets of a client that has left are taken before another one joins.
                        while self.serve(index) && flags.contains(EventFlags::HUP) {}
                    }
                }
            }
        }
    }

    fn accept_client(&mut self) {
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let socket = match accept_with(&self.listener, flags) {
            Ok(socket) => socket,
            Err(Errno::AGAIN | Errno::INTR | Errno::CONNABORTED) => return,
            Err(_) => {
                // Out of descriptors: refusing further clients is better than spinning at real-time priority.
                epoll::delete(&self.epoll, &self.listener).ok();
                return;
            }
        };
        let is_same_user =
            socket_peercred(&socket).is_ok_and(|peer| peer.uid == rustix::process::geteuid());
        let free = self.clients.iter().position(Option::is_none);
        match free.filter(|_| is_same_user) {
            Some(index) if watch(&self.epoll, &socket, index as u64).is_ok() => {
                self.clients[index] = Some(Client {
                    process: peer_process(&socket),
                    socket,
                    filters: None,
                    dropped: 0,
                    dropped_reported: 0,
                });
            }
            _ => {}
        }
    }

    /// Receives one packet from a client; returns false if there was none.
    fn serve(&mut self, index: usize) -> bool {
        let Some(client) = self.clients.get_mut(index).and_then(Option::as_mut) else {
            return false;
        };
        match receive(client, &mut self.packet[..]) {
            Ok(None) => return false,
            Err(_) => self.clients[index] = None,
            Ok(Some(length)) if client.filters.is_some() => {
                if let Some(frame) = self.packet.get(..length).and_then(decode_frame) {
                    self.pass_on(index, &frame);
                }
            }
            Ok(Some(length)) => {
                client.filters = self.packet.get(..length).and_then(decode_filters);
                if client.filters.is_none() || !client.send(&0_u64.to_ne_bytes()) {
                    self.clients[index] = None;
                }
            }
        }
        true
    }

    /// Records a frame and sends it to all other clients that want it.
    fn pass_on(&mut self, sender: usize, frame: &CanFrame) {
        let client = self.clients.get(sender).and_then(Option::as_ref);
        let process = client.and_then(|client| client.process);
        self.ring.push_now(*frame, process);
        let bytes = encode_frame(frame);
        for (index, client) in self.clients.iter_mut().enumerate() {
            let Some(client) = client else { continue };
            if index != sender && client.wants(frame) && !client.deliver(&bytes) {
                client.dropped += 1;
            }
        }
    }
}

impl Client {
    fn wants(&self, frame: &CanFrame) -> bool {
        let mut filters = self.filters.iter().flatten();
        filters.any(|filter| filter.accepts(frame))
    }

    /// Sends the client a frame, after a notice of lost ones; returns false if its socket is full or gone.
    fn deliver(&mut self, bytes: &[u8; FRAME_BYTES]) -> bool {
        if self.dropped != self.dropped_reported {
            if !self.send(&self.dropped.to_ne_bytes()) {
                return false;
            }
            self.dropped_reported = self.dropped;
        }
        self.send(bytes)
    }

    fn send(&self, packet: &[u8]) -> bool {
        rustix::net::send(
            &self.socket,
            packet,
            SendFlags::DONTWAIT | SendFlags::NOSIGNAL,
        )
        .is_ok()
    }
}

/// Receives one packet and returns its length, which exceeds the buffer's if the packet does; `None` if there is none.
///
/// # Errors
/// If the client has left.
fn receive(client: &Client, packet: &mut [u8]) -> Result<Option<usize>, Errno> {
    let flags = RecvFlags::DONTWAIT | RecvFlags::TRUNC;
    let mut receive = || rustix::net::recv(&client.socket, &mut *packet, flags);
    // Reported once for a client that left with frames unread, before the packets that it sent.
    let received = match receive() {
        Err(Errno::CONNRESET) => receive(),
        received => received,
    };
    match received {
        Ok((_, 0)) => Err(Errno::PIPE),
        Ok((_, length)) => Ok(Some(length)),
        Err(Errno::AGAIN | Errno::INTR) => Ok(None),
        Err(errno) => Err(errno),
    }
}

fn watch(epoll: &OwnedFd, source: &OwnedFd, name: u64) -> io::Result<()> {
    epoll::add(
        epoll,
        source,
        epoll::EventData::new_u64(name),
        epoll::EventFlags::IN,
    )?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use rustix::net::{AddressFamily, SocketType, send, socketpair};

    use super::*;

    /// A controller leaves with a command without current, while positions still come.
    #[test]
    fn all_that_a_client_sent_is_received_although_it_left_with_frames_unread() {
        let kind = SocketType::SEQPACKET;
        let (server, client_end) =
            socketpair(AddressFamily::UNIX, kind, SocketFlags::CLOEXEC, None).unwrap();
        send(&server, b"unread", SendFlags::empty()).unwrap();
        for said in [&b"first"[..], b"last one"] {
            send(&client_end, said, SendFlags::empty()).unwrap();
        }
        drop(client_end);
        let client = Client {
            socket: server,
            process: None,
            filters: None,
            dropped: 0,
            dropped_reported: 0,
        };
        let mut packet = [0; 16];
        for length in [5, 8] {
            let received = receive(&client, &mut packet);
            assert_eq!(received, Ok(Some(length)));
        }
        assert!(receive(&client, &mut packet).is_err());
    }
}
