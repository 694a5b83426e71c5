//! Reports on wrong files, to the letter: `tests/data/reports/NAME.txt` is what `canrig check NAME.toml` says. After an
//! intended change: `UPDATE_SNAPSHOTS=1 cargo test --release -p canrig --test tests reports`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::output;

#[test]
fn wrong_files_are_reported_as_before() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/reports");
    let entries = fs::read_dir(&folder).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "toml")
    });
    files.sort();
    assert!(files.len() >= 20, "{files:?}");
    let mut changed = Vec::new();
    for file in files {
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        canrig.current_dir(&folder).env("NO_COLOR", "1");
        let (code, stdout, stderr) = output(canrig.arg("check").arg(file.file_name().unwrap()));
        assert_eq!(
            (code, &*stdout),
            (Some(3), ""),
            "{}: {stderr}",
            file.display()
        );
        let stored = file.with_extension("txt");
        if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
            fs::write(&stored, &stderr).unwrap();
        }
        let before = fs::read_to_string(&stored).unwrap_or_default();
        if before != stderr {
            changed.push(format!("{}:\n{stderr}", stored.display()));
        }
    }
    assert!(changed.is_empty(), "{}", changed.join("\n"));
}
