//! What a program has begun to write and not ended: a signal that ends the program at once removes it first.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::stop;

static PATHS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// A file or a folder that is removed when a signal ends the program. Whoever has it removes it, or gives it its name, before.
#[derive(Debug)]
pub struct Unfinished(PathBuf);

impl Unfinished {
    /// Makes it; no signal ends the program between that and when its path is known.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn begin<T, E>(
        make: impl FnOnce() -> Result<T, E>,
        path: impl FnOnce(&T) -> PathBuf,
    ) -> Result<(T, Self), E> {
        let mut paths = paths();
        stop::end_at_once_after(remove_all);
        match make() {
            Ok(made) => {
                let path = path(&made);
                paths.insert(path.clone());
                Ok((made, Self(path)))
            }
            Err(error) => {
                look_for_others(&paths);
                Err(error)
            }
        }
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        let mut paths = paths();
        paths.remove(&self.0);
        look_for_others(&paths);
    }
}

fn look_for_others(paths: &BTreeSet<PathBuf>) {
    if paths.is_empty() {
        stop::end_at_once_after_nothing();
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
    // Who misses what was removed waits for the end, and has nothing to say about it.
    std::mem::forget(paths);
}
