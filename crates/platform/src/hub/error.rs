//! Error at the start of a hub.

use std::io;
use std::path::PathBuf;

/// Reason why there is no hub.
#[derive(Debug, thiserror::Error)]
pub enum HubError {
    /// The directory for the socket has too long a name.
    #[error(
        "the bus's socket {path} would exceed {limit} bytes; set XDG_RUNTIME_DIR or TMPDIR to a shorter directory",
        path = path.display(), limit = crate::bus::PATH_BYTES_MAX
    )]
    PathTooLong {
        /// The path.
        path: PathBuf,
    },
    /// No directory takes the socket.
    #[error("no directory for the bus's socket could be made in {tried}: {source}; set XDG_RUNTIME_DIR or TMPDIR to one that you may write to", tried = tried.display())]
    NoDirectory {
        /// Last directory that was tried.
        tried: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Anything else.
    #[error("the embedded bus could not be started: {0}")]
    System(#[from] io::Error),
}
