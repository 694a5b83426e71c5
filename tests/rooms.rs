//! The rooms keep apart what ARCHITECTURE.md says they keep apart.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::root;

/// Which rooms a room may depend on.
const MAY_DEPEND_ON: [(&str, &[&str]); 8] = [
    ("scenario", &["canopen"]),
    ("canopen", &[]),
    ("dbc", &["canopen"]),
    ("faults", &["scenario", "dbc", "canopen"]),
    ("controller", &["scenario", "dbc", "canopen", "platform"]),
    (
        "plant-emulator",
        &["scenario", "faults", "dbc", "canopen", "platform"],
    ),
    ("platform", &["canopen"]),
    (
        "canrig",
        &[
            "scenario",
            "faults",
            "dbc",
            "canopen",
            "controller",
            "plant-emulator",
            "platform",
        ],
    ),
];

fn manifest(path: &Path) -> toml::Table {
    fs::read_to_string(path).unwrap().parse().unwrap()
}

/// All dependencies of a manifest, those for tests too.
fn dependencies(manifest: &toml::Table) -> Vec<String> {
    let sections = ["dependencies", "dev-dependencies", "build-dependencies"];
    let tables = sections
        .iter()
        .filter_map(|section| manifest.get(*section)?.as_table());
    tables.flat_map(|table| table.keys().cloned()).collect()
}

#[test]
fn each_room_depends_only_on_the_rooms_it_may() {
    let allowed: BTreeMap<_, _> = MAY_DEPEND_ON.into_iter().collect();
    let members = manifest(&root().join("Cargo.toml"))["workspace"]["members"].clone();
    let members: Vec<String> = members.try_into().unwrap();
    assert_eq!(members.len(), allowed.len(), "a room without a rule");
    for member in &members {
        let depends_on = dependencies(&manifest(&root().join(member).join("Cargo.toml")));
        let rooms = depends_on.iter().filter(|name| members.contains(name));
        for room in rooms {
            assert!(
                allowed[member.as_str()].contains(&room.as_str()),
                "{member} must not depend on {room}"
            );
        }
    }
}

/// All Rust files below a folder, sorted.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    assert!(!files.is_empty());
    files
}

#[test]
fn libraries_of_nodes_do_not_know_the_platform() {
    for room in ["controller", "plant-emulator"] {
        for path in sources(&root().join(room).join("src")) {
            let names_platform = fs::read_to_string(&path).unwrap().contains("platform::");
            let is_main = path.ends_with("src/main.rs");
            assert!(
                !names_platform || is_main,
                "{} names platform",
                path.display()
            );
        }
    }
}

#[test]
fn only_platform_is_unsafe() {
    for room in MAY_DEPEND_ON
        .iter()
        .map(|(room, _)| room)
        .filter(|room| **room != "platform")
    {
        for path in sources(&root().join(room).join("src")) {
            let text = fs::read_to_string(&path).unwrap();
            assert!(!text.contains("unsafe "), "{} is unsafe", path.display());
        }
    }
}

#[test]
fn nothing_asks_whether_it_is_simulated() {
    for room in ["controller", "plant-emulator", "canopen"] {
        for path in sources(&root().join(room).join("src")) {
            let text = fs::read_to_string(&path).unwrap().to_lowercase();
            assert!(!text.contains("is_simulat"), "{} asks", path.display());
        }
    }
}
