//! Output files at places that the user chooses.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::console::print;
use crate::exit::{Exit, Failure};
use recording::run_folder::{self, write_output, write_whole};

/// Writes a file.
pub(crate) fn write(place: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_with(place, |output| output.write_all(bytes))
}

/// Writes a file as [`write`] does, for content that is too long for the memory.
pub(crate) fn write_with(
    place: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), Failure> {
    write_output(place, write).map_err(|error| unwritten(place, &error))
}

/// Writes a text at a place where no file is yet. Makes a folder in its name.
///
/// # Errors
/// The file cannot be written, or is there already.
pub fn write_new(place: &Path, text: &str) -> Result<(), Failure> {
    let written = run_folder::write_new(place, |output| output.write_all(text.as_bytes()));
    written.map_err(|error| unwritten(place, &error))
}

/// Returns the failure of a file that the system does not write.
pub fn unwritten(place: &Path, error: &io::Error) -> Failure {
    let place = place.display();
    Exit::BenchFailed.because(format!("`{place}` cannot be written: {error}"))
}

/// Writes a page at the user's place, and prints the place.
///
/// # Errors
/// The page cannot be written.
pub fn write_page(place: &Path, text: &str) -> Result<(), Failure> {
    write(place, text.as_bytes())?;
    print(&place.display().to_string());
    Ok(())
}

/// Replaces the page of a run folder, and prints the place.
pub(crate) fn renew_page(place: &Path, text: &str) -> Result<(), Failure> {
    let written = write_whole(place, |output| output.write_all(text.as_bytes()));
    written.map_err(|error| unwritten(place, &error))?;
    print(&place.display().to_string());
    Ok(())
}

/// Returns the relative link from one file to another; `None` if there is none.
pub fn link(from: &Path, to: &Path) -> Option<String> {
    let from = match from.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let (from, to) = (fs::canonicalize(from).ok()?, fs::canonicalize(to).ok()?);
    let shared = from
        .components()
        .zip(to.components())
        .take_while(|(a, b)| a == b)
        .count();
    let up = from.components().skip(shared).map(|_| "..".to_owned());
    let down = to
        .components()
        .skip(shared)
        .map(|part| escaped(&part.as_os_str().to_string_lossy()));
    Some(up.chain(down).collect::<Vec<_>>().join("/"))
}

/// Escapes a part of a path in a link: characters with another meaning are percent-encoded.
fn escaped(part: &str) -> String {
    let escape = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' => {
            char::from(byte).to_string()
        }
        other => format!("%{other:02X}"),
    };
    part.bytes().map(escape).collect()
}
