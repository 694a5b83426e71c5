//! Private bus without root: a vcan in a user and a network namespace of its own.
//!
//! A process may change its user namespace only while it has a single thread, so a helper does it: it makes the
//! namespaces and the interface, opens the bench's sockets there and passes them on, then waits until the bench closes
//! its channel. The nodes' processes enter the namespaces of the helper ([`enter`]). With the last process and socket
//! the kernel takes namespaces and interface away.
#![expect(unsafe_code, reason = "unshare")]

use std::fs::{self, File};
use std::io::{self, IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::MetadataExt;
use std::process::{Child, Stdio};
use std::time::Duration;

use can::{CanFrame, Filter};
use rustix::event::PollFlags;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, recvmsg, sendmsg,
};
use rustix::process::{getegid, geteuid};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use socketcan::CanSocket;

use crate::bus::{Bus, BusError};
use crate::link::INFO_KIND;
use crate::lockstep::channel;
use crate::netlink::{ask, push_attribute};
use crate::process;
use crate::recorder::Recorder;
use crate::socket_bus::{SocketBus, open_socket};
use crate::wait::wait_ready;

/// Name of the interface in its namespace.
pub const INTERFACE: &str = "vcan0";

/// The hidden subcommand that runs [`serve`]; its standard input is the channel.
pub const HELPER: &str = "private-bus";

/// Longest time that the helper may take.
const PATIENCE: Duration = Duration::from_secs(5);

/// Number of sockets that the helper opens for the bench: the recorder takes one, the bench's own node one, and the last is for
/// the requests to the drives after a run that broke off.
const SOCKETS: usize = 3;

/// Private bus; it ends on drop.
pub struct PrivateBus {
    /// The helper ends when this is closed; it is before `helper`, which waits for that.
    channel: OwnedFd,
    helper: Helper,
    /// Sockets on the bus that were not taken yet.
    sockets: Vec<CanSocket>,
}

/// Process of the helper, whose end the drop awaits.
struct Helper(Child);

impl Drop for Helper {
    fn drop(&mut self) {
        // The kernel ends a helper that does not end by itself when this thread ends.
        let _ = self.0.wait();
    }
}

impl PrivateBus {
    /// Makes a private bus. Call it on the thread that lives as long as the run.
    ///
    /// # Errors
    /// With the step that the system refuses.
    pub fn start() -> io::Result<Self> {
        let failed =
            |error: io::Error| io::Error::new(error.kind(), format!("its helper failed: {error}"));
        let (bus, refused) = Self::start_helper().map_err(failed)?;
        if bus.sockets.len() < SOCKETS {
            return Err(io::Error::other(refused));
        }
        Ok(bus)
    }

    /// Starts the helper; returns its text, too, which says why there are no sockets.
    fn start_helper() -> io::Result<(Self, String)> {
        let (ours, theirs) = channel()?;
        let mut command = process::myself()?;
        let helper = command
            .arg(HELPER)
            .stdin(theirs)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        // It holds the helper's end of the channel, whose close shows the end of the helper.
        drop(command);
        let mut bus = Self {
            channel: ours,
            helper: Helper(helper),
            sockets: Vec::new(),
        };
        let (text, sockets) = receive(&bus.channel)?;
        bus.sockets.extend(sockets.into_iter().map(CanSocket::from));
        Ok((bus, text))
    }

    /// Returns the process whose namespaces the nodes [`enter`].
    pub fn process(&self) -> u32 {
        self.helper.0.id()
    }

    /// Returns the recorder of this bus.
    ///
    /// # Errors
    /// If the system refuses it, or all sockets were taken before.
    pub fn recorder(&mut self) -> Result<Recorder, BusError> {
        let socket = self.socket()?;
        Recorder::on_socket(INTERFACE, socket)
    }

    /// Joins this bus as a node of the bench itself.
    ///
    /// # Errors
    /// If the system refuses it, or all sockets were taken before.
    pub fn join(&mut self, filters: &[Filter]) -> Result<Box<dyn Bus>, BusError> {
        let socket = self.socket()?;
        let bus = SocketBus::on_interface(INTERFACE, socket, filters)?;
        Ok(Box::new(bus))
    }

    fn socket(&mut self) -> Result<CanSocket, BusError> {
        let socket = self.sockets.pop();
        socket.ok_or_else(|| {
            BusError(format!(
                "the bench has taken all {SOCKETS} sockets of its private bus"
            ))
        })
    }
}

/// Runs the helper; call it in a process with a single thread. Returns when the bench closes the channel.
///
/// # Errors
/// The reason is sent to the bench.
pub fn serve(channel: OwnedFd) -> io::Result<()> {
    match make() {
        Ok(sockets) => send(&channel, "", &sockets)?,
        Err(refused) => {
            send(&channel, &refused, &[])?;
            return Err(io::Error::other(refused));
        }
    }
    // Waits for the end of the channel, since the bench sends nothing.
    rustix::net::recv(&channel, &mut [0; 1], RecvFlags::empty())?;
    Ok(())
}

/// Makes namespaces, interface and sockets. A sandbox may grant the first and then refuse their use, so a frame must cross.
fn make() -> Result<Vec<CanSocket>, String> {
    let said = |what: &'static str| move |error: io::Error| format!("{what}: {error}");
    leave_namespaces().map_err(said(
        "a user and network namespace was refused (permit it with: sudo sysctl kernel.unprivileged_userns_clone=1 user.max_user_namespaces=10000)",
    ))?;
    make_interface().map_err(said(
        "a vcan cannot be made in a private namespace (load it with: sudo modprobe -a can-raw vcan)",
    ))?;
    let fault = |error: BusError| error.to_string();
    let open = || open_socket(INTERFACE).map_err(fault);
    let (mut one, mut other) = (probe(open()?)?, probe(open()?)?);
    let frame = CanFrame::new(0x7FF, &[]);
    one.send(&frame).map_err(fault)?;
    if other.receive(PATIENCE).map_err(fault)? != Some(frame) {
        return Err("a private vcan was made, but carries no frame".to_owned());
    }
    drop((one, other));
    (0..SOCKETS).map(|_| open()).collect()
}

fn probe(socket: CanSocket) -> Result<SocketBus, String> {
    SocketBus::on_interface(INTERFACE, socket, &[Filter::ALL]).map_err(|error| error.to_string())
}

/// Moves to new namespaces. Root needs no user namespace, in which it would lose its right to real-time priority.
fn leave_namespaces() -> io::Result<()> {
    let (user, group) = (geteuid().as_raw(), getegid().as_raw());
    if user == 0 && unshare(libc::CLONE_NEWNET).is_ok() {
        return Ok(());
    }
    unshare(libc::CLONE_NEWUSER | libc::CLONE_NEWNET)?;
    fs::write("/proc/self/setgroups", "deny")?;
    fs::write("/proc/self/uid_map", format!("{user} {user} 1"))?;
    fs::write("/proc/self/gid_map", format!("{group} {group} 1"))
}

fn unshare(flags: libc::c_int) -> io::Result<()> {
    // SAFETY: the call takes flags and changes only the view of this process; no descriptor or memory is concerned.
    match unsafe { libc::unshare(flags) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

/// Makes an interface of kind vcan that is up.
fn make_interface() -> io::Result<()> {
    // NLM_F_REQUEST, NLM_F_ACK, NLM_F_EXCL, NLM_F_CREATE
    const ACKNOWLEDGED_NEW: u16 = 0x001 | 0x004 | 0x200 | 0x400;
    const IFF_UP: u32 = 1;
    let up = IFF_UP.to_ne_bytes();
    let mut body = vec![0; 8]; // family, type and index are the kernel's to choose
    body.extend_from_slice(&up); // flags
    body.extend_from_slice(&up); // which of them count
    push_attribute(&mut body, libc::IFLA_IFNAME, b"vcan0\0");
    let mut kind = Vec::new();
    push_attribute(&mut kind, INFO_KIND, b"vcan");
    push_attribute(&mut body, libc::IFLA_LINKINFO, &kind);
    ask(libc::RTM_NEWLINK, ACKNOWLEDGED_NEW, &body).map(drop)
}

/// Enters the namespaces of a helper, for a node's process while it has a single thread. Request real-time priority before: a
/// user namespace takes the right to it away.
///
/// # Errors
/// If the helper is gone or the system refuses.
pub fn enter(helper: u32) -> io::Result<()> {
    let theirs = |kind: &str| File::open(format!("/proc/{helper}/ns/{kind}"));
    let user = theirs("user")?;
    let net = theirs("net")?;
    if user.metadata()?.ino() != fs::metadata("/proc/self/ns/user")?.ino() {
        move_into_link_name_space(user.as_fd(), Some(LinkNameSpaceType::User))?;
    }
    Ok(move_into_link_name_space(
        net.as_fd(),
        Some(LinkNameSpaceType::Network),
    )?)
}

fn send(channel: &OwnedFd, text: &str, sockets: &[CanSocket]) -> io::Result<()> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(SOCKETS))];
    let mut control = SendAncillaryBuffer::new(&mut space);
    let fds: Vec<_> = sockets.iter().map(AsFd::as_fd).collect();
    if !fds.is_empty() && !control.push(SendAncillaryMessage::ScmRights(&fds)) {
        return Err(io::Error::other("more sockets than room for them"));
    }
    // An empty packet would look like the end.
    let text = format!("{text}\n");
    sendmsg(
        channel,
        &[IoSlice::new(text.as_bytes())],
        &mut control,
        SendFlags::NOSIGNAL,
    )?;
    Ok(())
}

/// Receives the helper's text and the sockets.
fn receive(channel: &OwnedFd) -> io::Result<(String, Vec<OwnedFd>)> {
    if !wait_ready(channel.as_fd(), PollFlags::IN, PATIENCE)? {
        return Err(io::Error::other("it gave no answer"));
    }
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(SOCKETS))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let mut text = [0; 512];
    let received = recvmsg(
        channel,
        &mut [IoSliceMut::new(&mut text)],
        &mut control,
        RecvFlags::CMSG_CLOEXEC,
    )?;
    if received.bytes == 0 {
        return Err(io::Error::other("it ended without an answer"));
    }
    let mut sockets = Vec::new();
    for message in control.drain() {
        if let RecvAncillaryMessage::ScmRights(fds) = message {
            sockets.extend(fds);
        }
    }
    let text = String::from_utf8_lossy(&text[..received.bytes]);
    Ok((text.trim().to_owned(), sockets))
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn recorder_bench_and_requests_have_a_socket_each_and_no_other_has_one() {
        let (ours, theirs) = channel().unwrap();
        let made = Vec::from_iter((0..SOCKETS).map(|_| channel().unwrap().0.into()));
        send(&theirs, "", &made).unwrap();
        let (_, sockets) = receive(&ours).unwrap();
        let mut bus = PrivateBus {
            channel: ours,
            helper: Helper(Command::new("true").spawn().unwrap()),
            sockets: sockets.into_iter().map(CanSocket::from).collect(),
        };
        for user in ["recorder", "bench", "requests to the drives"] {
            assert!(bus.socket().is_ok(), "{user}");
        }
        let error = bus.socket().unwrap_err().to_string();
        assert!(error.ends_with("sockets of its private bus"), "{error}");
    }
}
