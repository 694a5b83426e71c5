//! Listening socket in the file system, for a seat or a hub.

use std::fs::{self, Permissions};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::event::PollFlags;
use rustix::net::sockopt::socket_peercred;
use rustix::net::{SocketAddrUnix, SocketFlags, accept_with, bind, listen};
use rustix::process::getuid;
use tempfile::TempDir;

use crate::bus::seqpacket;
use crate::clock::monotonic;
use crate::wait::wait_for_process;

/// Listening socket in a folder of its own, which no other user can enter. Both are removed on drop.
#[derive(Debug)]
pub struct Listener {
    socket: OwnedFd,
    folder: TempDir,
}

impl Listener {
    /// Makes a folder in `place` whose name begins with `prefix`, and the socket in it. At most `waiting_max` clients wait to be
    /// accepted.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn open_in(place: &Path, prefix: &str, waiting_max: i32) -> io::Result<Self> {
        let folder = tempfile::Builder::new()
            .prefix(prefix)
            .permissions(Permissions::from_mode(0o700))
            .tempdir_in(place)?;
        let socket = seqpacket(SocketFlags::NONBLOCK)?;
        let listener = Self { socket, folder };
        bind(&listener.socket, &SocketAddrUnix::new(listener.path())?)?;
        // No other user can pass the folder meanwhile.
        fs::set_permissions(listener.path(), Permissions::from_mode(0o600))?;
        listen(&listener.socket, waiting_max)?;
        Ok(listener)
    }

    /// Returns the path of the socket.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("socket")
    }

    /// Returns another descriptor of the socket, for a thread that accepts clients by itself.
    ///
    /// # Errors
    /// If the system refuses.
    pub(crate) fn socket(&self) -> io::Result<OwnedFd> {
        self.socket.try_clone()
    }

    /// Waits for a client of the same user, and refuses those of others; `None` if none comes in time, or before this
    /// process is asked to end.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn accept(&self, patience: Duration) -> io::Result<Option<OwnedFd>> {
        let end = monotonic().saturating_add(patience);
        let rest = || end.saturating_sub(monotonic());
        while wait_for_process(self.socket.as_fd(), PollFlags::IN, rest())? {
            let channel = accept_with(&self.socket, SocketFlags::CLOEXEC)?;
            if socket_peercred(&channel)?.uid == getuid() {
                return Ok(Some(channel));
            }
        }
        Ok(None)
    }
}
