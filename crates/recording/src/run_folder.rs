//! Folder of one run. Files appear in it whole or not at all. A folder may be foreign, so no file is read or written through a
//! link that leads out of it; the links to FMUs, which the nodes follow, are the exception.

use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use platform::unfinished::Unfinished;
use sha2::{Digest, Sha256};
use tempfile::TempPath;

use crate::bus_log::{BusLog, has_name};
use scenario::{hexadecimal, require_file};

pub use crate::write_error::WriteError;

/// Largest number of runs of one scenario, seed and version in one folder.
const REPEATS_MAX: u32 = 100_000;

/// Names of the files in a run folder.
pub mod file {
    /// Scenario as it was run.
    pub const SCENARIO: &str = "scenario.toml";
    /// Frames, as `candump -L`.
    pub const BUS_LOG: &str = "bus.log";
    /// Frames of a long run, compressed: `zstd -d` reads it.
    pub const LONG_BUS_LOG: &str = "bus.log.zst";
    /// Signals, one row a cycle.
    pub const SIGNALS: &str = "signals.csv";
    /// Signals of a long run, as Apache Parquet.
    pub const LONG_SIGNALS: &str = "signals.parquet";
    /// Verdict.
    pub const VERDICT: &str = "verdict.json";
    /// Verdict for CI systems.
    pub const JUNIT: &str = "junit.xml";
    /// Report of the run on one page.
    pub const REPORT: &str = "report.html";
    /// Stalls of the machine; only of runs in real time.
    pub const STALLS: &str = "stalls.csv";
    /// Frames that canrig's nodes sent; only of runs in real time.
    pub const SENT: &str = "sent.csv";
    /// Frames, values and nodes that the scenario's faults hit; only of runs with faults.
    pub const HITS: &str = "hits.csv";
    /// Reasons of canrig's nodes to leave their duties; only of runs with faults of the bus.
    pub const REASONS: &str = "reasons.csv";
    /// Frames that no node of the run sent; only where the sender of each frame is known.
    pub const FOREIGN: &str = "foreign.csv";
    /// Meaning of the frames, as a DBC.
    pub const FRAMES: &str = "frames.dbc";
    /// Folder of the nodes' data sheets; only in runs on a rig that names its nodes.
    pub const SHEETS: &str = "eds";
    /// Recording for the Rerun viewer.
    pub const RERUN: &str = "run.rrd";
    /// Time of the run, and values of the command line.
    pub const PLAYED: &str = "played.json";
    /// First file with rows of a sweep or of torture: a folder that has it is not a run's.
    pub const ROWS: &str = "rows.jsonl";
    /// Folder of the files of an engine that plays a sweep or torture.
    pub const ENGINE: &str = "engine";
}

#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes the empty folder `<parent>/<name>-<hash>`. A second run gets a numbered suffix; no file is overwritten.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn create(parent: &Path, name: &str, seed: u64, text: &str) -> Result<Self, WriteError> {
        fs::create_dir_all(parent).map_err(WriteError::at(parent))?;
        let base = format!("{}-{}", slug(name), hash(seed, text));
        let path = create_numbered(parent, &base).map_err(WriteError::at(&parent.join(&base)))?;
        Ok(Self { path })
    }

    /// Returns the path of the folder `<parent>/<name>-<id>`, whether or not it exists.
    pub fn lasting_path(parent: &Path, name: &str, id: &str) -> PathBuf {
        parent.join(format!("{}-{id}", slug(name)))
    }

    /// Makes or opens the folder `<parent>/<name>-<id>`, in which interrupted work is resumed. Scenarios differ by the id.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn lasting(parent: &Path, name: &str, id: &str) -> Result<Self, WriteError> {
        let path = Self::lasting_path(parent, name, id);
        fs::create_dir_all(&path).map_err(WriteError::at(&path))?;
        Ok(Self { path })
    }

    /// Returns the scenario's copy in the folder.
    pub fn scenario(&self) -> PathBuf {
        self.path.join(file::SCENARIO)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes one file as a whole: a reader sees the old one or the new one. Makes a folder in its name.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        self.write_with(name, |output| output.write_all(bytes))
    }

    /// As [`RunFolder::write`], unless the file exists with these very bytes.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn ensure(&self, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        match file_in(&self.path, name).and_then(|path| has_bytes(&path, bytes)) {
            Ok(true) => Ok(()),
            Ok(false) | Err(_) => self.write(name, bytes),
        }
    }

    /// As [`RunFolder::write`], for content that is too long for memory.
    ///
    /// # Errors
    /// If the file cannot be written, or `write` failed.
    pub fn write_with(
        &self,
        name: &str,
        write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
    ) -> Result<(), WriteError> {
        let made = self.make_parent(Path::new(name));
        let path = self.path.join(name);
        let written = made.and_then(|()| write_whole(&path, write));
        written.map_err(WriteError::at(&path))
    }

    /// Makes a link to a file elsewhere. Makes a folder in its name; an existing file stays.
    ///
    /// # Errors
    /// If the link cannot be made.
    pub fn link(&self, name: &Path, target: &Path) -> Result<(), WriteError> {
        let path = self.path.join(name);
        let made = self.make_parent(name);
        let made = made.and_then(|()| match symlink(target, &path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
            made => made,
        });
        made.map_err(WriteError::at(&path))
    }

    /// Makes the folder in a name, which lies in this one.
    fn make_parent(&self, name: &Path) -> io::Result<()> {
        let below = name.parent().unwrap_or(Path::new(""));
        for part in below.ancestors() {
            file_in(&self.path, part)?;
        }
        fs::create_dir_all(self.path.join(below))
    }

    /// Opens the log, which grows during the run: `bus.log`, or the log of a long run.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn bus_log(&self, is_long: bool) -> Result<BusLog, WriteError> {
        let name = if is_long {
            file::LONG_BUS_LOG
        } else {
            file::BUS_LOG
        };
        BusLog::create(self.path.join(name))
    }
}

/// Returns the path of a file in a folder that may be foreign. The file need not exist.
///
/// # Errors
/// If it is a link that leads out of the folder, or lies behind one.
pub fn file_in(folder: &Path, name: impl AsRef<Path>) -> io::Result<PathBuf> {
    let path = folder.join(name);
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    // A dangling link leads out of it, too.
    let target = path.canonicalize().or_else(|_| path.read_link());
    match (target, folder.canonicalize()) {
        (Ok(target), Ok(folder)) if !target.starts_with(&folder) => {
            let target = target.display();
            let reason = format!("it is a link that leads out of its folder, to {target}");
            Err(io::Error::other(reason))
        }
        _ => Ok(path),
    }
}

/// Reads a table of a run folder: a header, then rows, each made of its cells. Without the file there are none.
///
/// # Errors
/// If the file cannot be read, or is not of that form.
pub(crate) fn read_rows<T, const COLUMNS: usize>(
    folder: &Path,
    name: &str,
    bytes_max: u64,
    header: &str,
    row: impl Fn([&str; COLUMNS]) -> Option<T>,
) -> io::Result<Vec<T>> {
    match read_text_in(folder, name, bytes_max)? {
        Some(text) => parse_rows(&text, header, row)
            .map_err(|reason| io::Error::new(io::ErrorKind::InvalidData, reason)),
        None => Ok(Vec::new()),
    }
}

/// Reads a text file of a run folder; `None` if there is none.
pub(crate) fn read_text_in(
    folder: &Path,
    name: &str,
    bytes_max: u64,
) -> io::Result<Option<String>> {
    match scenario::read_text(&file_in(folder, name)?, bytes_max) {
        Ok(text) => Ok(Some(text)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Parses such a table.
pub(crate) fn parse_rows<T, const COLUMNS: usize>(
    text: &str,
    header: &str,
    row: impl Fn([&str; COLUMNS]) -> Option<T>,
) -> Result<Vec<T>, String> {
    let mut lines = (1_u32..).zip(text.lines());
    if lines.next().is_none_or(|(_, first)| first != header) {
        return Err(format!("line 1: {header} is expected"));
    }
    let parsed = lines.map(|(number, line)| {
        let cells = Vec::from_iter(line.split(',')).try_into().ok();
        cells
            .and_then(&row)
            .ok_or_else(|| format!("line {number}: {header} is expected: \"{line}\""))
    });
    parsed.collect()
}

/// Returns the name of the log in a run folder. A plain log next to that of a long run is a decompressed copy, perhaps a partial
/// one.
pub fn log_in(folder: &Path) -> &'static str {
    // A dangling link counts, too: its reader refuses it.
    match folder.join(file::LONG_BUS_LOG).symlink_metadata() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => file::BUS_LOG,
        _ => file::LONG_BUS_LOG,
    }
}

/// Writes a user's output file, as [`write_whole`] does, at the target of a link. A device or a pipe, which cannot be replaced,
/// is written to.
///
/// # Errors
/// If the file cannot be written, or `write` failed.
pub fn write_output(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    if path.metadata().is_ok_and(|found| !found.is_file()) {
        let mut output = BufWriter::new(OpenOptions::new().write(true).open(path)?);
        write(&mut output)?;
        return output.flush();
    }
    let found = fs::canonicalize(path);
    write_whole(found.as_deref().unwrap_or(path), write)
}

/// Writes a file as a whole: it is on the disk when it gets its name. A link in its place is replaced, not followed.
///
/// # Errors
/// As [`replace`], and if the file cannot be written.
pub fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    replace(path, |file| {
        let mut output = BufWriter::new(file);
        write(&mut output)?;
        output.into_inner()?.sync_data()
    })
}

/// Replaces a file: `write` writes the new one under another name, which changes when the file is complete. It gets an empty file
/// that can be read, too, and that is locked as long as it is open, if the file system has locks. A link in its place is
/// replaced, not followed.
///
/// # Errors
/// If there is something other than a file in its place, or `write` failed.
pub fn replace<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(File) -> Result<(), E>,
) -> Result<(), E> {
    if path.exists() && !path.is_symlink() {
        require_file(path)?;
    }
    let begin = || create_partial(path);
    let ((file, partial), _unfinished) =
        Unfinished::begin(begin, |(_, partial)| partial.to_path_buf())?;
    // No other process may write it until it has its name.
    let _lock = file.try_clone()?;
    write(file)?;
    // Until here its drop, also after an error, removes it: on a full disk it occupies the missing room.
    Ok(partial.persist(path).map_err(|error| error.error)?)
}

/// Returns the temporary file in which a file begins: `NAME.partial`, even if a killed program left one. A second writer of the
/// same file meanwhile uses another one, `NAME.<random>.partial`. So does a writer that finds a link or another non-file there.
fn create_partial(path: &Path) -> io::Result<(File, TempPath)> {
    let usual = path.with_added_extension("partial");
    if let Some(file) = locked(&usual) {
        let partial = TempPath::try_from_path(usual)?;
        file.set_len(0)?;
        return Ok((file, partial));
    }
    let mut prefix = path.file_name().unwrap_or_default().to_owned();
    prefix.push(".");
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let partial = tempfile::Builder::new()
        .prefix(&prefix)
        .suffix(".partial")
        // Restricted by the user's own mask.
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder)?;
    // No other process knows it, so only a file system without locks refuses.
    let _ = partial.as_file().try_lock();
    Ok(partial.into_parts())
}

/// Returns a file that this program has locked; `None` if another one has it, or if there can be none.
fn locked(path: &Path) -> Option<File> {
    let is_free = fs::symlink_metadata(path).map_or(true, |found| found.is_file());
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    let file = is_free.then(|| options.open(path))?.ok()?;
    let file = file.try_lock().is_ok().then_some(file)?;
    // The previous holder may have renamed it meanwhile.
    has_name(&file, path).then_some(file)
}

/// Returns whether a file has these bytes.
fn has_bytes(path: &Path, bytes: &[u8]) -> io::Result<bool> {
    require_file(path)?;
    Ok(path.metadata()?.len() == bytes.len() as u64 && fs::read(path)? == bytes)
}

/// As [`write_whole`], for a file that does not exist yet. Makes a folder in its name.
///
/// # Errors
/// As [`write_whole`], and if a file of that name exists.
pub fn write_new(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    if path.symlink_metadata().is_ok() {
        let there =
            "it is there already; remove it, or name another place (nothing is overwritten)";
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, there));
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => {
            io::Error::other(format!("`{}` is not a folder", folder.display()))
        }
        _ => error,
    })?;
    write_whole(path, write)
}

fn create_numbered(parent: &Path, base: &str) -> io::Result<PathBuf> {
    for number in 1..=REPEATS_MAX {
        let name = if number == 1 {
            base.to_owned()
        } else {
            format!("{base}-{number}")
        };
        let path = parent.join(name);
        match fs::create_dir(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
            Ok(()) => return Ok(path),
        }
    }
    let full = format!(
        "{} holds {REPEATS_MAX} runs of {base}; remove some",
        parent.display()
    );
    Err(io::Error::new(io::ErrorKind::AlreadyExists, full))
}

/// Returns a name that every file system takes: lower-case letters, digits and single dashes.
fn slug(name: &str) -> String {
    let mut slug = String::new();
    for character in name.chars().take(60) {
        if character.is_ascii_alphanumeric() {
            slug.push(character.to_ascii_lowercase());
        } else if !slug.ends_with('-') && !slug.is_empty() {
            slug.push('-');
        }
    }
    let slug = slug.trim_end_matches('-');
    if slug.is_empty() {
        "run".to_owned()
    } else {
        slug.to_owned()
    }
}

/// Returns eight digits that identify scenario, seed and version.
fn hash(seed: u64, text: &str) -> String {
    let mut hasher = Sha256::new();
    hasher.update(env!("CARGO_PKG_VERSION"));
    hasher.update(seed.to_le_bytes());
    hasher.update(text);
    hexadecimal(&hasher.finalize()[..4])
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt;

    use super::*;

    #[test]
    fn a_name_becomes_a_folder_name() {
        assert_eq!(
            slug("25 mm step, from a warm hold!"),
            "25-mm-step-from-a-warm-hold"
        );
        assert_eq!(slug("../../etc"), "etc");
        assert_eq!(slug("ψ"), "run");
    }

    #[test]
    fn a_run_that_is_played_again_has_another_folder() {
        let parent = tempfile::tempdir().unwrap();
        let names = [(); 3].map(|()| {
            let path = create_numbered(parent.path(), "run").unwrap();
            path.file_name().unwrap().to_owned()
        });
        assert_eq!(names, ["run", "run-2", "run-3"]);
        fs::write(parent.path().join("file"), "").unwrap();
        create_numbered(&parent.path().join("file"), "run").unwrap_err();
    }

    #[test]
    fn the_log_of_a_long_run_is_its_compressed_one_whatever_is_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let [log, long] = [file::BUS_LOG, file::LONG_BUS_LOG].map(|name| folder.path().join(name));
        assert_eq!(log_in(folder.path()), file::BUS_LOG);
        fs::write(&log, "").unwrap();
        assert_eq!(log_in(folder.path()), file::BUS_LOG);
        symlink(&long, &long).unwrap();
        assert_eq!(log_in(folder.path()), file::LONG_BUS_LOG);
        fs::remove_file(&long).unwrap();
        fs::write(&long, "").unwrap();
        assert_eq!(log_in(folder.path()), file::LONG_BUS_LOG);
    }

    #[test]
    fn a_file_is_the_old_one_until_the_new_one_is_whole() {
        let parent = tempfile::tempdir().unwrap();
        let folder = RunFolder::lasting(parent.path(), "run", "1").unwrap();
        let read = || fs::read_to_string(folder.path().join("file")).unwrap();
        folder.write("file", b"the old one").unwrap();
        let failed = folder.write_with("file", |output| {
            output.write_all(b"half of the new one")?;
            output.flush()?;
            assert_eq!(read(), "the old one");
            Err(io::Error::other("the disk is full"))
        });
        let error = failed.unwrap_err().to_string();
        assert!(
            error.ends_with("file` cannot be written: the disk is full"),
            "{error}"
        );
        assert_eq!(read(), "the old one");
        folder.write("file", b"the new one").unwrap();
        assert_eq!(read(), "the new one");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_is_missing_in_a_lasting_folder_or_differs_is_written_again() {
        let parent = tempfile::tempdir().unwrap();
        let make = || {
            let folder = RunFolder::lasting(parent.path(), "run", "1")?;
            folder.ensure("table.csv", b"table")?;
            folder.ensure(file::SCENARIO, b"scenario")
        };
        let path = |name: &str| parent.path().join("run-1").join(name);
        make().unwrap();
        let rows = path("rows.jsonl");
        fs::write(&rows, "rows").unwrap();
        let inode = || path("table.csv").metadata().unwrap().ino();
        let before = inode();
        for damage in [&|| fs::remove_file(path(file::SCENARIO)).unwrap(), &|| {
            fs::write(path(file::SCENARIO), "").unwrap()
        }] as [&dyn Fn(); 2]
        {
            damage();
            make().unwrap();
            assert_eq!(fs::read(path(file::SCENARIO)).unwrap(), b"scenario");
            // An unchanged file is left alone.
            assert_eq!(inode(), before);
        }
        assert_eq!(fs::read(rows).unwrap(), b"rows");
    }

    #[test]
    fn two_who_replace_a_file_at_once_write_different_files_and_follow_no_link() {
        let folder = tempfile::tempdir().unwrap();
        let (path, theirs) = (folder.path().join("file"), folder.path().join("theirs"));
        fs::write(&theirs, "theirs").unwrap();
        symlink(&theirs, folder.path().join("file.partial")).unwrap();
        write_whole(&path, |output| {
            output.write_all(b"slow ")?;
            output.flush()?;
            write_whole(&path, |other| other.write_all(b"fast"))?;
            assert_eq!(fs::read(&path)?, b"fast");
            output.write_all(b"one")
        })
        .unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"slow one");
        assert_eq!(fs::read(&theirs).unwrap(), b"theirs");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn what_is_behind_a_link_that_leads_out_of_a_folder_is_no_part_of_it() {
        let parent = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(parent.path(), "run", 1, "").unwrap();
        let place = |name: &str| folder.path().join(name);
        let theirs = parent.path().join("theirs");
        fs::create_dir_all(theirs.join("below")).unwrap();
        fs::write(theirs.join("file"), "theirs").unwrap();
        fs::write(place("own"), "own").unwrap();
        let links = [
            ("inside", place("own")),
            ("file", theirs.join("file")),
            ("folder", theirs.clone()),
            ("nowhere", theirs.join("nothing")),
            ("itself", place("itself")),
        ];
        for (name, target) in links {
            symlink(target, place(name)).unwrap();
        }
        for name in ["own", "inside", "missing", "missing/too", "itself", ""] {
            file_in(folder.path(), name).unwrap();
        }
        for name in ["file", "folder", "folder/file", "nowhere"] {
            let error = file_in(folder.path(), name).unwrap_err().to_string();
            assert!(error.contains("leads out of its folder, to /"), "{error}");
        }
        // The folder itself may be reached by a link.
        let link = parent.path().join("link");
        symlink(folder.path(), &link).unwrap();
        file_in(&link, "own").unwrap();
        for name in ["folder/new", "folder/below/new", "nowhere/new"] {
            folder.write(name, b"ours").unwrap_err();
            folder.link(Path::new(name), &theirs).unwrap_err();
        }
        for name in ["file", "nowhere", "folder"] {
            folder.write(name, b"ours").unwrap();
            assert_eq!(fs::read(place(name)).unwrap(), b"ours");
            assert!(!place(name).is_symlink());
        }
        assert_eq!(fs::read(theirs.join("file")).unwrap(), b"theirs");
        assert_eq!(fs::read_dir(&theirs).unwrap().count(), 2);
        assert_eq!(fs::read_dir(theirs.join("below")).unwrap().count(), 0);
        // A link to a file with the wanted bytes is replaced by a copy.
        symlink(theirs.join("file"), place("copied")).unwrap();
        folder.ensure("copied", b"theirs").unwrap();
        assert!(!place("copied").is_symlink());
    }

    #[test]
    fn what_a_killed_program_left_of_a_file_is_written_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(path.with_added_extension("partial"), "left by another").unwrap();
        write_whole(&path, |output| output.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn the_hash_keeps_seeds_and_texts_apart() {
        assert_ne!(hash(1, "a"), hash(2, "a"));
        assert_ne!(hash(1, "a"), hash(1, "b"));
        assert_eq!(hash(1, "a").len(), 8);
    }
}
