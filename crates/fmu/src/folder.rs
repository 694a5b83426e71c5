//! Folders for unpacked FMUs. A killed process cannot remove its folder, so the next process removes it.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Once;

use tempfile::TempDir;

/// Prefix of the folders' names.
const PREFIX: &str = "canrig-fmu-";
/// Name of the lock file. It stays locked while its owner lives; the system releases the lock however the owner ends.
const LOCK: &str = "lock";

/// A folder of this process below the system's folder for temporary files. It is removed when this is dropped.
#[derive(Debug)]
pub(crate) struct Folder {
    folder: TempDir,
    _lock: File,
}

impl Folder {
    /// Makes a folder. The first call in a process removes the folders of dead processes.
    pub(crate) fn new() -> io::Result<Self> {
        static TIDIED: Once = Once::new();
        let place = std::env::temp_dir();
        let folder = Self::below(&place)?;
        TIDIED.call_once(|| folder.remove_orphans(&place));
        Ok(folder)
    }

    fn below(place: &Path) -> io::Result<Self> {
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(place)?;
        let unlocked = folder.path().join("unlocked");
        let lock = File::create(&unlocked)?;
        // The file gets its name after it is locked, so a folder in use never looks like an orphan. If the file system
        // has no locks, no folder looks like one.
        if lock.lock().is_ok() {
            fs::rename(unlocked, folder.path().join(LOCK))?;
        }
        Ok(Self {
            folder,
            _lock: lock,
        })
    }

    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Removes the neighbouring folders of dead processes of the same user. A folder that cannot be removed stays.
    fn remove_orphans(&self, place: &Path) {
        let owner = |path: &Path| Some(path.symlink_metadata().ok()?.uid());
        let user = owner(self.path());
        let is_free = |lock: File| lock.try_lock().is_ok();
        for entry in fs::read_dir(place).into_iter().flatten().flatten() {
            let path = entry.path();
            let is_folder = entry.file_name().to_string_lossy().starts_with(PREFIX);
            if is_folder && owner(&path) == user && File::open(path.join(LOCK)).is_ok_and(is_free) {
                let _ = fs::remove_dir_all(path);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_goes_with_its_owner_or_with_the_next_one() {
        let place = tempfile::tempdir().unwrap();
        let is_there = |path: &Path| path.join("resources").exists();
        let made = || {
            let folder = Folder::below(place.path()).unwrap();
            fs::create_dir(folder.path().join("resources")).unwrap();
            folder
        };
        let dropped = made();
        let path = dropped.path().to_owned();
        drop(dropped);
        assert!(!path.exists());
        // This is the state after a kill: the folder exists, its lock is not held.
        let Folder {
            folder,
            _lock: lock,
        } = made();
        let orphan = folder.keep();
        let living = made();
        drop(lock);
        let beside = place.path().join("canrig-fmu-of-somebody");
        fs::create_dir_all(beside.join("resources")).unwrap();
        made().remove_orphans(place.path());
        assert!(!orphan.exists());
        assert!(is_there(living.path()) && is_there(&beside));
    }
}
