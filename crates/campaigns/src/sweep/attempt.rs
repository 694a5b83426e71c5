//! A part of a campaign that any number of machines may play at once, in a folder that they share, without locks.
//!
//! Each attempt has a file of its own, `attempt.<machine>.<random>.jsonl`, which begins with the rows that earlier ones left.
//! When all rows of the part are in it, it takes the name `rows.jsonl`. Rows follow from the case alone, so it does not matter
//! whose file comes last: the bytes are the same.

use std::collections::BTreeMap;
use std::env;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use super::store::{
    self, Content, FILE, Header, Recovered, Store, StoreError, read_error, write_error,
};
use recording::run_folder::own_file;

/// How the names of attempts begin.
const PREFIX: &str = "attempt.";
const SUFFIX: &str = ".jsonl";
/// Name of the file that says which machine began and ended attempts.
const LOG: &str = recording::run_folder::file::ATTEMPTS;
/// Largest log that is read: some hundred thousand attempts.
const LOG_BYTES_MAX: u64 = 16 << 20;
/// Random characters in the name of an attempt.
const RANDOM_CHARACTERS: usize = 8;
/// Where the name of the machine is: what the engine calls it, else the kernel.
const NODE_VARIABLES: [&str; 2] = ["CANRIG_NODE", "SLURMD_NODENAME"];
const NODE_CHARACTERS_MAX: usize = 60;
const KERNEL_NODE: &str = "/proc/sys/kernel/hostname";

/// An attempt at a part, as its log has it.
#[derive(Clone, Debug, Eq, PartialEq)]
pub(crate) struct Tried {
    /// On which machine.
    pub(crate) node: String,
    /// What became of it.
    pub(crate) fate: Fate,
}

/// What became of an attempt.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(crate) enum Fate {
    /// Nobody knows: it is at work, or was killed.
    Lost,
    /// It was stopped before its end.
    Left,
    /// All rows of the part were there.
    Ended,
}

/// Begins an attempt at a part with the rows that others left; or opens the part, where it is whole.
pub(crate) fn open(folder: &Path, header: &Header) -> Result<(Store, Recovered), StoreError> {
    let path = folder.join(FILE);
    let mut found = Recovered::default();
    let mut sources = Vec::new();
    if let Some((file, content)) = published(folder, header, &mut found)? {
        if content.is_whole(header) {
            return Ok((Store::of_whole(path, file, header, content), found));
        }
        found.set_aside.extend(content.set_aside(&file, &path)?);
        sources.push((file, content.rows));
    }
    for path in attempts(folder).map_err(read_error(folder))? {
        if let Some((file, content)) = attempt_at(&path, header)? {
            found.set_aside.extend(content.set_aside(&file, &path)?);
            sources.push((file, content.rows));
        }
    }
    let store = begin(folder, header, &sources)?;
    log(folder, "began", &store)?;
    Ok((store, found))
}

/// What has the name of the part's rows, if anything. Rows of another program are set aside, and somebody else's file is refused.
fn published(
    folder: &Path,
    header: &Header,
    found: &mut Recovered,
) -> Result<Option<(File, Content)>, StoreError> {
    let path = folder.join(FILE);
    let Some((file, content)) = content(&path, header)? else {
        return Ok(None);
    };
    if content.is_older(header) {
        let aside = super::store::set_older_aside(&path, &content);
        found.set_aside.push(aside.map_err(write_error(&path))?);
        return Ok(None);
    }
    match content.is_ours(&file, header).map_err(read_error(&path))? {
        true => Ok(Some((file, content))),
        false => Err(StoreError::Foreign { path }),
    }
}

/// What is in the file of an attempt at this part by this program. One that is gone has become the rows of the part, or its machine
/// tidies up: then its rows are played again.
fn attempt_at(path: &Path, header: &Header) -> Result<Option<(File, Content)>, StoreError> {
    let Ok(file) = store::open(path) else {
        return Ok(None);
    };
    let content = Content::read(&file, header).map_err(read_error(path))?;
    let is_ours = content.is_ours(&file, header).map_err(read_error(path))?;
    Ok(is_ours.then_some((file, content)))
}

/// A file and what is in it; none where there is none.
fn content(path: &Path, header: &Header) -> Result<Option<(File, Content)>, StoreError> {
    let file = match store::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        opened => opened.map_err(read_error(path))?,
    };
    let content = Content::read(&file, header).map_err(read_error(path))?;
    Ok(Some((file, content)))
}

/// A new attempt, with the rows of earlier ones.
fn begin(
    folder: &Path,
    header: &Header,
    sources: &[(File, BTreeMap<usize, super::sealed::Place>)],
) -> Result<Store, StoreError> {
    let failed = || write_error(folder);
    let prefix = format!("{PREFIX}{}.", node());
    let file = tempfile::Builder::new()
        .prefix(&prefix)
        .suffix(SUFFIX)
        .rand_bytes(RANDOM_CHARACTERS)
        // Whatever the user's own mask admits.
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder)
        .map_err(failed())?;
    let mut store = Store::new(
        file.path().to_owned(),
        file.reopen().map_err(failed())?,
        header,
    );
    store.take_over(sources).map_err(failed())?;
    // Until here its end, also by an error, removes it.
    file.keep()
        .map_err(|error| write_error(folder)(error.error))?;
    Ok(store)
}

/// The rows of an attempt that has all of them become those of the part. What other attempts left is removed.
pub(crate) fn publish(
    store: &Store,
    folder: &Path,
    header: &Header,
) -> Result<Recovered, StoreError> {
    let path = folder.join(FILE);
    let mut found = Recovered::default();
    if store.path() == path {
        return Ok(found);
    }
    // Since this attempt began, anybody may have put a file there.
    let renamed = match published(folder, header, &mut found)? {
        Some(_) => fs::rename(store.path(), &path),
        None => rename_to_new(store.path(), &path),
    };
    match renamed {
        Err(_) if is_whole(folder, header)? => {}
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            return Err(StoreError::Foreign { path });
        }
        renamed => renamed.map_err(write_error(&path))?,
    }
    log(folder, "ended", store)?;
    for path in attempts(folder).map_err(read_error(folder))? {
        if let Ok(Some(_)) = attempt_at(&path, header) {
            // One that is still at work finds the part whole.
            let _ = fs::remove_file(path);
        }
    }
    Ok(found)
}

/// Gives a file a name that no other file has, also where somebody makes one at this moment. Some file systems have no second names, and
/// cannot do that.
fn rename_to_new(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        Ok(()) => fs::remove_file(from),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
        Err(_) => fs::rename(from, to),
    }
}

/// Notes that an attempt was stopped in order: its rows stay where they are.
pub(crate) fn leave(store: &Store, folder: &Path) -> Result<(), StoreError> {
    log(folder, "left", store)
}

/// Whether a file is that of a part whose attempt has ended.
pub(crate) fn is_published(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == FILE)
}

/// Whether all rows of the part are there.
pub(crate) fn is_whole(folder: &Path, header: &Header) -> Result<bool, StoreError> {
    let found = content(&folder.join(FILE), header)?;
    Ok(found.is_some_and(|(_, content)| content.is_whole(header)))
}

/// The files of a part that grow while it is played.
pub(crate) fn growing(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let published = folder.join(FILE);
    match published.exists() {
        true => Ok(vec![published]),
        false => attempts(folder),
    }
}

/// The attempts at a part so far, from its log.
pub(crate) fn tried(folder: &Path) -> io::Result<Vec<Tried>> {
    let text = match scenario::read_text(&own_file(folder, LOG)?, LOG_BYTES_MAX) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        text => text?,
    };
    let mut tried: Vec<(&str, Tried)> = Vec::new();
    for line in text.lines() {
        let mut words = line.split(' ');
        let (Some(what), Some(attempt), Some(node)) = (words.next(), words.next(), words.next())
        else {
            continue;
        };
        match what {
            "began" => tried.push((
                attempt,
                Tried {
                    node: node.to_owned(),
                    fate: Fate::Lost,
                },
            )),
            _ => {
                let known = tried.iter_mut().find(|(known, _)| *known == attempt);
                if let Some((_, one)) = known {
                    one.fate = match what {
                        "ended" => Fate::Ended,
                        _ => Fate::Left,
                    };
                }
            }
        }
    }
    Ok(tried.into_iter().map(|(_, one)| one).collect())
}

/// Appends a line: what, which attempt, on which machine, with how many rows.
fn log(folder: &Path, what: &str, store: &Store) -> Result<(), StoreError> {
    let path = folder.join(LOG);
    own_file(folder, LOG).map_err(write_error(&path))?;
    let attempt = store.path().file_name().unwrap_or_default();
    let attempt = attempt.to_string_lossy();
    let line = format!("{what} {attempt} {} {}\n", node(), store.len());
    let file = OpenOptions::new().append(true).create(true).open(&path);
    let written = file.and_then(|mut file| file.write_all(line.as_bytes()));
    written.map_err(write_error(&path))
}

/// The files of attempts in a folder.
fn attempts(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(PREFIX) && name.ends_with(SUFFIX) {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}

/// What this machine is called.
fn node() -> String {
    let mut named = NODE_VARIABLES.iter();
    let named = named.find_map(|name| env::var(name).ok());
    let named = named.or_else(|| fs::read_to_string(KERNEL_NODE).ok());
    let is_plain = |letter: &char| letter.is_ascii_alphanumeric() || *letter == '-';
    let named = named.unwrap_or_default();
    let named: String = named
        .chars()
        .filter(is_plain)
        .take(NODE_CHARACTERS_MAX)
        .collect();
    match named.is_empty() {
        true => "unknown".to_owned(),
        false => named,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::row::{Ended, SweepRow};
    use crate::sweep::store::tests::header;

    const CASES: [usize; 10] = [2, 5, 8, 11, 14, 17, 20, 23, 26, 29];

    fn ours() -> Header {
        header("s", "p")
    }

    fn row(case: usize) -> SweepRow {
        SweepRow::without_verdict(case, "id", Ended::Fail, "r".to_owned())
    }

    fn play(store: &mut Store, count: usize) {
        let left = CASES.into_iter().filter(|case| !store.has(*case));
        let left: Vec<usize> = left.take(count).collect();
        left.iter()
            .for_each(|case| store.append(&row(*case)).unwrap());
    }

    fn end(mut store: Store, folder: &Path) {
        play(&mut store, CASES.len());
        store.finish().unwrap();
        publish(&store, folder, &ours()).unwrap();
    }

    fn rows(folder: &Path) -> Vec<u8> {
        fs::read(folder.join(FILE)).unwrap()
    }

    /// The bytes of a part that one machine played undisturbed.
    fn undisturbed() -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        end(open(folder.path(), &ours()).unwrap().0, folder.path());
        rows(folder.path())
    }

    #[test]
    fn two_at_once_leave_the_same_bytes_and_the_second_finds_the_part_whole() {
        let folder = tempfile::tempdir().unwrap();
        let (mut one, _) = open(folder.path(), &ours()).unwrap();
        let (mut other, _) = open(folder.path(), &ours()).unwrap();
        play(&mut one, 2);
        play(&mut other, 3);
        end(one, folder.path());
        assert_eq!(rows(folder.path()), undisturbed());
        // Its file is gone.
        end(other, folder.path());
        assert_eq!(rows(folder.path()), undisturbed());
        assert!(attempts(folder.path()).unwrap().is_empty());
        let (whole, _) = open(folder.path(), &ours()).unwrap();
        assert_eq!(whole.len(), 10);
        assert!(is_whole(folder.path(), &ours()).unwrap());
        let tried = tried(folder.path()).unwrap();
        assert_eq!(
            tried.iter().filter(|one| one.fate == Fate::Ended).count(),
            2
        );
    }

    #[test]
    fn rows_of_an_attempt_that_was_killed_count_but_a_torn_one() {
        let folder = tempfile::tempdir().unwrap();
        let (mut killed, _) = open(folder.path(), &ours()).unwrap();
        play(&mut killed, 3);
        let path = killed.path().to_owned();
        drop(killed);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 5]).unwrap();
        // And one that got no further than half of its header.
        fs::write(folder.path().join("attempt.n1.x.jsonl"), &bytes[..20]).unwrap();
        assert!(!is_whole(folder.path(), &ours()).unwrap());
        let (store, found) = open(folder.path(), &ours()).unwrap();
        assert_eq!((store.len(), found.set_aside.len()), (2, 0));
        end(store, folder.path());
        assert_eq!(rows(folder.path()), undisturbed());
        let tried = tried(folder.path()).unwrap();
        let seen: Vec<_> = tried.iter().map(|one| one.fate).collect();
        assert_eq!(seen, [Fate::Lost, Fate::Ended]);
    }

    #[test]
    fn what_is_damaged_in_an_attempt_is_named_kept_and_played_again() {
        for damaged_line in [1, 4] {
            let folder = tempfile::tempdir().unwrap();
            let (mut killed, _) = open(folder.path(), &ours()).unwrap();
            play(&mut killed, 5);
            let path = killed.path().to_owned();
            drop(killed);
            let bytes = fs::read(&path).unwrap();
            let mut lines: Vec<Vec<u8>> = bytes
                .split_inclusive(|byte| *byte == b'\n')
                .map(<[u8]>::to_vec)
                .collect();
            let line = &mut lines[damaged_line - 1];
            line[30] ^= 1;
            let damaged = line.clone();
            fs::write(&path, lines.concat()).unwrap();
            let (store, found) = open(folder.path(), &ours()).unwrap();
            let words = format!("line {damaged_line} of {} is damaged", path.display());
            assert!(
                found.set_aside.concat().starts_with(&words),
                "{:?}",
                found.set_aside
            );
            let kept = fs::read(folder.path().join("rows.damaged.jsonl")).unwrap();
            assert_eq!(kept, damaged);
            assert_eq!(store.len(), if damaged_line == 1 { 5 } else { 4 });
            end(store, folder.path());
            assert_eq!(rows(folder.path()), undisturbed());
            assert!(attempts(folder.path()).unwrap().is_empty());
        }
    }

    #[test]
    fn what_comes_into_the_place_of_the_rows_meanwhile_is_left_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, _) = open(folder.path(), &ours()).unwrap();
        play(&mut store, CASES.len());
        store.finish().unwrap();
        let theirs = "notes of somebody else\n".repeat(100);
        fs::write(folder.path().join(FILE), &theirs).unwrap();
        let error = publish(&store, folder.path(), &ours()).unwrap_err();
        assert!(matches!(error, StoreError::Foreign { .. }), "{error}");
        assert_eq!(rows(folder.path()), theirs.as_bytes());
        // When it is gone, the rows are still there.
        fs::remove_file(folder.path().join(FILE)).unwrap();
        let (again, _) = open(folder.path(), &ours()).unwrap();
        assert_eq!(again.len(), CASES.len());
    }

    #[test]
    fn a_name_that_somebody_takes_first_is_theirs() {
        let folder = tempfile::tempdir().unwrap();
        let [ours, theirs, new] = ["ours", "theirs", "new"].map(|name| folder.path().join(name));
        for path in [&ours, &theirs] {
            fs::write(path, path.file_name().unwrap().as_encoded_bytes()).unwrap();
        }
        let error = rename_to_new(&ours, &theirs).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&theirs).unwrap(), b"theirs");
        rename_to_new(&ours, &new).unwrap();
        assert_eq!(fs::read(new).unwrap(), b"ours");
        assert!(!ours.exists());
    }

    #[test]
    fn rows_of_another_program_or_campaign_never_count() {
        let folder = tempfile::tempdir().unwrap();
        end(open(folder.path(), &ours()).unwrap().0, folder.path());
        // Another campaign's part: left alone.
        let error = open(folder.path(), &header("t", "p")).unwrap_err();
        assert!(matches!(error, StoreError::Foreign { .. }), "{error}");
        assert_eq!(rows(folder.path()), undisturbed());
        // Another program's rows: kept, and played again.
        let (store, found) = open(folder.path(), &header("s", "q")).unwrap();
        assert_eq!(store.len(), 0);
        assert!(found.set_aside.concat().contains("another canrig"));
        let kept = fs::read(folder.path().join("rows.older.jsonl")).unwrap();
        assert_eq!(kept, undisturbed());
        // An attempt of another campaign beside ours is not looked at.
        let folder = tempfile::tempdir().unwrap();
        let (mut foreign, _) = open(folder.path(), &header("t", "p")).unwrap();
        play(&mut foreign, 3);
        assert_eq!(open(folder.path(), &ours()).unwrap().0.len(), 0);
    }

    #[test]
    fn a_damaged_row_of_a_whole_part_is_named_and_played_again() {
        let folder = tempfile::tempdir().unwrap();
        end(open(folder.path(), &ours()).unwrap().0, folder.path());
        let mut bytes = rows(folder.path());
        let middle = bytes.len() - 40;
        bytes[middle] ^= 1;
        fs::write(folder.path().join(FILE), bytes).unwrap();
        assert!(!is_whole(folder.path(), &ours()).unwrap());
        let (store, found) = open(folder.path(), &ours()).unwrap();
        assert_eq!(store.len(), 9);
        assert!(found.set_aside.concat().contains("is damaged"));
        end(store, folder.path());
        assert_eq!(rows(folder.path()), undisturbed());
    }
}
