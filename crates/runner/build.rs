//! Lists the scenarios and rig files that ship, for `shipped`: each by its place below the folder to which it is copied.

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    // The folder of this build: checkouts that share a target folder share this program.
    let folder = env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it");
    let root = Path::new(&folder).join("../..");
    println!("cargo::rerun-if-changed=build.rs");
    let scenarios = root.join("scenarios");
    println!("cargo::rerun-if-changed={}", scenarios.display());
    let mut files = Vec::new();
    find(&scenarios, &mut files);
    let place = |file: &Path| file.strip_prefix(&scenarios).map(Path::to_owned);
    let entries = files
        .into_iter()
        .map(|file| (place(&file).expect("it was found there"), file));
    let mut entries = Vec::from_iter(entries);
    let rig = root.join("docs/examples/rig.toml");
    println!("cargo::rerun-if-changed={}", rig.display());
    entries.push((PathBuf::from("rigs/rig.toml"), rig));
    entries.sort();
    let lines: Vec<String> = entries
        .iter()
        .map(|(place, file)| format!("    ({place:?}, include_str!({file:?})),\n"))
        .collect();
    let list = format!("&[\n{}]\n", lines.concat());
    let output = env::var_os("OUT_DIR").expect("cargo sets it");
    fs::write(Path::new(&output).join("shipped.rs"), list).expect("cargo's folder takes files");
}

/// Finds the files below a folder that a new user of canrig needs. The schemas are left out, since the program makes them.
fn find(folder: &Path, files: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(folder).expect("the folder is in the repository");
    for path in entries.map(|entry| entry.expect("readable").path()) {
        if path.is_dir() {
            find(&path, files);
        } else if path
            .extension()
            .is_some_and(|kind| kind == "toml" || kind == "csv")
        {
            files.push(path);
        }
    }
}
