//! Where a hub's socket is in the file system: a private directory, made for the run and removed after it.

use std::fs::{self, DirBuilder, Permissions};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, socket_with,
};
use rustix::process::{Pid, test_kill_process};

use super::{CLIENTS_MAX, HubError};
use crate::clock::Clock;

/// Directories are named `canrig-bus-<process>-<number>`.
const PREFIX: &str = "canrig-bus-";
const SOCKET: &str = "socket";
/// Hubs of one process, at most.
const HUBS_MAX: u32 = 1000;

/// How long a listener may outlive its connections while its process ends.
const LISTENER_PATIENCE: Duration = Duration::from_millis(500);

/// A directory with a hub's socket; both are removed on drop.
pub(super) struct Place {
    directory: PathBuf,
}

/// Where to try: the user's runtime directory, then the one for temporary files.
pub(super) fn candidates() -> Vec<PathBuf> {
    std::env::var_os("XDG_RUNTIME_DIR")
        .map(PathBuf::from)
        .filter(|path| path.is_absolute())
        .into_iter()
        .chain([std::env::temp_dir()])
        .collect()
}

impl Place {
    /// Makes a directory in the first of `parents` that takes one, and a listening socket in it.
    pub(super) fn make(parents: &[PathBuf]) -> Result<(Self, OwnedFd), HubError> {
        let place = Self {
            directory: make_directory(parents)?,
        };
        let listener = place.listen()?;
        Ok((place, listener))
    }

    pub(super) fn socket(&self) -> PathBuf {
        self.directory.join(SOCKET)
    }

    fn listen(&self) -> Result<OwnedFd, HubError> {
        let path = self.socket();
        let address =
            SocketAddrUnix::new(&path).map_err(|_| HubError::PathTooLong { path: path.clone() })?;
        let socket = seqpacket().map_err(io::Error::from)?;
        bind(&socket, &address).map_err(io::Error::from)?;
        // Nobody else can pass the directory meanwhile.
        fs::set_permissions(&path, Permissions::from_mode(0o600))?;
        let backlog = i32::try_from(CLIENTS_MAX).expect("a small constant");
        listen(&socket, backlog).map_err(io::Error::from)?;
        Ok(socket)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        remove(&self.socket());
    }
}

fn make_directory(parents: &[PathBuf]) -> Result<PathBuf, HubError> {
    let mut refused = (PathBuf::new(), io::Error::from(io::ErrorKind::NotFound));
    for parent in parents {
        remove_leftovers(parent);
        match make_directory_in(parent) {
            Ok(directory) => return Ok(directory),
            Err(error) => refused = (parent.clone(), error),
        }
    }
    let (tried, source) = refused;
    Err(HubError::NoDirectory { tried, source })
}

fn make_directory_in(parent: &Path) -> io::Result<PathBuf> {
    let process = std::process::id();
    for number in 0..HUBS_MAX {
        let directory = parent.join(format!("{PREFIX}{process}-{number}"));
        // Fails when the name is taken, so nobody can have put a directory of their own there.
        match DirBuilder::new().mode(0o700).create(&directory) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            result => return result.map(|()| directory),
        }
    }
    Err(io::Error::other("this process has too many buses"))
}

/// Removes what killed hubs left in `parent`.
fn remove_leftovers(parent: &Path) {
    let Ok(entries) = fs::read_dir(parent) else {
        return;
    };
    for entry in entries.flatten() {
        remove_leftover(&entry.path().join(SOCKET));
    }
}

/// Removes a hub's socket and directory when its process is gone: a hub that is about to listen has one.
fn remove_leftover(socket: &Path) {
    let process = socket
        .parent()
        .and_then(Path::file_name)
        .and_then(|name| name.to_str()?.strip_prefix(PREFIX)?.split_once('-'))
        .and_then(|(process, _)| Pid::from_raw(process.parse().ok()?));
    if process.is_some_and(|process| test_kill_process(process) == Err(Errno::SRCH)) {
        remove_silent(socket);
    }
}

/// Removes a hub's socket and directory when nobody listens there any more. For those who were its clients: a killed
/// process may still be waiting to be collected by its parent, and its connections may end a moment before its listener.
pub(crate) fn remove_silent(socket: &Path) {
    let clock = Clock::start();
    while clock.now() < LISTENER_PATIENCE {
        if nobody_listens(socket) {
            return remove(socket);
        }
        wait(LISTENER_PATIENCE / 50);
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "the bus has ended: nothing cyclic is left to hold up"
)]
fn wait(duration: Duration) {
    std::thread::sleep(duration);
}

fn nobody_listens(socket: &Path) -> bool {
    let Ok(address) = SocketAddrUnix::new(socket) else {
        return false;
    };
    seqpacket().is_ok_and(|probe| {
        matches!(
            connect(&probe, &address),
            Err(Errno::CONNREFUSED | Errno::NOENT)
        )
    })
}

/// Removes a socket and its directory. It may be gone already, or not be ours: then nothing is to be done.
fn remove(socket: &Path) {
    fs::remove_file(socket).ok();
    if let Some(directory) = socket.parent() {
        fs::remove_dir(directory).ok();
    }
}

fn seqpacket() -> Result<OwnedFd, Errno> {
    socket_with(
        AddressFamily::UNIX,
        SocketType::SEQPACKET,
        SocketFlags::CLOEXEC | SocketFlags::NONBLOCK,
        None,
    )
}
