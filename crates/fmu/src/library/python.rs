//! The library of Python for FMUs written in Python. They expect the program that loads them to contain it. This
//! program does not, so it finds and opens the library first.

use std::path::{Path, PathBuf};

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};

use crate::error::Fault;

/// Versions of Python 3 that are tried, the newest first.
const MINOR_VERSIONS: std::ops::RangeInclusive<u32> = 8..=20;

/// Returns the symbol of Python that the system's loader misses, such as `_Py_NoneStruct`.
pub(super) fn missing_symbol(reason: &str) -> Option<&str> {
    let (_, symbol) = reason.split_once("undefined symbol: ")?;
    let symbol = symbol.split([' ', ',', ')']).next()?;
    let is_python = symbol.starts_with("Py") || symbol.starts_with("_Py");
    is_python.then_some(symbol)
}

/// Opens the library of Python for all libraries that are loaded later.
pub(super) fn open(symbol: &str) -> Result<(), Fault> {
    if candidates().iter().any(|path| open_if_there(path)) {
        return Ok(());
    }
    Err(Fault::library(format!(
        "it is written in Python and needs its library (symbol {symbol}), and no libpython3.*.so was found beside the python3 in \
         PATH or where the system looks; install it (Debian: apt install libpython3-dev), or name its folder in LD_LIBRARY_PATH"
    )))
}

/// Opens a library if it is there, and returns whether it is.
pub(super) fn open_if_there(path: &Path) -> bool {
    // SAFETY: Python's library only defines symbols until it is initialized.
    let opened = unsafe { Library::open(Some(path), RTLD_NOW | RTLD_GLOBAL) };
    // The library stays loaded: code that uses an interpreter cannot lose it.
    opened.map(std::mem::forget).is_ok()
}

/// Returns candidates for the library. That of the `python3` in PATH is first, since its packages fit.
fn candidates() -> Vec<PathBuf> {
    let mut candidates = Vec::new();
    if let Some((prefix, minor)) = interpreter() {
        let name = library_name(minor);
        candidates.push(prefix.join("lib").join(&name));
        candidates.push(PathBuf::from(name));
    }
    // The system searches for a name without a folder.
    candidates.extend(MINOR_VERSIONS.rev().map(library_name).map(PathBuf::from));
    candidates
}

fn library_name(minor: u32) -> String {
    format!("libpython3.{minor}.so.1.0")
}

/// Returns prefix and minor version of the `python3` in PATH; links to it are followed.
fn interpreter() -> Option<(PathBuf, u32)> {
    let path = std::env::var_os("PATH")?;
    let found = std::env::split_paths(&path).map(|folder| folder.join("python3"));
    let program = found
        .filter(|program| program.is_file())
        .find_map(|program| {
            let program = program.canonicalize().ok()?;
            let minor = minor_version(&program)?;
            Some((program, minor))
        });
    let (program, minor) = program?;
    let prefix = program.parent()?.parent()?.to_owned();
    Some((prefix, minor))
}

/// Returns 11 for `/usr/bin/python3.11`.
fn minor_version(program: &Path) -> Option<u32> {
    let name = program.file_name()?.to_str()?;
    name.strip_prefix("python3.")?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_symbol_of_python_is_told_from_others() {
        let said = |symbol: &str| format!("/tmp/x.so: undefined symbol: {symbol}");
        assert_eq!(
            missing_symbol(&said("_Py_NoneStruct")),
            Some("_Py_NoneStruct")
        );
        assert_eq!(missing_symbol(&said("PyList_New")), Some("PyList_New"));
        assert_eq!(missing_symbol(&said("cblas_dgemm")), None);
        assert_eq!(missing_symbol("invalid ELF header"), None);
    }

    #[test]
    fn an_interpreter_s_name_has_its_version() {
        assert_eq!(minor_version(Path::new("/usr/bin/python3.11")), Some(11));
        assert_eq!(minor_version(Path::new("/opt/shims/python3")), None);
    }

    #[test]
    fn an_older_library_is_tried_after_a_newer_one() {
        let oldest = ["libpython3.9.so.1.0", "libpython3.8.so.1.0"].map(PathBuf::from);
        assert!(candidates().ends_with(&oldest));
    }
}
