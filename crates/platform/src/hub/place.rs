//! Place of a hub's socket in the file system: a private directory, made for the run and removed after it.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::io::Errno;
use rustix::net::{SocketAddrUnix, SocketFlags, connect};
use rustix::process::{Pid, getppid, test_kill_process};

use crate::bus::{BusError, seqpacket};
use crate::clock::{Clock, sleep};
use crate::listener::Listener;
use crate::process::stat;

/// Prefix of a directory's name, `canrig-bus-<process>-<letters>`.
const PREFIX: &str = "canrig-bus-";
const SOCKET: &str = "socket";
/// Largest number of clients that wait to be accepted.
const WAITING_MAX: i32 = 32;

/// Longest time that a listener may outlive its connections while its process ends.
const LISTENER_PATIENCE: Duration = Duration::from_secs(1);
/// Period of the check meanwhile.
const LISTENER_LOOK: Duration = Duration::from_millis(10);

/// Index of the flags in `/proc/PID/stat` after the process's name, and the flag of an ending process (proc(5), `sched.h`).
const FLAGS_FIELD: usize = 6;
const PF_EXITING: u32 = 0x4;

/// Returns the directories to try: the user's runtime directory, then the one for temporary files.
pub(super) fn candidates() -> Vec<PathBuf> {
    let set = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let usable = set.into_iter().filter(|path| path.is_absolute());
    usable.chain([std::env::temp_dir()]).collect()
}

/// Makes a directory in the first of `parents` that takes one, and a listening socket in it.
pub(super) fn listen(parents: &[PathBuf]) -> Result<Listener, BusError> {
    let prefix = format!("{PREFIX}{}-", std::process::id());
    let mut refused = (PathBuf::new(), io::Error::from(io::ErrorKind::NotFound));
    for parent in parents {
        remove_leftovers(parent);
        match Listener::open_in(parent, &prefix, WAITING_MAX) {
            Ok(listener) => return Ok(listener),
            Err(error) => refused = (parent.clone(), error),
        }
    }
    let (tried, source) = refused;
    let advice = match source.kind() {
        io::ErrorKind::InvalidFilename => {
            "; set XDG_RUNTIME_DIR or TMPDIR to a directory with a shorter name"
        }
        io::ErrorKind::NotADirectory
        | io::ErrorKind::NotFound
        | io::ErrorKind::PermissionDenied
        | io::ErrorKind::QuotaExceeded
        | io::ErrorKind::ReadOnlyFilesystem
        | io::ErrorKind::StorageFull => {
            "; set XDG_RUNTIME_DIR or TMPDIR to a directory that you may write to"
        }
        _ => "",
    };
    Err(BusError(format!(
        "no socket for the bus could be made in {}: {source}{advice}",
        tried.display()
    )))
}

/// Returns the sockets of this user's hubs that are running.
pub(super) fn running_in(parents: &[PathBuf]) -> Vec<PathBuf> {
    let is_running = |socket: &PathBuf| socket.parent().is_some_and(is_mine) && is_served(socket);
    let found = parents.iter().flat_map(|parent| sockets_in(parent));
    let mut sockets = Vec::from_iter(found.filter(is_running));
    sockets.sort();
    sockets.dedup();
    sockets
}

/// Returns the sockets that the directories in `parent` would have if they were those of hubs.
fn sockets_in(parent: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    let entries = fs::read_dir(parent).into_iter().flatten().flatten();
    entries.map(|entry| entry.path().join(SOCKET))
}

fn is_mine(directory: &Path) -> bool {
    let owner = fs::symlink_metadata(directory).map(|metadata| metadata.uid());
    owner.is_ok_and(|owner| owner == rustix::process::geteuid().as_raw())
}

/// Returns whether the process in the directory's name lives; connecting would disturb its hub.
fn is_served(socket: &Path) -> bool {
    owner(socket).is_some_and(|process| test_kill_process(process).is_ok()) && socket.exists()
}

/// Removes from `parent` the sockets and directories of hubs whose process is gone. A hub that is about to listen has a process;
/// one that listens may have its process in another PID namespace.
fn remove_leftovers(parent: &Path) {
    let is_gone = |process| test_kill_process(process) == Err(Errno::SRCH);
    for socket in sockets_in(parent) {
        if owner(&socket).is_some_and(is_gone) && nobody_listens(&socket) {
            remove(&socket);
        }
    }
}

/// Removes the socket of a killed bench, at the end of a node's process that the bench started. A node may reach its safe state
/// before it notices that the bus has ended, and before a killed bench on a busy machine is gone; the listener may outlive the
/// connections for a moment.
pub fn remove_orphaned(socket: &Path) {
    let has_lost = |process| getppid() != Some(process) || is_ending(process);
    if !owner(socket).is_some_and(has_lost) {
        return;
    }
    let clock = Clock::start();
    while clock.now() < LISTENER_PATIENCE {
        if nobody_listens(socket) {
            return remove(socket);
        }
        sleep(LISTENER_LOOK);
    }
}

/// Returns whether a process is ending: the kernel closes its files in any order, and reassigns its children last.
fn is_ending(process: Pid) -> bool {
    stat(process, FLAGS_FIELD).is_some_and(|flags| flags & PF_EXITING != 0)
}

/// Returns the process in the name of the socket's directory.
fn owner(socket: &Path) -> Option<Pid> {
    let directory = socket.parent()?.file_name()?.to_str()?;
    let (process, _) = directory.strip_prefix(PREFIX)?.split_once('-')?;
    Pid::from_raw(process.parse().ok()?)
}

fn nobody_listens(socket: &Path) -> bool {
    let Ok(address) = SocketAddrUnix::new(socket) else {
        return false;
    };
    seqpacket(SocketFlags::NONBLOCK).is_ok_and(|probe| {
        matches!(
            connect(&probe, &address),
            Err(Errno::CONNREFUSED | Errno::NOENT)
        )
    })
}

/// Removes a socket and its directory. Errors do not matter: they may be gone already, or belong to another user.
fn remove(socket: &Path) {
    fs::remove_file(socket).ok();
    if let Some(directory) = socket.parent() {
        fs::remove_dir(directory).ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A process that was killed and not collected is ending; this one is not.
    #[test]
    fn a_process_that_ends_is_known_before_it_is_gone() {
        let pid = |number: u32| Pid::from_raw(i32::try_from(number).unwrap()).unwrap();
        assert!(!is_ending(pid(std::process::id())));
        let mut child = std::process::Command::new("sleep")
            .arg("60")
            .spawn()
            .unwrap();
        assert!(!is_ending(pid(child.id())));
        child.kill().unwrap();
        let clock = Clock::start();
        while !is_ending(pid(child.id())) {
            assert!(clock.now() < LISTENER_PATIENCE, "it does not end");
            sleep(LISTENER_LOOK);
        }
        child.wait().unwrap();
        assert!(!is_ending(pid(i32::MAX as u32)));
    }

    #[test]
    fn only_hubs_that_live_are_running() {
        let parent = std::env::temp_dir().join(format!("canrig-place-{}", std::process::id()));
        fs::create_dir(&parent).unwrap();
        let parents = [parent.clone()];
        assert_eq!(running_in(&parents), Vec::<PathBuf>::new());
        let listener = listen(&parents).unwrap();
        // Leftovers of a killed hub: no process has this number, which is beyond the kernel's limit.
        let leftover = parent.join(format!("{PREFIX}{}-0", i32::MAX));
        fs::create_dir(&leftover).unwrap();
        fs::write(leftover.join(SOCKET), "").unwrap();
        fs::create_dir(parent.join("something else")).unwrap();
        assert_eq!(running_in(&parents), [listener.path()]);
        drop(listener);
        assert_eq!(running_in(&parents), Vec::<PathBuf>::new());
        fs::remove_dir_all(parent).unwrap();
    }

    /// Another container that shares the directory has processes of its own.
    #[test]
    fn a_leftover_is_removed_only_if_nobody_listens() {
        let parent = tempfile::tempdir().unwrap();
        let directory = parent.path().join("canrig-bus-2147483647-x");
        fs::create_dir(&directory).unwrap();
        let path = directory.join(SOCKET);
        let socket = seqpacket(SocketFlags::NONBLOCK).unwrap();
        rustix::net::bind(&socket, &SocketAddrUnix::new(&path).unwrap()).unwrap();
        rustix::net::listen(&socket, WAITING_MAX).unwrap();
        remove_leftovers(parent.path());
        assert!(path.exists());
        drop(socket);
        // A process that another test starts listens, too, until it is another program.
        let clock = Clock::start();
        while directory.exists() && clock.now() < LISTENER_PATIENCE {
            remove_leftovers(parent.path());
            sleep(LISTENER_LOOK);
        }
        assert!(!directory.exists());
    }

    #[test]
    fn a_node_removes_the_socket_of_a_bench_that_is_gone_only() {
        let parent = tempfile::tempdir().unwrap();
        let left_by = |process: Pid| {
            let directory = parent
                .path()
                .join(format!("{PREFIX}{}-x", process.as_raw_nonzero()));
            fs::create_dir(&directory).unwrap();
            let socket = directory.join(SOCKET);
            fs::write(&socket, "").unwrap();
            remove_orphaned(&socket);
            directory.exists()
        };
        let bench = getppid().unwrap();
        assert!(left_by(bench), "it lives");
        assert!(!left_by(rustix::process::getpid()), "it is not the parent");
    }

    #[test]
    fn advice_is_given_where_another_directory_helps() {
        let refusal = |parent: PathBuf| listen(&[parent]).unwrap_err().to_string();
        let parent = tempfile::tempdir().unwrap();
        let missing = refusal(parent.path().join("missing"));
        assert!(missing.ends_with("that you may write to"), "{missing}");
        let long = parent.path().join("long".repeat(25));
        fs::create_dir(&long).unwrap();
        let too_long = refusal(long);
        assert!(too_long.ends_with("with a shorter name"), "{too_long}");
    }
}
