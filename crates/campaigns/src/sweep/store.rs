//! The rows of a sweep on the disk: sealed lines of JSON, each appended when its turn comes. Whatever happened to the file, a
//! row that opens is the one that this program wrote for this sweep; the others are set aside, and their cases played again.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::Shard;
use super::cases::Cases;
use super::row::SweepRow;
use super::sealed::{Lines, Place, Seal, is_torn};
use judge::verdict::Identity;
use recording::run_folder::{own_file, replace};
use scenario::open_to_write;

/// Name of the file.
pub(super) const FILE: &str = recording::run_folder::file::ROWS;
/// Name of the file with the lines that something happened to.
const DAMAGED: &str = "rows.damaged.jsonl";
/// Name of a file with the rows of another program, and after the first one with a number.
const OLDER: &str = "rows.older";
/// Rows that a power cut may cost; a kill of the program costs none.
const UNSYNCED_MAX: usize = 32;
/// Bytes of a file that are read before it must have shown whose it is: more than any damage to a disk takes at a time.
const FOREIGN_BYTES_MAX: u64 = 64 << 20;
/// Damaged lines that are named.
const NAMED_MAX: usize = 10;
/// The format of the file.
const SCHEMA: u32 = 3;

/// The first line: whose rows these are.
#[derive(Clone, Debug, Deserialize, Eq, PartialEq, Serialize)]
pub(crate) struct Header {
    /// Version of the format.
    schema: u32,
    /// The program's version.
    pub(crate) version: String,
    /// The campaign, as [`Cases::id`] names it.
    pub(super) sweep: String,
    /// Cases of the whole sweep.
    pub(crate) runs: usize,
    /// Which of them are here.
    pub(super) shard: Shard,
    /// What takes part in each run.
    pub(super) identity: Identity,
}

/// What the first line of an older format has.
#[derive(Deserialize)]
struct OlderHeader {
    version: String,
    sweep: String,
}

impl Header {
    /// What this program would write.
    pub(crate) fn new(cases: &dyn Cases, identity: &Identity, shard: Shard) -> Self {
        Self {
            schema: SCHEMA,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            sweep: cases.id().to_owned(),
            runs: cases.runs(),
            shard,
            identity: identity.clone(),
        }
    }

    /// The seal of headers.
    fn seal() -> Seal {
        Seal::new("header", String::new())
    }

    /// The seal of the rows under this header. Those of another campaign or program have another one, so that they open nowhere
    /// else.
    fn seal_of_rows(&self) -> Seal {
        let key = serde_json::to_string(&(&self.sweep, &self.identity)).expect("plain data");
        Seal::new("row", key)
    }

    fn line(&self) -> String {
        Self::seal().close(self)
    }

    /// Whether another program wrote these rows of the same cases.
    fn is_older(&self, other: &Self) -> bool {
        (&self.sweep, self.shard) == (&other.sweep, other.shard)
            && self.identity.program != other.identity.program
    }
}

/// Why the rows cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StoreError {
    #[error("{} cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("{} cannot be written: {source}. What is done is kept: {}, and give the same command again", path.display(), cure(source))]
    Write { path: PathBuf, source: io::Error },
    #[error("another canrig is at work on {}", path.display())]
    Busy { path: PathBuf },
    #[error("{} is not the store of this sweep, and is left as it is: move it away, and give the same command again", path.display())]
    Foreign { path: PathBuf },
    #[error("{} was written by another canrig ({version}): play it again with the command that played it", path.display())]
    Older { path: PathBuf, version: String },
    #[error("line {line} of {} is damaged: play it again with the command that played it", path.display())]
    Damaged { path: PathBuf, line: usize },
    #[error("the row of case {case} in {} is damaged: play it again with the command that played it", path.display())]
    DamagedRow { path: PathBuf, case: usize },
}

/// What makes a file writable that was not.
fn cure(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "make room",
        _ => "see that it can be written",
    }
}

/// Rows that grow. They are this program's alone while it is open.
#[derive(Debug)]
pub(crate) struct Store {
    path: PathBuf,
    file: File,
    /// Files that this one took the place of: who waits for them must find them locked.
    replaced: Vec<File>,
    header: Header,
    seal: Seal,
    /// Where the row of each case is.
    rows: BTreeMap<usize, Place>,
    end: u64,
    is_in_order: bool,
    unsynced: usize,
    /// Rows that a power cut may cost.
    unsynced_max: usize,
}

/// Keeps others out of the rows of a store while it lives.
#[derive(Debug)]
pub(crate) struct Lock {
    _files: Vec<File>,
}

/// What a store was like when it was opened.
#[derive(Debug, Default)]
pub(crate) struct Recovered {
    /// Whether the last row was cut where the program was killed.
    pub(crate) is_torn: bool,
    /// What was set aside, for people.
    pub(crate) set_aside: Vec<String>,
}

/// What is in a file of that name.
#[derive(Default)]
pub(super) struct Content {
    header: Option<Header>,
    older: Option<OlderHeader>,
    pub(super) rows: BTreeMap<usize, Place>,
    is_in_order: bool,
    /// Lines that do not open, or parts of them, by the numbers of the lines.
    damaged: Vec<(usize, Place)>,
    /// What has no end, and is no row cut at the end of the file unless it is the last.
    torn: Option<(usize, Place)>,
}

impl Store {
    /// A store without rows in a file that the caller has opened.
    pub(super) fn new(path: PathBuf, file: File, header: &Header) -> Self {
        Self {
            path,
            file,
            replaced: Vec::new(),
            header: header.clone(),
            seal: header.seal_of_rows(),
            end: 0,
            rows: BTreeMap::new(),
            is_in_order: true,
            unsynced: 0,
            unsynced_max: UNSYNCED_MAX,
        }
    }

    /// A store that has all its rows.
    pub(super) fn of_whole(path: PathBuf, file: File, header: &Header, content: Content) -> Self {
        Self {
            rows: content.rows,
            ..Self::new(path, file, header)
        }
    }

    /// Writes the header, and the rows of other files in the order of the cases.
    pub(super) fn take_over(
        &mut self,
        sources: &[(File, BTreeMap<usize, Place>)],
    ) -> io::Result<()> {
        let mut places = BTreeMap::new();
        for (file, rows) in sources {
            for (case, place) in rows {
                places.entry(*case).or_insert((file, *place));
            }
        }
        let header = self.header.line();
        self.end = header.len() as u64;
        let mut output = BufWriter::new(&self.file);
        output.write_all(header.as_bytes())?;
        for (case, (file, place)) in places {
            output.write_all(&bytes(file, place)?)?;
            let offset = self.end;
            self.rows.insert(case, Place { offset, ..place });
            self.end += place.length as u64;
        }
        output.flush()?;
        drop(output);
        self.file.sync_data()
    }

    /// Its lock, without what it knows of a million rows.
    pub(super) fn into_lock(mut self) -> Lock {
        self.replaced.push(self.file);
        Lock {
            _files: self.replaced,
        }
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Opens the rows in a folder, or begins them.
    pub(super) fn open(folder: &Path, header: &Header) -> Result<(Self, Recovered), StoreError> {
        let path = folder.join(FILE);
        own(&path).map_err(read_error(&path))?;
        if path.exists() {
            scenario::open_file(&path).map_err(read_error(&path))?;
        }
        let file = open_to_write(&path, OpenOptions::new().read(true).truncate(false));
        let file = file.map_err(write_error(&path))?;
        if !lock(&file) {
            return Err(StoreError::Busy { path });
        }
        let content = Content::read(&file, header).map_err(read_error(&path))?;
        let is_older = content.is_older(header);
        if !is_older && !content.is_ours(&file, header).map_err(read_error(&path))? {
            return Err(StoreError::Foreign { path });
        }
        let mut store = Self::new(path, file, header);
        let recovered = match is_older {
            true => store.begin_anew(&content),
            false => store.recover(content),
        };
        Ok((store, recovered?))
    }

    /// Keeps the rows of another program under another name, and begins anew.
    fn begin_anew(&mut self, content: &Content) -> Result<Recovered, StoreError> {
        let set_aside = set_older_aside(&self.path, content).map_err(write_error(&self.path))?;
        self.rewrite()?;
        Ok(Recovered {
            is_torn: false,
            set_aside: vec![set_aside],
        })
    }

    /// Takes over the rows that open, in the order of the cases; the other lines are set aside.
    fn recover(&mut self, content: Content) -> Result<Recovered, StoreError> {
        let set_aside = content.set_aside(&self.file, &self.path)?;
        let is_whole = content.header.is_some() && content.damaged.is_empty();
        self.rows = content.rows;
        if is_whole && content.is_in_order {
            self.end = match self.rows.last_key_value() {
                Some((_, last)) => last.offset + last.length as u64,
                None => self.header.line().len() as u64,
            };
            let cut = self.file.set_len(self.end);
            let cut = cut.and_then(|()| self.file.seek(SeekFrom::Start(self.end)));
            cut.map_err(write_error(&self.path))?;
        } else {
            self.rewrite()?;
        }
        Ok(Recovered {
            is_torn: content.torn.is_some(),
            set_aside: Vec::from_iter(set_aside),
        })
    }

    /// Puts a file in the place of this one that has the header and the rows in the order of the cases.
    fn rewrite(&mut self) -> Result<(), StoreError> {
        let path = self.path.clone();
        let replaced = replace(&path, |file| self.write_anew(file));
        replaced.map_err(write_error(&path))?;
        self.is_in_order = true;
        Ok(())
    }

    /// Writes header and rows to another file, which is this store's from now on. It is locked before it has the name of the other one.
    fn write_anew(&mut self, file: File) -> io::Result<()> {
        let mut output = BufWriter::new(file);
        let header = self.header.line();
        output.write_all(header.as_bytes())?;
        let mut offset = header.len() as u64;
        let mut rows = BTreeMap::new();
        for (case, place) in &self.rows {
            output.write_all(&bytes(&self.file, *place)?)?;
            rows.insert(*case, Place { offset, ..*place });
            offset += place.length as u64;
        }
        let file = output.into_inner()?;
        file.sync_data()?;
        (self.rows, self.end) = (rows, offset);
        self.replaced.push(std::mem::replace(&mut self.file, file));
        Ok(())
    }

    /// Whether the row of a case is there.
    pub(super) fn has(&self, case: usize) -> bool {
        self.rows.contains_key(&case)
    }

    /// How many rows there are.
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Appends a row.
    pub(super) fn append(&mut self, row: &SweepRow) -> Result<(), StoreError> {
        let line = self.seal.close(row);
        let written = self.file.write_all(line.as_bytes());
        written.map_err(write_error(&self.path))?;
        let place = Place {
            offset: self.end,
            length: line.len(),
        };
        self.end += line.len() as u64;
        let last = self.rows.last_key_value();
        self.is_in_order &= last.is_none_or(|(last, _)| *last < row.case);
        self.rows.insert(row.case, place);
        self.unsynced += 1;
        if self.unsynced >= self.unsynced_max {
            self.sync()?;
        }
        Ok(())
    }

    /// The same for rows that are somewhere else, too: the disk is asked to keep them at the end only.
    pub(super) fn of_copies(self) -> Self {
        Self {
            unsynced_max: usize::MAX,
            ..self
        }
    }

    /// The row of a case.
    pub(super) fn row(&self, case: usize) -> Result<Option<SweepRow>, StoreError> {
        let Some(place) = self.rows.get(&case) else {
            return Ok(None);
        };
        let line = bytes(&self.file, *place).map_err(read_error(&self.path))?;
        let row = line
            .strip_suffix(b"\n")
            .and_then(|line| self.seal.open(line));
        row.map(Some).ok_or_else(|| StoreError::DamagedRow {
            path: self.path.clone(),
            case,
        })
    }

    /// Waits until the disk has everything, in the order of the cases.
    pub(super) fn finish(&mut self) -> Result<(), StoreError> {
        if !self.is_in_order {
            self.rewrite()?;
        }
        self.sync()
    }

    fn sync(&mut self) -> Result<(), StoreError> {
        self.unsynced = 0;
        self.file.sync_data().map_err(write_error(&self.path))
    }
}

impl Content {
    /// Reads what is there now: another machine may go on writing. Of a file that is not this sweep's, no more than is needed to
    /// see that.
    pub(super) fn read(file: &File, header: &Header) -> io::Result<Self> {
        let seal = header.seal_of_rows();
        let mut lines = Lines::new(file.take(file.metadata()?.len()));
        let mut content = Self {
            is_in_order: true,
            ..Self::default()
        };
        while lines.advance()? {
            if lines.offset == 0
                && let Some(line) = lines.whole()
            {
                content.header = Header::seal().open(line);
                content.older = serde_json::from_slice(line).ok();
                match &content.header {
                    Some(found) if found != header => break,
                    Some(_) => continue,
                    None => {}
                }
            }
            if lines.offset > FOREIGN_BYTES_MAX && content.is_unknown() {
                break;
            }
            for (bytes, place) in lines.parts() {
                let row = bytes.strip_suffix(b"\n").and_then(|line| seal.open(line));
                content.add(lines.number, header, row, (bytes, place));
            }
        }
        Ok(content)
    }

    fn add(
        &mut self,
        number: usize,
        header: &Header,
        row: Option<SweepRow>,
        (bytes, place): (&[u8], Place),
    ) {
        let is_wanted = |row: &SweepRow| {
            header.shard.has(row.case, header.runs) && !self.rows.contains_key(&row.case)
        };
        let row = row.filter(is_wanted);
        self.damaged.extend(self.torn.take());
        match row {
            Some(row) => {
                let last = self.rows.last_key_value();
                self.is_in_order &= last.is_none_or(|(last, _)| *last < row.case);
                self.rows.insert(row.case, place);
            }
            None if is_torn(bytes) => self.torn = Some((number, place)),
            None => self.damaged.push((number, place)),
        }
    }

    /// Whether nothing says so far whose file it is.
    fn is_unknown(&self) -> bool {
        self.header.is_none() && self.rows.is_empty()
    }

    /// Whether this sweep's rows were written by another program.
    pub(super) fn is_older(&self, header: &Header) -> bool {
        match (&self.header, &self.older) {
            (Some(found), _) => found.is_older(header),
            (None, Some(older)) => older.sweep == header.sweep,
            (None, None) => false,
        }
    }

    /// Whether all rows of the part are here as they were written.
    pub(super) fn is_whole(&self, header: &Header) -> bool {
        let is_sound = self.damaged.is_empty() && self.torn.is_none() && self.is_in_order;
        let of = header.shard.cases(header.runs).len();
        is_sound && self.header.as_ref() == Some(header) && self.rows.len() == of
    }

    /// Keeps damaged lines beside the file; what is said of them.
    pub(super) fn set_aside(&self, file: &File, path: &Path) -> Result<Option<String>, StoreError> {
        if self.damaged.is_empty() {
            return Ok(None);
        }
        let aside = path.with_file_name(DAMAGED);
        self.keep_damaged(file, &aside)
            .map_err(write_error(&aside))?;
        let numbers: Vec<usize> = self.damaged_lines().map(|parts| parts[0].0).collect();
        Ok(Some(damaged_words(path, &numbers)))
    }

    /// The damaged parts of each line.
    fn damaged_lines(&self) -> impl Iterator<Item = &[(usize, Place)]> {
        self.damaged.chunk_by(|(one, _), (other, _)| one == other)
    }

    fn keep_damaged(&self, file: &File, aside: &Path) -> io::Result<()> {
        let aside = open_to_write(&own(aside)?, OpenOptions::new().append(true))?;
        let mut output = BufWriter::new(aside);
        for parts in self.damaged_lines() {
            for (_, place) in parts {
                let part = bytes(file, *place)?;
                output.write_all(part.strip_suffix(b"\n").unwrap_or(&part))?;
            }
            output.write_all(b"\n")?;
        }
        output.into_inner()?.sync_data()
    }

    fn version(&self) -> Option<&str> {
        let own = self.header.as_ref().map(|header| header.version.as_str());
        own.or(self.older.as_ref().map(|older| older.version.as_str()))
    }

    /// Whether this program may write here: its header or a row of its own is there, or nothing but the beginning of a header.
    pub(super) fn is_ours(&self, file: &File, header: &Header) -> io::Result<bool> {
        if let Some(found) = &self.header {
            return Ok(found == header);
        }
        if !self.rows.is_empty() {
            return Ok(true);
        }
        let line = header.line().into_bytes();
        let length = usize::try_from(file.metadata()?.len()).unwrap_or(usize::MAX);
        if length >= line.len() {
            return Ok(false);
        }
        let mut found = vec![0; length];
        file.read_exact_at(&mut found, 0)?;
        Ok(line.starts_with(&found))
    }
}

/// What is said of damaged lines.
fn damaged_words(path: &Path, numbers: &[usize]) -> String {
    let path = path.display();
    if let [number] = numbers {
        return format!(
            "line {number} of {path} is damaged: it is kept in {DAMAGED}; runs without a row are played again"
        );
    }
    let named = numbers.iter().take(NAMED_MAX).map(ToString::to_string);
    let named = named.collect::<Vec<_>>().join(", ");
    let more = if numbers.len() > NAMED_MAX {
        ", …"
    } else {
        ""
    };
    let count = numbers.len();
    format!(
        "{count} lines of {path} are damaged ({named}{more}): they are kept in {DAMAGED}; runs without a row are played again"
    )
}

/// Gives the rows of another program another name; what is said of that.
pub(super) fn set_older_aside(path: &Path, content: &Content) -> io::Result<String> {
    let mut names = (1..).map(|number| match number {
        1 => format!("{OLDER}.jsonl"),
        number => format!("{OLDER}-{number}.jsonl"),
    });
    let is_free = |name: &String| !path.with_file_name(name).exists();
    let name = names
        .find(is_free)
        .expect("there are more numbers than files");
    fs::rename(path, path.with_file_name(&name))?;
    Ok(format!(
        "{} was written by another canrig ({}): it is kept as {name}, and its runs are played again",
        path.display(),
        content.version().unwrap_or("unknown")
    ))
}

/// A file of a campaign's folder, which no link may lead out of.
fn own(path: &Path) -> io::Result<PathBuf> {
    let folder = path.parent().unwrap_or(Path::new(""));
    own_file(folder, path.file_name().unwrap_or_default())
}

/// Opens a file of a campaign's folder to read it.
pub(super) fn open(path: &Path) -> io::Result<File> {
    scenario::open_file(&own(path)?)
}

fn bytes(file: &File, place: Place) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; place.length];
    file.read_exact_at(&mut bytes, place.offset)?;
    Ok(bytes)
}

/// Makes a file this program's alone; whether it is.
fn lock(file: &File) -> bool {
    // A file system without locks has to do without.
    !matches!(file.try_lock(), Err(TryLockError::WouldBlock))
}

pub(super) fn read_error(path: &Path) -> impl FnOnce(io::Error) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Read { path, source }
}

pub(super) fn write_error(path: &Path) -> impl FnOnce(io::Error) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Write { path, source }
}

/// Whether there are rows in a folder; a part that no machine has ended has none.
pub(crate) fn has_rows(folder: &Path) -> bool {
    folder.join(FILE).exists()
}

/// The header of the rows in a folder, and the rows.
pub(crate) fn read(folder: &Path) -> Result<(Header, StoredRows), StoreError> {
    let path = folder.join(FILE);
    let file = open(&path).map_err(read_error(&path))?;
    let mut lines = Lines::new(file);
    lines.advance().map_err(read_error(&path))?;
    let line = lines.whole().unwrap_or_default();
    let Some(header) = Header::seal().open::<Header>(line) else {
        return Err(match serde_json::from_slice(line) {
            Ok(OlderHeader { version, .. }) => StoreError::Older { path, version },
            Err(_) => StoreError::Damaged { path, line: 1 },
        });
    };
    let seal = header.seal_of_rows();
    let rows = StoredRows {
        path,
        lines,
        seal,
        is_over: false,
    };
    Ok((header, rows))
}

/// The rows of a file in their order, up to the first that does not open.
pub(crate) struct StoredRows {
    path: PathBuf,
    lines: Lines<File>,
    seal: Seal,
    is_over: bool,
}

impl Iterator for StoredRows {
    type Item = Result<SweepRow, StoreError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_over {
            return None;
        }
        self.is_over = true;
        match self.lines.advance() {
            Err(error) => return Some(Err(read_error(&self.path)(error))),
            Ok(false) => return None,
            Ok(true) => {}
        }
        let row = self.lines.whole().and_then(|line| self.seal.open(line));
        self.is_over = row.is_none();
        let (path, line) = (self.path.clone(), self.lines.number);
        Some(row.ok_or(StoreError::Damaged { path, line }))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use faults::Stream;

    use super::*;
    use crate::sweep::row::Ended;

    const SHARD: Shard = Shard { number: 2, of: 3 };
    const CASES: [usize; 4] = [2, 5, 8, 11];

    pub(in crate::sweep) fn header(sweep: &str, program: &str) -> Header {
        Header {
            schema: SCHEMA,
            version: "1".to_owned(),
            sweep: sweep.to_owned(),
            runs: 30,
            shard: SHARD,
            identity: Identity {
                program: program.to_owned(),
                plant: "sma_actuator".to_owned(),
                law: "pid".to_owned(),
                files: [("scenario.toml".to_owned(), "1f".to_owned())].into(),
            },
        }
    }

    fn ours() -> Header {
        header("s", "p")
    }

    fn row(case: usize) -> SweepRow {
        let mut row =
            SweepRow::without_verdict(case, "id", Ended::Fail, "line\nbreak, \"quote\"".to_owned());
        row.metrics = vec![("overshoot_percent".to_owned(), 0.1 + case as f64)];
        row
    }

    fn append(store: &mut Store) {
        for case in CASES {
            if !store.has(case) {
                store.append(&row(case)).unwrap();
            }
        }
        store.finish().unwrap();
    }

    /// The rows in a folder; the bytes of the file.
    fn written(folder: &Path) -> Vec<u8> {
        let (mut store, found) = Store::open(folder, &ours()).unwrap();
        assert_eq!((store.len(), found.set_aside.len()), (0, 0));
        append(&mut store);
        fs::read(folder.join(FILE)).unwrap()
    }

    /// What a program that finds these bytes keeps of them; no row among it is another one than was written. With the rest
    /// played again, the bytes are what they were.
    fn kept(bytes: &[u8], whole: &[u8]) -> Result<(Vec<usize>, Recovered), StoreError> {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(FILE), bytes).unwrap();
        let opened = Store::open(folder.path(), &ours());
        if opened.is_err() {
            assert_eq!(fs::read(folder.path().join(FILE)).unwrap(), bytes);
        }
        let (mut store, found) = opened?;
        let cases: Vec<usize> = store.rows.keys().copied().collect();
        let (_, rows) = read(folder.path()).unwrap();
        let rows: Vec<SweepRow> = rows.map(Result::unwrap).collect();
        let expected: Vec<SweepRow> = cases.iter().map(|case| row(*case)).collect();
        assert_eq!(rows, expected);
        let aside = fs::read(folder.path().join(DAMAGED)).unwrap_or_default();
        assert_eq!(aside.is_empty(), found.set_aside.is_empty());
        append(&mut store);
        assert_eq!(fs::read(folder.path().join(FILE)).unwrap(), whole);
        Ok((cases, found))
    }

    #[test]
    fn wherever_it_is_cut_the_whole_rows_stay_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        for length in 0..=whole.len() {
            let (cases, found) = kept(&whole[..length], &whole).unwrap();
            let ends = whole[..length].iter().filter(|byte| **byte == b'\n');
            assert_eq!(cases, CASES[..ends.count().saturating_sub(1)], "{length}");
            let is_torn = length > 0 && whole[length - 1] != b'\n';
            assert_eq!(found.is_torn, is_torn, "{length}");
            assert!(found.set_aside.is_empty(), "{length}");
        }
    }

    #[test]
    fn whichever_byte_is_damaged_only_its_own_row_is_lost_and_it_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        let last = whole.len() - 1;
        for place in 0..=last {
            let line = whole[..place].iter().filter(|byte| **byte == b'\n').count();
            for other in [whole[place] ^ (1 << (place % 8)), b'\n'] {
                if other == whole[place] {
                    continue;
                }
                let mut bytes = whole.clone();
                bytes[place] = other;
                let (cases, found) = kept(&bytes, &whole).unwrap();
                let is_lost = |case: &usize| line > 0 && *case == CASES[line - 1];
                let expected: Vec<usize> =
                    CASES.into_iter().filter(|case| !is_lost(case)).collect();
                assert_eq!(cases, expected, "{place} {other}");
                if place == last {
                    assert!(found.is_torn);
                } else {
                    let words = found.set_aside.concat();
                    assert!(words.contains("damaged"), "{place}: {words}");
                }
            }
        }
    }

    #[test]
    fn whatever_is_damaged_no_other_value_comes_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        let mut stream = Stream::named(1, "damage");
        let mut at = |limit: usize| usize::try_from(stream.below(limit as u64)).unwrap();
        let mut refused = 0;
        for _ in 0..300 {
            let mut bytes = whole.clone();
            for _ in 0..=at(4) {
                let start = at(bytes.len());
                let end = (start + 1 + at(200)).min(bytes.len());
                match at(5) {
                    0 => bytes[start..end].fill(0),
                    1 => drop(bytes.drain(start..end)),
                    2 => bytes[start..end].reverse(),
                    3 => bytes.extend_from_within(start..end),
                    _ => bytes[start] ^= 1 << at(8),
                }
                if bytes.is_empty() {
                    break;
                }
            }
            // Where neither header nor any row is left, nobody knows whose file it is.
            refused += usize::from(kept(&bytes, &whole).is_err());
        }
        assert!(refused < 60, "{refused}");
    }

    #[test]
    fn rows_in_another_order_and_twice_are_each_taken_once() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        let mut lines: Vec<&[u8]> = whole.split_inclusive(|byte| *byte == b'\n').collect();
        lines.swap(1, 3);
        assert_eq!(kept(&lines.concat(), &whole).unwrap().0, CASES);
        lines.push(lines[2]);
        let (cases, found) = kept(&lines.concat(), &whole).unwrap();
        assert_eq!(cases, CASES);
        assert!(found.set_aside.concat().starts_with("line 6 of "));
    }

    #[test]
    fn what_somebody_else_wrote_behind_the_rows_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        for other in [&b"notes of somebody else"[..], &[0; 4096], b"a\nb"] {
            let (cases, found) = kept(&[&whole[..], other].concat(), &whole).unwrap();
            assert_eq!((cases, found.is_torn), (CASES.to_vec(), false));
            assert!(found.set_aside.concat().contains("damaged"));
        }
    }

    #[test]
    fn a_reader_names_the_line_that_does_not_open() {
        let folder = tempfile::tempdir().unwrap();
        let mut bytes = written(folder.path());
        let second = bytes.windows(9).position(|part| part == b"\"case\":5,");
        bytes[second.unwrap() + 7] = b'8';
        fs::write(folder.path().join(FILE), &bytes).unwrap();
        let (_, rows) = read(folder.path()).unwrap();
        let rows: Vec<_> = rows.collect();
        assert!(
            matches!(rows[..], [Ok(_), Err(StoreError::Damaged { line: 3, .. })]),
            "{rows:?}"
        );
    }

    #[test]
    fn a_file_that_is_not_ours_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let whole = written(folder.path());
        let other_shard = Header {
            shard: Shard::WHOLE,
            ..ours()
        };
        for header in [header("other", "p"), other_shard] {
            let error = Store::open(folder.path(), &header).unwrap_err();
            assert!(matches!(error, StoreError::Foreign { .. }), "{error}");
            assert_eq!(fs::read(&path).unwrap(), whole);
        }
        for text in [
            "notes of somebody else\n",
            "{\"a\":1}\n{\"b\":2}",
            "{",
            "\n",
        ] {
            fs::write(&path, text).unwrap();
            let opened = Store::open(folder.path(), &ours());
            // A single brace is how a header begins.
            assert_eq!(opened.is_err(), text != "{", "{text}");
            if let Err(error) = opened {
                assert!(error.to_string().contains("move it away"), "{error}");
                assert_eq!(fs::read_to_string(&path).unwrap(), text);
            }
        }
    }

    #[test]
    fn a_damaged_line_is_named_once_with_its_own_number() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        let begin = whole.split_inclusive(|byte| *byte == b'\n').next().unwrap();
        // A line that is read in parts, and one that begins as two rows do.
        let long = [vec![b'x'; 3 << 20], b"\n".to_vec()].concat();
        let torn = [&begin[..50], &begin[..60], b"\n"].concat();
        let bytes = [begin, &long, &torn, &whole[begin.len()..]].concat();
        let (cases, found) = kept(&bytes, &whole).unwrap();
        assert_eq!(cases, CASES);
        let words = found.set_aside.concat();
        assert!(words.starts_with("2 lines of "), "{words}");
        assert!(words.contains("are damaged (2, 3):"), "{words}");
        fs::write(folder.path().join(FILE), bytes).unwrap();
        Store::open(folder.path(), &ours()).unwrap();
        let aside = fs::read(folder.path().join(DAMAGED)).unwrap();
        assert!(aside == [long, torn].concat());
    }

    #[test]
    fn a_huge_file_of_somebody_else_is_not_read_to_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let other = header("other", "p").line();
        for begin in [b"".as_slice(), other.as_bytes()] {
            fs::write(&path, begin).unwrap();
            // A hole, which takes no room, and an hour to be read.
            let length = 4 << 40;
            File::options()
                .write(true)
                .open(&path)
                .unwrap()
                .set_len(length)
                .unwrap();
            let error = Store::open(folder.path(), &ours()).unwrap_err();
            assert!(matches!(error, StoreError::Foreign { .. }), "{error}");
            assert_eq!(path.metadata().unwrap().len(), length);
        }
    }

    #[test]
    fn room_is_asked_for_where_it_is_missing_only() {
        let words = |kind: io::ErrorKind| write_error(Path::new("rows"))(kind.into()).to_string();
        assert!(words(io::ErrorKind::StorageFull).contains("kept: make room, and give"));
        assert!(words(io::ErrorKind::QuotaExceeded).contains("make room"));
        let words = words(io::ErrorKind::PermissionDenied);
        assert!(words.ends_with("see that it can be written, and give the same command again"));
    }

    #[test]
    fn a_store_is_busy_until_its_lock_is_dropped_also_when_it_was_written_anew() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        let theirs = folder.path().join("theirs");
        fs::write(&theirs, "theirs").unwrap();
        std::os::unix::fs::symlink(&theirs, folder.path().join("rows.jsonl.partial")).unwrap();
        fs::write(folder.path().join(FILE), [b"\n", &whole[..]].concat()).unwrap();
        let lock = Store::open(folder.path(), &ours()).unwrap().0.into_lock();
        let error = Store::open(folder.path(), &ours()).unwrap_err();
        assert!(matches!(error, StoreError::Busy { .. }), "{error}");
        drop(lock);
        Store::open(folder.path(), &ours()).unwrap();
        assert_eq!(fs::read(theirs).unwrap(), b"theirs");
    }

    #[test]
    fn rows_of_another_program_are_set_aside_and_never_counted() {
        let folder = tempfile::tempdir().unwrap();
        let older = written(folder.path());
        let format_1 = format!(
            "{{\"schema\":1,\"version\":\"0\",\"sweep\":\"s\",\"runs\":30,\"shard\":{{\"number\":2,\"of\":3}}}}\n{}\n",
            serde_json::to_string(&row(2)).unwrap()
        );
        let newer = header("s", "another build");
        let (store, found) = Store::open(folder.path(), &newer).unwrap();
        let words = found.set_aside.concat();
        assert!(words.contains("another canrig (1)"), "{words}");
        assert_eq!(store.len(), 0);
        drop(store);
        fs::write(folder.path().join(FILE), &format_1).unwrap();
        let (store, found) = Store::open(folder.path(), &newer).unwrap();
        let words = found.set_aside.concat();
        assert!(words.contains("another canrig (0)"), "{words}");
        assert_eq!(store.len(), 0);
        let kept = |name: &str| fs::read(folder.path().join(name)).unwrap();
        assert_eq!(kept("rows.older.jsonl"), older);
        assert_eq!(kept("rows.older-2.jsonl"), format_1.as_bytes());
        // Put under a new header, they do not open either.
        let first = older.iter().position(|byte| *byte == b'\n').unwrap() + 1;
        let mixed = [newer.line().as_bytes(), &older[first..]].concat();
        drop(store);
        fs::write(folder.path().join(FILE), mixed).unwrap();
        let (store, found) = Store::open(folder.path(), &newer).unwrap();
        assert_eq!(store.len(), 0);
        assert!(found.set_aside.concat().starts_with("4 lines of "));
    }

    #[test]
    fn two_programs_never_write_the_same_rows() {
        let folder = tempfile::tempdir().unwrap();
        let whole = written(folder.path());
        // In the first case the file is there as it is, in the second one another took its place.
        for before in ["", "\n"] {
            let bytes = [before.as_bytes(), &whole].concat();
            fs::write(folder.path().join(FILE), bytes).unwrap();
            let _first = Store::open(folder.path(), &ours()).unwrap();
            let error = Store::open(folder.path(), &ours()).unwrap_err();
            assert!(matches!(error, StoreError::Busy { .. }), "{error}");
        }
    }
}
