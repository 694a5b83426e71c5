//! Error of a file of a run that cannot be written.

use std::io;
use std::path::{Path, PathBuf};

/// Error: a file of a run cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("`{}` cannot be written: {source}", path.display())]
pub struct WriteError {
    pub path: PathBuf,
    pub source: io::Error,
}

impl WriteError {
    /// Returns a function for `map_err` that makes the error of a file.
    pub fn at(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self { path, source }
    }
}
