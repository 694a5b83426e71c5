//! The rows of a sweep on the disk: lines of JSON in the order of the cases, each appended when its turn comes. Whatever
//! happens, the file is the beginning of what it becomes, at most with a torn line at its end.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Shard;
use super::plan::SweepPlan;
use super::row::SweepRow;

/// Name of the file.
pub(super) const FILE: &str = "rows.jsonl";
/// Longest line; a row has some hundred bytes, with a hundred checks some ten thousand.
const LINE_BYTES_MAX: u64 = 1 << 20;
/// Rows that a power cut may cost; a kill of the program costs none.
const UNSYNCED_MAX: usize = 32;

/// The first line: whose rows these are.
#[derive(Clone, Debug, Deserialize, Eq, PartialEq, Serialize)]
pub(super) struct Header {
    /// Version of the format.
    schema: u32,
    /// The program's version.
    pub(super) version: String,
    /// The sweep, as [`SweepPlan::id`] names it.
    pub(super) sweep: String,
    /// Cases of the whole sweep.
    pub(super) runs: usize,
    /// Which of them are here.
    pub(super) shard: Shard,
}

impl Header {
    /// What this program would write.
    pub(super) fn new(plan: &SweepPlan, shard: Shard) -> Self {
        Self {
            schema: 1,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            sweep: plan.id().to_owned(),
            runs: plan.runs(),
            shard,
        }
    }
}

/// Why the rows cannot be used.
#[derive(Debug, thiserror::Error)]
pub(super) enum StoreError {
    #[error("{} cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("{} cannot be written: {source}. What is done is kept: make room, and give the same command again", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("another canrig is at work on {}", path.display())]
    Busy { path: PathBuf },
    #[error("{} holds the rows of another sweep; move it away", path.display())]
    Foreign { path: PathBuf },
    #[error("line {line} of {} is damaged; `canrig sweep` plays from there on again", path.display())]
    Damaged { path: PathBuf, line: usize },
}

/// Rows that grow.
#[derive(Debug)]
pub(super) struct Store {
    path: PathBuf,
    file: File,
    unsynced: usize,
}

/// What a store had when it was opened.
#[derive(Debug)]
pub(super) struct Recovered {
    /// Cases that are done: the first of the shard.
    pub(super) done: usize,
    /// Lines from a torn or damaged one on, which were dropped.
    pub(super) dropped: usize,
}

impl Store {
    /// Opens the rows in a folder, or begins them. They are this program's alone until it ends.
    pub(super) fn open(folder: &Path, header: &Header) -> Result<(Self, Recovered), StoreError> {
        let path = folder.join(FILE);
        let options = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path);
        let file = options.map_err(|source| StoreError::Write {
            path: path.clone(),
            source,
        })?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => return Err(StoreError::Busy { path }),
            // A file system without locks has to do without.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        let mut store = Self {
            path,
            file,
            unsynced: 0,
        };
        let found = store.recover(header)?;
        Ok((store, found))
    }

    /// Finds the last whole row, and cuts off what is behind it.
    fn recover(&mut self, header: &Header) -> Result<Recovered, StoreError> {
        let mut lines = Lines::new(&self.path, &self.file);
        let mut sound = 0;
        let mut done = 0;
        if let Some(found) = lines.next::<Header>()? {
            if found != *header {
                return Err(StoreError::Foreign {
                    path: self.path.clone(),
                });
            }
            sound = lines.end;
            let mut cases = header.shard.cases(header.runs);
            while let Some(row) = lines.next::<SweepRow>()? {
                if cases.next() != Some(row.case) {
                    break;
                }
                sound = lines.end;
                done += 1;
            }
        }
        let length = self
            .file
            .metadata()
            .map_err(|source| self.refused(source))?
            .len();
        let dropped = if length > sound { 1 + lines.rest()? } else { 0 };
        let cut = self
            .file
            .set_len(sound)
            .and_then(|()| self.file.seek(SeekFrom::Start(sound)));
        cut.map_err(|source| self.refused(source))?;
        if sound == 0 {
            self.write(header)?;
        }
        Ok(Recovered { done, dropped })
    }

    /// Appends a row.
    pub(super) fn append(&mut self, row: &SweepRow) -> Result<(), StoreError> {
        self.write(row)?;
        self.unsynced += 1;
        if self.unsynced >= UNSYNCED_MAX {
            self.sync()?;
        }
        Ok(())
    }

    /// Waits until the disk has everything.
    pub(super) fn sync(&mut self) -> Result<(), StoreError> {
        self.unsynced = 0;
        self.file.sync_data().map_err(|source| self.refused(source))
    }

    fn write(&mut self, line: &impl Serialize) -> Result<(), StoreError> {
        let mut text = serde_json::to_vec(line).expect("plain data");
        text.push(b'\n');
        self.file
            .write_all(&text)
            .map_err(|source| self.refused(source))
    }

    fn refused(&self, source: io::Error) -> StoreError {
        StoreError::Write {
            path: self.path.clone(),
            source,
        }
    }
}

/// The header of the rows in a folder, and the rows.
pub(super) fn read(folder: &Path) -> Result<(Header, StoredRows), StoreError> {
    let path = folder.join(FILE);
    let file = File::open(&path).map_err(|source| StoreError::Read {
        path: path.clone(),
        source,
    })?;
    let mut lines = Lines::new(&path, file);
    let header = lines.next()?.ok_or(StoreError::Damaged { path, line: 1 })?;
    Ok((header, StoredRows(lines)))
}

/// The rows of a file in their order.
pub(super) struct StoredRows(Lines<File>);

impl Iterator for StoredRows {
    type Item = Result<SweepRow, StoreError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_at_end {
            return None;
        }
        match self.0.next() {
            Ok(Some(row)) => return Some(Ok(row)),
            Ok(None) if self.0.is_at_end => return None,
            Ok(None) => {}
            Err(error) => {
                self.0.is_at_end = true;
                return Some(Err(error));
            }
        }
        // What is behind a damaged line is not to be trusted.
        self.0.is_at_end = true;
        let (path, line) = (self.0.path.clone(), self.0.number);
        Some(Err(StoreError::Damaged { path, line }))
    }
}

/// Lines of JSON, read one at a time.
struct Lines<R> {
    path: PathBuf,
    input: BufReader<R>,
    text: Vec<u8>,
    number: usize,
    end: u64,
    is_at_end: bool,
}

impl<R: Read> Lines<R> {
    fn new(path: &Path, input: R) -> Self {
        Self {
            path: path.to_owned(),
            input: BufReader::new(input),
            text: Vec::new(),
            number: 0,
            end: 0,
            is_at_end: false,
        }
    }

    /// The next line; none at the end, and where a line is torn or something else.
    fn next<T: DeserializeOwned>(&mut self) -> Result<Option<T>, StoreError> {
        if !self.read_line()? {
            return Ok(None);
        }
        let line = self.text.strip_suffix(b"\n");
        Ok(line.and_then(|line| serde_json::from_slice(line).ok()))
    }

    fn read_line(&mut self) -> Result<bool, StoreError> {
        self.text.clear();
        let read = self
            .input
            .by_ref()
            .take(LINE_BYTES_MAX)
            .read_until(b'\n', &mut self.text)
            .map_err(|source| StoreError::Read {
                path: self.path.clone(),
                source,
            })?;
        self.number += 1;
        self.end += read as u64;
        self.is_at_end = read == 0;
        Ok(read > 0)
    }

    /// How many lines are left.
    fn rest(&mut self) -> Result<usize, StoreError> {
        let mut count = 0;
        while self.read_line()? {
            count += 1;
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::sweep::row::Ended;

    const SHARD: Shard = Shard { number: 2, of: 3 };

    fn header(sweep: &str) -> Header {
        Header {
            schema: 1,
            version: "1".to_owned(),
            sweep: sweep.to_owned(),
            runs: 30,
            shard: SHARD,
        }
    }

    fn row(case: usize) -> SweepRow {
        SweepRow::without_verdict(
            case,
            "id",
            Ended::Invalid,
            "line\nbreak, \"quote\"".to_owned(),
        )
    }

    /// Three rows in a folder; the bytes of the file.
    fn written(folder: &Path) -> Vec<u8> {
        let (mut store, found) = Store::open(folder, &header("s")).unwrap();
        assert_eq!((found.done, found.dropped), (0, 0));
        for case in SHARD.cases(30).take(3) {
            store.append(&row(case)).unwrap();
        }
        fs::read(folder.join(FILE)).unwrap()
    }

    #[test]
    fn wherever_it_is_cut_the_whole_rows_stay_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        let ends = |length: usize| {
            whole[..length]
                .iter()
                .filter(|byte| **byte == b'\n')
                .count()
        };
        for length in 0..=whole.len() {
            fs::write(folder.path().join(FILE), &whole[..length]).unwrap();
            let (mut store, found) = Store::open(folder.path(), &header("s")).unwrap();
            assert_eq!(found.done, ends(length).saturating_sub(1), "{length}");
            let is_torn = length > 0 && whole[length - 1] != b'\n';
            assert_eq!(found.dropped, usize::from(is_torn), "{length}");
            for case in SHARD.cases(30).take(3).skip(found.done) {
                store.append(&row(case)).unwrap();
            }
            assert_eq!(
                fs::read(folder.path().join(FILE)).unwrap(),
                whole,
                "{length}"
            );
        }
    }

    #[test]
    fn from_a_damaged_line_on_everything_is_played_again() {
        let folder = tempfile::tempdir().unwrap();
        let mut bytes = written(folder.path());
        let second = bytes
            .windows(9)
            .position(|part| part == b"\"case\":5,")
            .unwrap();
        bytes[second..second + 4].fill(0);
        fs::write(folder.path().join(FILE), &bytes).unwrap();
        let (_, rows) = read(folder.path()).unwrap();
        let rows: Vec<_> = rows.collect();
        assert!(
            matches!(rows[..], [Ok(_), Err(StoreError::Damaged { line: 3, .. })]),
            "{rows:?}"
        );
        let (_, found) = Store::open(folder.path(), &header("s")).unwrap();
        assert_eq!((found.done, found.dropped), (1, 2));
    }

    #[test]
    fn rows_that_are_not_ours_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        let error = Store::open(folder.path(), &header("other")).unwrap_err();
        assert!(matches!(error, StoreError::Foreign { .. }), "{error}");
        assert_eq!(fs::read(folder.path().join(FILE)).unwrap(), whole);
    }

    #[test]
    fn two_programs_never_write_the_same_rows() {
        let folder = tempfile::tempdir().unwrap();
        let _first = Store::open(folder.path(), &header("s")).unwrap();
        let error = Store::open(folder.path(), &header("s")).unwrap_err();
        assert!(matches!(error, StoreError::Busy { .. }), "{error}");
    }
}
