//! Hashes of files that a run used and that are too large to be copied, in the format of `sha256sum`.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::file::{open_file, read_text};

/// End of the name of a file with a hash; the rest is the name of the hashed file, in the same folder.
pub const HASH_SUFFIX: &str = ".sha256";
/// Largest length of a file with a hash.
const TEXT_BYTES_MAX: u64 = 4096;
/// Length of the part of a file that is in memory at a time.
const PART_BYTES: usize = 64 << 10;

/// Returns the line of a file, by its path from a folder: `HASH  NAME`. If the folder has such a line already, as a run folder
/// has, both must be the same.
///
/// # Errors
/// The file cannot be read, or its hash differs from the line.
pub(crate) fn hash_line(folder: &Path, file: &str) -> io::Result<String> {
    let path = folder.join(file);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let line = format!("{}  {name}\n", file_hash(open_file(&path)?)?);
    let text = format!("{file}{HASH_SUFFIX}");
    match read_text(&folder.join(&text), TEXT_BYTES_MAX) {
        Ok(stated) if hash_in(&stated) != hash_in(&line) => Err(io::Error::new(
            io::ErrorKind::InvalidData,
            format!("it is not the file that {text} says; remove that, if this one is meant"),
        )),
        _ => Ok(line),
    }
}

/// Returns the hash in such a line.
pub fn hash_in(line: &str) -> &str {
    line.split_whitespace().next().unwrap_or_default()
}

/// Returns the SHA-256 of a file, in hexadecimal digits.
///
/// # Errors
/// The file cannot be read.
pub fn file_hash(mut file: File) -> io::Result<String> {
    let mut hasher = Sha256::new();
    let mut part = vec![0; PART_BYTES];
    loop {
        match file.read(&mut part)? {
            0 => break,
            length => hasher.update(&part[..length]),
        }
    }
    Ok(hexadecimal(hasher.finalize()))
}

/// Returns two hexadecimal digits for each byte, as in hashes.
pub fn hexadecimal(bytes: impl AsRef<[u8]>) -> String {
    let bytes = bytes.as_ref().iter();
    bytes.map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn each_byte_has_two_digits() {
        assert_eq!(hexadecimal([0, 10, 255]), "000aff");
    }

    #[test]
    fn a_line_is_that_of_sha256sum_and_another_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        fs::create_dir(place("rigs")).unwrap();
        fs::write(place("rigs/a.fmu"), "abc").unwrap();
        // First example of FIPS 180-4.
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  a.fmu\n";
        assert_eq!(hash_line(folder.path(), "rigs/a.fmu").unwrap(), expected);
        fs::write(place("rigs/a.fmu.sha256"), expected).unwrap();
        assert!(hash_line(folder.path(), "rigs/a.fmu").is_ok());
        fs::write(place("rigs/a.fmu"), "abd").unwrap();
        let error = hash_line(folder.path(), "rigs/a.fmu").unwrap_err();
        assert!(
            error
                .to_string()
                .contains("not the file that rigs/a.fmu.sha256 says")
        );
    }
}
