//! Files and folders that a program has begun to write and not finished. A signal that ends the program at once removes them
//! first.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::stop;

static PATHS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// File or folder that is removed when a signal ends the program. Its owner must rename or remove it before the drop.
#[derive(Debug)]
pub struct Unfinished(PathBuf);

impl Unfinished {
    /// Makes the file or folder. No signal ends the program before its path is known.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn begin<T, E>(
        make: impl FnOnce() -> Result<T, E>,
        path: impl FnOnce(&T) -> PathBuf,
    ) -> Result<(T, Self), E> {
        let mut paths = paths();
        stop::end_at_once_after(remove_all);
        let made = make()?;
        let path = path(&made);
        paths.insert(path.clone());
        Ok((made, Self(path)))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        paths().remove(&self.0);
    }
}

fn paths() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    PATHS.lock().unwrap_or_else(PoisonError::into_inner)
}

fn remove_all() {
    let paths = paths();
    for path in &*paths {
        let _ = if path.is_dir() {
            fs::remove_dir_all(path)
        } else {
            fs::remove_file(path)
        };
    }
    // The lock stays held: a thread that misses a removed file waits in `drop` until the program ends, and reports no error.
    std::mem::forget(paths);
}
