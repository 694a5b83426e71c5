//! The files that a campaign plays and does not copy, such as FMUs. They must be the same for all of its rows.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use plan::Plan;
use runner::exit::{Exit, Failure};
use scenario::{HASH_SUFFIX, file_hash, hash_in, open_file};

/// Returns the failure of a file that changed or vanished meanwhile.
fn changed(path: &Path) -> Failure {
    let path = path.display();
    Exit::BenchFailed.because(format!(
        "{path} is gone or another file than at the start, and rows of both do not go together. What is done is kept: put the first one back and give the same command again, or do so for another campaign with the new one"
    ))
}

/// Identity of a file.
#[derive(PartialEq)]
struct Stamp {
    /// Number on the disk.
    inode: u64,
    bytes: u64,
    changed_at: SystemTime,
}

/// Files as they were at the start.
pub(super) struct Uncopied(Vec<(PathBuf, Option<Stamp>)>);

impl Uncopied {
    /// Stamps the files of a plan, which must be the same as when it was loaded.
    pub(super) fn new(plan: &Plan) -> Result<Self, Failure> {
        let files = plan.shared.tables.iter().filter_map(|(name, line)| {
            let file = name.strip_suffix(HASH_SUFFIX)?;
            Some((plan.shared.beside.place(file), hash_in(line)))
        });
        let stamped = files.map(|(path, hash)| {
            // The stamp is taken before the file is read, so that no change is missed.
            let stamp = stamp(&path);
            match open_file(&path).and_then(file_hash) {
                Ok(found) if found == hash => Ok((path, stamp)),
                _ => Err(changed(&path)),
            }
        });
        stamped.collect::<Result<_, _>>().map(Self)
    }

    /// Checks that all files are as they were.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let mut files = self.0.iter();
        match files.find(|(path, before)| stamp(path) != *before) {
            Some((path, _)) => Err(changed(path)),
            None => Ok(()),
        }
    }
}

fn stamp(path: &Path) -> Option<Stamp> {
    let found = path.metadata().ok()?;
    Some(Stamp {
        inode: found.ino(),
        bytes: found.len(),
        changed_at: found.modified().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};

    use super::*;
    use scenario::Beside;
    use worlds::catalogue::catalogue;

    #[test]
    fn a_file_that_is_replaced_or_gone_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.fmu");
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        let beside = Beside::new(&folder.path().join("s.toml"));
        let mut plan = Plan::parse_beside(&beside, text.to_owned(), catalogue()).unwrap();
        fs::write(&path, "one").unwrap();
        let hash = file_hash(File::open(&path).unwrap()).unwrap();
        let line = format!("{hash}  a.fmu\n");
        plan.shared.tables.insert("a.fmu.sha256".to_owned(), line);
        let files = Uncopied::new(&plan).unwrap();
        files.check().unwrap();
        let other = folder.path().join("other");
        fs::write(&other, "two").unwrap();
        fs::rename(&other, &path).unwrap();
        let error = files.check().unwrap_err();
        assert!(error.to_string().contains("a.fmu is gone or another file"));
        // The file changed between loading and start.
        assert!(Uncopied::new(&plan).is_err());
        fs::remove_file(&path).unwrap();
        assert!(files.check().is_err());
    }
}
