//! The rows of a campaign on the disk: lines of JSON with a checksum first, in files that have one writer each.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Shard;
use super::cases::Cases;
use super::row::SweepRow;
use super::sweep_cases::{HASH_BYTES, hash};
use crate::engine::quoted;
use judge::verdict::Identity;
use recording::run_folder::{file, file_in};
use runner::console::print_problem;
use runner::exit::{Exit, Failure};
use runner::identity::identity;
use runner::machine;

/// Beginning of each line.
const BEGIN: &str = "{\"checksum\":\"";
/// Digits of a checksum.
const DIGITS: usize = 2 * HASH_BYTES;
/// Longest line; a row has some hundred bytes, with a hundred checks some ten thousand.
const LINE_BYTES_MAX: u64 = 1 << 20;
/// Lines and cases that a message names.
const NAMED_MAX: usize = 10;

/// Remedy for a file that cannot be written.
fn cure(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "make room",
        _ => "see that it can be written",
    }
}

fn broken(reason: impl ToString) -> Failure {
    Exit::BenchFailed.because(reason)
}

fn read_error(path: &Path) -> impl FnOnce(io::Error) -> Failure {
    move |error| broken(format!("{} cannot be read: {error}", path.display()))
}

fn write_error(path: &Path) -> impl FnOnce(io::Error) -> Failure {
    move |error| {
        let (path, cure) = (path.display(), cure(&error));
        broken(format!(
            "`{path}` cannot be written: {error}. What is done is kept: {cure}, and give the same command again"
        ))
    }
}

/// Returns the failure of a file with something else than rows of the campaign.
fn foreign(path: &Path, found: &str) -> Failure {
    let folder = quoted(&path.parent().unwrap_or(path).to_string_lossy());
    let path = path.display();
    Exit::CannotStart.because(format!(
        "{path} has {found}, and nothing of it counts here. `rm {folder}/rows*.jsonl` makes a new start: then play it again"
    ))
}

/// First line of a file: the campaign whose rows follow, and their writer.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Header {
    /// Version of the program.
    pub(crate) version: String,
    /// The campaign, as the id of its facts names it.
    sweep: String,
    /// Cases of the whole campaign.
    pub(crate) runs: usize,
    /// Participants of each run.
    pub(crate) identity: Identity,
    /// Machine and process that write the file.
    node: String,
    process: u32,
}

impl Header {
    /// Header of the rows that this process would write.
    ///
    /// # Errors
    /// The program's file cannot be read.
    pub(crate) fn new(cases: &dyn Cases) -> Result<Self, Failure> {
        let facts = cases.facts();
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            sweep: facts.id.clone(),
            runs: facts.runs,
            identity: identity(&facts.plan)?,
            node: machine::name(),
            process: std::process::id(),
        })
    }

    /// Reads the header in a folder, whatever its campaign; `None` if there is none.
    pub(crate) fn read(folder: &Path) -> Result<Option<Self>, Failure> {
        for path in files_in(folder)? {
            if let Some(found) = Self::of(&path)? {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    fn of(path: &Path) -> Result<Option<Self>, Failure> {
        let mut line = Vec::new();
        let mut input = BufReader::new(opened(path)?).take(LINE_BYTES_MAX);
        let read = input.read_until(b'\n', &mut line);
        read.map_err(read_error(path))?;
        Ok(line.strip_suffix(b"\n").and_then(Self::open))
    }

    fn line(&self) -> String {
        close("header", "", self)
    }

    fn open(line: &[u8]) -> Option<Self> {
        open("header", "", line)
    }

    /// Key of the rows' checksums: a row of another campaign, program, plant, law or file does not check.
    fn key(&self) -> String {
        serde_json::to_string(&(&self.sweep, &self.identity)).expect("plain data")
    }

    /// Describes the content of a file with another header; `None` if its rows count here.
    fn foreign(&self, found: &Self) -> Option<String> {
        let (ours, theirs) = (&self.identity, &found.identity);
        let whose = match () {
            () if theirs.program != ours.program => format!("another canrig ({})", found.version),
            () if theirs.plant != ours.plant => format!("another plant ({})", theirs.plant),
            () if theirs.law != ours.law => format!("another law ({})", theirs.law),
            () if theirs.files != ours.files => {
                let mut files = theirs.files.iter().chain(&ours.files);
                let is_other = |name| theirs.files.get(name) != ours.files.get(name);
                let name = files.find_map(|(name, _)| is_other(name).then_some(name))?;
                format!("another {name}")
            }
            () if found.sweep != self.sweep => "another campaign".to_owned(),
            () => return None,
        };
        Some(format!("rows of {whose}"))
    }
}

/// Line of a value, with its end.
fn close(member: &str, key: &str, value: &impl Serialize) -> String {
    let text = serde_json::to_string(value).expect("plain data");
    let checksum = hash([member, key, &text]);
    format!("{BEGIN}{checksum}\",\"{member}\":{text}}}\n")
}

/// Reads the value of a line without its end; `None` if the line is not as it was written, or has another member or key.
fn open<T: DeserializeOwned>(member: &str, key: &str, line: &[u8]) -> Option<T> {
    let line = str::from_utf8(line).ok()?.strip_prefix(BEGIN)?;
    let (found, line) = line.split_at_checked(DIGITS)?;
    let line = line.strip_prefix("\",\"")?.strip_prefix(member)?;
    let text = line.strip_prefix("\":")?.strip_suffix('}')?;
    let is_sound = hash([member, key, text]) == found;
    is_sound.then(|| serde_json::from_str(text).ok())?
}

/// Path of a file of rows by its number, from 1.
fn numbered(folder: &Path, number: usize) -> PathBuf {
    match number {
        1 => folder.join(file::ROWS),
        number => folder.join(format!("rows-{number}.jsonl")),
    }
}

/// Files of rows in a folder, in the order in which they were begun.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(read_error(folder))?,
    };
    let mut found = BTreeMap::new();
    for entry in entries {
        let name = entry.map_err(read_error(folder))?.file_name();
        let number = name.to_str().and_then(|name| match name {
            file::ROWS => Some(1),
            name => (name.strip_prefix("rows-")?.strip_suffix(".jsonl")?.parse()).ok(),
        });
        found.extend(number.map(|number| (number, numbered(folder, number))));
    }
    Ok(found.into_values().collect())
}

/// Opens a file of rows, which no link may lead out of its folder.
fn opened(path: &Path) -> Result<File, Failure> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let inside = file_in(folder, path.file_name().unwrap_or_default());
    let file = inside.and_then(|path| scenario::open_file(&path));
    file.map_err(read_error(path))
}

/// Rows in the files of a folder: of each case the first that checks.
#[derive(Debug)]
pub(crate) struct Rows {
    folder: PathBuf,
    header: Header,
    key: String,
    shard: Shard,
    files: Vec<RowsFile>,
    rows: BTreeMap<usize, Place>,
}

/// A file as far as it was read.
#[derive(Debug, Default)]
struct RowsFile {
    path: PathBuf,
    end: u64,
    lines: usize,
    /// Numbers of the lines that do not check.
    damaged: Vec<usize>,
    /// Whether bytes follow that have no line's end.
    is_cut: bool,
    /// Machine that its header names.
    node: Option<String>,
}

/// Place of a row: file, offset and length with the line's end.
#[derive(Clone, Copy, Debug)]
struct Place {
    file: usize,
    offset: u64,
    length: usize,
}

impl Rows {
    /// Participants of each run.
    pub(crate) fn identity(&self) -> &Identity {
        &self.header.identity
    }

    /// Rows of a part of a campaign in a folder, which may not be there yet.
    pub(crate) fn read(folder: &Path, header: &Header, shard: Shard) -> Result<Self, Failure> {
        let mut rows = Self {
            folder: folder.to_owned(),
            key: header.key(),
            header: header.clone(),
            shard,
            files: Vec::new(),
            rows: BTreeMap::new(),
        };
        rows.look()?;
        Ok(rows)
    }

    /// Begins a file of further rows.
    pub(crate) fn writer(&self) -> Result<Writer, Failure> {
        Writer::begin(&self.folder, &self.header)
    }

    /// Reads the lines that were added since the last look.
    pub(crate) fn look(&mut self) -> Result<(), Failure> {
        for path in files_in(&self.folder)? {
            if !self.files.iter().any(|file| file.path == path) {
                self.files.push(RowsFile {
                    path,
                    ..RowsFile::default()
                });
            }
        }
        for number in 0..self.files.len() {
            self.look_at(number)?;
        }
        Ok(())
    }

    fn look_at(&mut self, number: usize) -> Result<(), Failure> {
        let file = &mut self.files[number];
        let mut input = opened(&file.path)?;
        let start = input.seek(SeekFrom::Start(file.end));
        start.map_err(read_error(&file.path))?;
        let mut input = BufReader::new(input);
        let mut line = Vec::new();
        loop {
            line.clear();
            let length = input
                .by_ref()
                .take(LINE_BYTES_MAX)
                .read_until(b'\n', &mut line)
                .map_err(read_error(&file.path))?;
            let Some(line) = line.strip_suffix(b"\n") else {
                file.is_cut = length > 0;
                let found = format!("a line of more than {LINE_BYTES_MAX} bytes");
                return if length as u64 == LINE_BYTES_MAX {
                    Err(foreign(&file.path, &found))
                } else {
                    Ok(())
                };
            };
            let offset = file.end;
            file.lines += 1;
            file.end += length as u64;
            if let Some(found) = Header::open(line).filter(|_| offset == 0) {
                if let Some(found) = self.header.foreign(&found) {
                    return Err(foreign(&file.path, &found));
                }
                file.node = Some(found.node);
            } else if let Some(row) = open::<SweepRow>("row", &self.key, line) {
                let place = Place {
                    file: number,
                    offset,
                    length,
                };
                if self.shard.has(row.case, self.header.runs) {
                    self.rows.entry(row.case).or_insert(place);
                }
            } else {
                file.damaged.push(file.lines);
            }
        }
    }

    /// Refuses files that another process is writing, where the file system has locks.
    pub(crate) fn require_unwritten(&self) -> Result<(), Failure> {
        for RowsFile { path, .. } in &self.files {
            if let Err(TryLockError::WouldBlock) = opened(path)?.try_lock_shared() {
                let writer = match Header::of(path)? {
                    Some(Header { node, process, .. }) => format!("process {process} on {node}"),
                    None => "another process".to_owned(),
                };
                let path = path.display();
                return Err(broken(format!(
                    "{path} is being written by {writer}: wait until it has ended, or end it"
                )));
            }
        }
        Ok(())
    }

    /// Refuses rows among which cases are missing.
    pub(crate) fn require_all(&self) -> Result<(), Failure> {
        if self.is_whole() {
            return Ok(());
        }
        let of = self.of();
        let all = self.shard.cases(self.header.runs);
        let mut missing = all.filter(|case| !self.has(*case));
        let named = missing.by_ref().take(NAMED_MAX);
        let named: Vec<String> = named.map(|case| case.to_string()).collect();
        let more = if missing.next().is_some() {
            ", …"
        } else {
            ""
        };
        let (count, cases) = (of - self.len(), named.join(", ") + more);
        Err(Exit::CannotStart.because(format!(
            "{count} of {of} cases are missing: {cases}. Name all parts, and play those again that are not done"
        )))
    }

    /// Prints the lines that do not check.
    pub(crate) fn print_damaged(&self) {
        let lines = self.files.iter().flat_map(|file| {
            let cut = file.is_cut.then_some(file.lines + 1);
            let lines = file.damaged.iter().copied().chain(cut);
            lines.map(|line| (line, file.path.display()))
        });
        for (line, path) in lines.clone().take(NAMED_MAX) {
            print_problem(format!(
                "line {line} of {path} is damaged or cut short, and does not count"
            ));
        }
        if let more @ 1.. = lines.count().saturating_sub(NAMED_MAX) {
            print_problem(format!("and {more} more lines"));
        }
    }

    /// Rows in the order of their cases, each checked again.
    pub(crate) fn iter(&self) -> Result<impl Iterator<Item = Result<SweepRow, Failure>>, Failure> {
        let opened = self.files.iter().map(|file| opened(&file.path));
        let files = opened.collect::<Result<Vec<File>, _>>()?;
        Ok(self.rows.iter().map(move |(case, place)| {
            let mut line = vec![0; place.length];
            let path = &self.files[place.file].path;
            let read = files[place.file].read_exact_at(&mut line, place.offset);
            read.map_err(read_error(path))?;
            let row = open("row", &self.key, &line[..place.length - 1]).filter(|row: &SweepRow| row.case == *case);
            row.ok_or_else(|| {
                let path = path.display();
                broken(format!(
                    "the row of case {case} in {path} has changed since it was read: give the same command again"
                ))
            })
        }))
    }

    /// Returns whether a case has a row.
    pub(crate) fn has(&self, case: usize) -> bool {
        self.rows.contains_key(&case)
    }

    /// Returns the number of cases that have a row.
    pub(crate) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Returns the number of cases.
    pub(crate) fn of(&self) -> usize {
        self.shard.cases(self.header.runs).len()
    }

    /// Returns whether each case has a row.
    pub(crate) fn is_whole(&self) -> bool {
        self.len() == self.of()
    }

    /// Returns the part of the campaign.
    pub(crate) fn shard(&self) -> Shard {
        self.shard
    }

    /// Returns the machines that began files, in their order.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = &str> {
        self.files.iter().filter_map(|file| file.node.as_deref())
    }
}

/// A new file of rows, locked while it is open.
#[derive(Debug)]
pub(crate) struct Writer {
    path: PathBuf,
    file: File,
    key: String,
}

impl Writer {
    /// Begins the first file that is not there yet.
    pub(crate) fn begin(folder: &Path, header: &Header) -> Result<Self, Failure> {
        let mut number = 1;
        let (path, mut file) = loop {
            let path = numbered(folder, number);
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
                opened => break (path.clone(), opened.map_err(write_error(&path))?),
            }
        };
        // The lock is optional: some file systems have none.
        let _ = file.try_lock();
        let written = file.write_all(header.line().as_bytes());
        written.map_err(write_error(&path))?;
        let key = header.key();
        Ok(Self { path, file, key })
    }

    /// Appends a row.
    pub(crate) fn append(&mut self, row: &SweepRow) -> Result<(), Failure> {
        let line = close("row", &self.key, row);
        let written = self.file.write_all(line.as_bytes());
        written.map_err(write_error(&self.path))
    }

    /// Waits until the disk has all rows.
    pub(crate) fn sync(&mut self) -> Result<(), Failure> {
        self.file.sync_data().map_err(write_error(&self.path))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use faults::Stream;

    use super::*;
    use crate::sweep::row::Ended;

    const SHARD: Shard = Shard { number: 2, of: 3 };
    const CASES: [usize; 4] = [2, 5, 8, 11];

    pub(in crate::sweep) fn header(sweep: &str) -> Header {
        Header {
            version: "1".to_owned(),
            sweep: sweep.to_owned(),
            runs: 12,
            identity: Identity {
                program: "p".to_owned(),
                plant: "sma_actuator".to_owned(),
                law: "pid".to_owned(),
                files: [("scenario.toml".to_owned(), "1f".to_owned())].into(),
            },
            node: "n12".to_owned(),
            process: 34,
        }
    }

    fn row(case: usize) -> SweepRow {
        let mut row =
            SweepRow::without_verdict(case, "id", Ended::Fail, "line\nbreak, \"quote\"".to_owned());
        row.metrics = vec![("overshoot_percent".to_owned(), 0.1 + case as f64)];
        row
    }

    fn read(folder: &Path) -> Result<Rows, Failure> {
        Rows::read(folder, &header("s"), SHARD)
    }

    fn cases(rows: &Rows) -> Vec<usize> {
        let all = rows
            .iter()
            .unwrap()
            .map(Result::unwrap)
            .inspect(|found| assert_eq!(*found, row(found.case)));
        all.map(|row| row.case).collect()
    }

    /// Writes the rows of these cases into a new file and returns its bytes.
    fn write(folder: &Path, cases: &[usize]) -> Vec<u8> {
        let mut writer = Writer::begin(folder, &header("s")).unwrap();
        for case in cases {
            writer.append(&row(*case)).unwrap();
        }
        fs::read(&writer.path).unwrap()
    }

    /// Returns the bytes of a part that was played undisturbed.
    fn undisturbed() -> Vec<u8> {
        write(tempfile::tempdir().unwrap().path(), &CASES)
    }

    /// Returns the cases and damaged lines that a program finds in these bytes; the last line may be cut. The program plays the
    /// other cases and leaves the bytes as they are.
    fn kept(bytes: &[u8]) -> (Vec<usize>, Vec<usize>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.jsonl");
        fs::write(&path, bytes).unwrap();
        let mut rows = read(folder.path()).unwrap();
        let kept = cases(&rows);
        let file = &rows.files[0];
        let cut = file.is_cut.then_some(file.lines + 1);
        let damaged = file.damaged.iter().copied().chain(cut).collect();
        let left = CASES.into_iter().filter(|case| !rows.has(*case));
        write(folder.path(), &Vec::from_iter(left));
        rows.look().unwrap();
        rows.require_all().unwrap();
        assert_eq!(cases(&rows), CASES);
        assert_eq!(fs::read(path).unwrap(), bytes);
        (kept, damaged)
    }

    #[test]
    fn a_line_is_json_and_only_its_member_and_key_open_it() {
        let line = close("row", "a", &"with \"quotes\"\n");
        let whole = line.strip_suffix('\n').unwrap();
        let json: serde_json::Value = serde_json::from_str(whole).unwrap();
        assert_eq!(json["row"], "with \"quotes\"\n");
        let opened = |member, key| open::<String>(member, key, whole.as_bytes());
        assert_eq!(opened("row", "a").as_deref(), Some("with \"quotes\"\n"));
        assert_eq!(opened("row", "b"), None);
        let renamed = whole.replace("\"row\"", "\"header\"");
        assert_eq!(open::<String>("header", "a", renamed.as_bytes()), None);
    }

    #[test]
    fn wherever_a_file_is_cut_its_whole_rows_stay_and_the_cut_line_is_named() {
        let whole = undisturbed();
        for length in 0..=whole.len() {
            let (cases, damaged) = kept(&whole[..length]);
            let lines = whole[..length]
                .iter()
                .filter(|byte| **byte == b'\n')
                .count();
            assert_eq!(cases, CASES[..lines.saturating_sub(1)], "{length}");
            let is_cut = length > 0 && whole[length - 1] != b'\n';
            assert_eq!(damaged, Vec::from_iter(is_cut.then_some(lines + 1)));
        }
    }

    #[test]
    fn whichever_byte_is_damaged_its_line_is_named_and_only_its_row_is_lost() {
        let whole = undisturbed();
        for place in 0..whole.len() {
            let before = |place| whole[..place].iter().filter(|byte| **byte == b'\n').count();
            for other in [whole[place] ^ 1, whole[place] ^ 0x20, b'\n'] {
                if other == whole[place] {
                    continue;
                }
                let mut bytes = whole.clone();
                bytes[place] = other;
                let (cases, damaged) = kept(&bytes);
                // A line that lost its end continues with the next one.
                let lost = before(place)..=before(place + 1).min(CASES.len());
                let is_kept = |(line, _): &(usize, usize)| !lost.contains(line);
                let expected = (1..).zip(CASES).filter(is_kept).map(|(_, case)| case);
                assert_eq!(cases, Vec::from_iter(expected), "{place} {other}");
                assert_eq!(damaged[0], before(place) + 1, "{place} {other}");
            }
        }
    }

    #[test]
    fn whatever_is_damaged_no_other_value_comes_of_it() {
        let whole = undisturbed();
        let mut stream = Stream::named(1, "damage");
        let mut at = |limit: usize| usize::try_from(stream.below(limit as u64)).unwrap();
        for _ in 0..300 {
            let mut bytes = whole.clone();
            for _ in 0..=at(4) {
                let start = at(bytes.len());
                let end = (start + at(40)).min(bytes.len());
                match at(4) {
                    0 => drop(bytes.drain(start..end)),
                    1 => bytes
                        .splice(start..start, whole[..at(whole.len())].to_vec())
                        .for_each(drop),
                    2 => bytes[start..end].fill(0),
                    _ => bytes[start] ^= 1 << at(8),
                }
                if bytes.is_empty() {
                    break;
                }
            }
            kept(&bytes);
        }
        for notes in [
            &b"notes of somebody else\n"[..],
            b"{\"a\":1}\n{",
            b"\n",
            &[0; 4096],
        ] {
            assert!(kept(notes).0.is_empty());
            assert_eq!(kept(&[&whole, notes].concat()).0, CASES);
        }
    }

    #[test]
    fn the_first_row_of_a_case_counts_in_the_order_of_files_and_lines() {
        let folder = tempfile::tempdir().unwrap();
        let reasons = |rows: &Rows| -> Vec<String> {
            let rows = rows.iter().unwrap().map(Result::unwrap);
            rows.map(|row| row.reason.unwrap()).collect()
        };
        let mut writers: Vec<Writer> = (0..11)
            .map(|_| Writer::begin(folder.path(), &header("s")).unwrap())
            .collect();
        assert!(
            folder.path().join("rows.jsonl").exists()
                && folder.path().join("rows-11.jsonl").exists()
        );
        let mut append = |file: usize, case, reason: &str| {
            let row = SweepRow::without_verdict(case, "id", Ended::Fail, reason.to_owned());
            writers[file - 1].append(&row).unwrap();
        };
        append(11, 5, "eleventh");
        append(10, 5, "tenth");
        append(2, 8, "second");
        append(2, 8, "later");
        append(2, 5, "second");
        // Rows of other parts' cases.
        append(2, 3, "no");
        append(2, 14, "no");
        let mut rows = read(folder.path()).unwrap();
        assert_eq!(reasons(&rows), ["second", "second"]);
        append(1, 5, "too late");
        append(1, 2, "first");
        rows.look().unwrap();
        assert_eq!(reasons(&rows), ["first", "second", "second"]);
        assert_eq!(rows.nodes().count(), 11);
    }

    #[test]
    fn a_row_counts_as_soon_as_its_line_has_an_end() {
        let folder = tempfile::tempdir().unwrap();
        let mut rows = read(&folder.path().join("later")).unwrap();
        assert_eq!(rows.len(), 0);
        let whole = undisturbed();
        let mut rest = whole.as_slice();
        rows.folder = folder.path().to_owned();
        let mut file = File::create(folder.path().join("rows-7.jsonl")).unwrap();
        while let Some((part, left)) = rest.split_at_checked(60.min(rest.len())) {
            file.write_all(part).unwrap();
            rows.look().unwrap();
            let written = &whole[..whole.len() - left.len()];
            let lines = written.iter().filter(|byte| **byte == b'\n').count();
            assert_eq!(rows.len(), lines.saturating_sub(1));
            assert_eq!(rows.files[0].is_cut, !written.ends_with(b"\n"));
            rest = left;
            if left.is_empty() {
                break;
            }
        }
        assert!(rows.is_whole() && rows.files[0].damaged.is_empty());
        assert_eq!(cases(&rows), CASES);
    }

    #[test]
    fn rows_of_others_are_refused_by_name_and_never_count() {
        type Change = fn(&mut Header);
        let changes: [(&str, Change); 6] = [
            ("another canrig (1)", |header| {
                header.identity.program = "q".to_owned()
            }),
            ("another plant (dc_motor)", |header| {
                header.identity.plant = "dc_motor".to_owned()
            }),
            ("another law (mpc)", |header| {
                header.identity.law = "mpc".to_owned()
            }),
            ("another scenario.toml", |header| {
                header
                    .identity
                    .files
                    .insert("scenario.toml".to_owned(), "2f".to_owned());
            }),
            ("another cart.fmu", |header| {
                header
                    .identity
                    .files
                    .insert("cart.fmu".to_owned(), "1f".to_owned());
            }),
            ("another campaign", |header| header.sweep = "t".to_owned()),
        ];
        for (other, change) in changes {
            let parent = tempfile::tempdir().unwrap();
            let folder = parent.path().join("it's");
            fs::create_dir(&folder).unwrap();
            let mut theirs = header("s");
            change(&mut theirs);
            Writer::begin(&folder, &header("s")).unwrap();
            let mut writer = Writer::begin(&folder, &theirs).unwrap();
            writer.append(&row(2)).unwrap();
            let error = read(&folder).unwrap_err();
            assert_eq!(error.exit, Exit::CannotStart);
            let path = folder.join("rows-2.jsonl");
            let message = format!(
                "{} has rows of {other}, and nothing of it counts here.",
                path.display()
            );
            assert!(error.to_string().starts_with(&message), "{error}");
            let quoted = folder.to_string_lossy().replace('\'', "'\\''");
            assert!(
                error
                    .to_string()
                    .contains(&format!("`rm '{quoted}'/rows*.jsonl`")),
                "{error}"
            );
            // The rows do not count under a header of ours, or without one, either.
            let text = fs::read_to_string(&path).unwrap();
            let (_, theirs) = text.split_once('\n').unwrap();
            for begin in [header("s").line(), "\n".to_owned(), String::new()] {
                fs::write(&path, begin + theirs).unwrap();
                let rows = read(&folder).unwrap();
                assert_eq!((rows.len(), rows.files[1].damaged.is_empty()), (0, false));
            }
        }
    }

    #[test]
    fn a_folder_has_the_first_header_that_checks() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Header::read(folder.path()).unwrap().is_none());
        fs::write(folder.path().join("rows.jsonl"), "{}\n").unwrap();
        assert!(Header::read(folder.path()).unwrap().is_none());
        for sweep in ["s", "t"] {
            Writer::begin(folder.path(), &header(sweep)).unwrap();
        }
        let found = Header::read(folder.path()).unwrap().unwrap();
        assert_eq!((found.sweep.as_str(), found.runs), ("s", 12));
    }

    #[test]
    fn a_line_that_is_longer_than_any_row_is_refused_and_not_read_to_its_end() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &CASES);
        let path = folder.path().join("rows-2.jsonl");
        // A sparse file takes no room, but would take an hour to read.
        let file = File::create(&path).unwrap();
        file.set_len(4 << 40).unwrap();
        let error = read(folder.path()).unwrap_err();
        let message = format!("{} has a line of more than 1048576 bytes", path.display());
        assert!(error.to_string().starts_with(&message), "{error}");
        file.set_len(LINE_BYTES_MAX - 1).unwrap();
        assert_eq!(cases(&read(folder.path()).unwrap()), CASES);
    }

    #[test]
    fn a_file_that_is_being_written_is_refused_with_its_writer() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &[2]);
        let rows = read(folder.path()).unwrap();
        rows.require_unwritten().unwrap();
        let writer = Writer::begin(folder.path(), &header("s")).unwrap();
        let rows = read(folder.path()).unwrap();
        let error = rows.require_unwritten().unwrap_err().to_string();
        let message = "rows-2.jsonl is being written by process 34 on n12: wait";
        assert!(error.contains(message), "{error}");
        drop(writer);
        rows.require_unwritten().unwrap();
    }

    #[test]
    fn a_row_that_is_another_one_than_was_read_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let bytes = write(folder.path(), &CASES);
        let rows = read(folder.path()).unwrap();
        let mut lines: Vec<&[u8]> = bytes.split_inclusive(|byte| *byte == b'\n').collect();
        lines.swap(2, 3);
        let last = String::from_utf8_lossy(lines[4]).replace("id", "di");
        lines[4] = last.as_bytes();
        fs::write(folder.path().join("rows.jsonl"), lines.concat()).unwrap();
        let found = rows.iter().unwrap().map(|row| match row {
            Err(failure) => {
                assert!(failure.reason.contains("has changed since it was read"));
                failure.reason.split(' ').nth(4).unwrap().parse().unwrap()
            }
            Ok(_) => 0,
        });
        assert_eq!(Vec::from_iter(found), [0, 5, 8, 11]);
    }

    #[test]
    fn missing_cases_are_counted_and_ten_of_them_named() {
        let folder = tempfile::tempdir().unwrap();
        let missing = |shard| {
            let rows = Rows::read(folder.path(), &header("s"), shard).unwrap();
            rows.require_all().unwrap_err().to_string()
        };
        write(folder.path(), &[2]);
        let message = "11 of 12 cases are missing: 1, 3, 4, 5, 6, 7, 8, 9, 10, 11, ….";
        assert!(missing(Shard::WHOLE).starts_with(message));
        assert!(missing(SHARD).starts_with("3 of 4 cases are missing: 5, 8, 11."));
        write(folder.path(), &[5]);
        assert!(missing(Shard::WHOLE).contains(" 10, 11, 12."));
    }

    #[test]
    fn room_is_asked_for_where_it_is_missing_only() {
        let message = |kind: io::ErrorKind| write_error(Path::new("rows"))(kind.into()).to_string();
        assert!(message(io::ErrorKind::StorageFull).contains("kept: make room, and give"));
        assert!(message(io::ErrorKind::QuotaExceeded).contains("make room"));
        let message = message(io::ErrorKind::PermissionDenied);
        assert!(message.ends_with("see that it can be written, and give the same command again"));
    }
}
