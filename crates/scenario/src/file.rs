//! Files that other programs may have written: only regular files are opened, and only up to a length are they read.

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Opens a file to read it.
///
/// # Errors
/// It cannot be read, or is no regular file: a pipe would block until another program writes to it, and a device may have no end.
pub fn open_file(path: &Path) -> io::Result<File> {
    require_file(path)?;
    File::open(path)
}

/// Refuses all but regular files: reading a pipe would wait, and a device might never end.
///
/// # Errors
/// The file does not exist, or is no regular file.
pub fn require_file(path: &Path) -> io::Result<()> {
    let kind = path.metadata()?.file_type();
    if kind.is_file() {
        return Ok(());
    }
    let kind = match () {
        () if kind.is_dir() => "a folder",
        () if kind.is_fifo() => "a pipe",
        () if kind.is_socket() => "a socket",
        () => "a device",
    };
    Err(io::Error::other(format!("it is {kind}, not a file")))
}

/// Reads a file of text.
///
/// # Errors
/// As [`open_file`]; or it is no text, or longer than `bytes_max`.
pub fn read_text(path: &Path, bytes_max: u64) -> io::Result<String> {
    let mut text = String::new();
    let mut file = open_file(path)?.take(bytes_max + 1);
    let read = file.read_to_string(&mut text)?;
    refuse_long(read, bytes_max)?;
    Ok(text)
}

/// Reads the text of an EDS, in whatever encoding its maker wrote it.
///
/// # Errors
/// As [`open_file`]; or it is longer than `bytes_max`.
pub fn read_sheet(path: &Path, bytes_max: u64) -> io::Result<String> {
    let mut bytes = Vec::new();
    let mut file = open_file(path)?.take(bytes_max + 1);
    let read = file.read_to_end(&mut bytes)?;
    refuse_long(read, bytes_max)?;
    Ok(canopen::eds::text(bytes))
}

/// Checks whether a file is an EDS or a DCF by its name.
pub(crate) fn is_sheet(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default();
    ["eds", "dcf"]
        .iter()
        .any(|one| extension.eq_ignore_ascii_case(one))
}

fn refuse_long(bytes: usize, bytes_max: u64) -> io::Result<()> {
    if bytes as u64 > bytes_max {
        let reason = format!("it is longer than {bytes_max} bytes");
        return Err(io::Error::other(reason));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::net::UnixListener;
    use std::process::Command;

    use super::*;

    #[test]
    fn what_is_no_file_is_refused_at_once_and_named() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        fs::create_dir(place("folder")).unwrap();
        assert!(
            Command::new("mkfifo")
                .arg(place("pipe"))
                .status()
                .unwrap()
                .success()
        );
        let _socket = UnixListener::bind(place("socket")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", place("device")).unwrap();
        for kind in ["folder", "pipe", "socket", "device"] {
            let error = read_text(&place(kind), 10).unwrap_err().to_string();
            assert_eq!(error, format!("it is a {kind}, not a file"));
        }
        let none = read_text(&place("none"), 10).unwrap_err();
        assert_eq!(none.kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn a_text_is_read_up_to_its_limit_and_through_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "0123456789").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert_eq!(read_text(&link, 10).unwrap(), "0123456789");
        let error = read_text(&file, 9).unwrap_err().to_string();
        assert_eq!(error, "it is longer than 9 bytes");
    }
}
