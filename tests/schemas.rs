//! The JSON Schemas define the format: a file that is valid to `canrig check` is valid to an editor.

use std::fs;
use std::path::Path;
use std::process::Command;

use boon::{Compiler, Schemas};
use fmu::description::Version;

use crate::drawn::{self, Draw};
use crate::fmus::motor;
use crate::net::{MUTATED, copy_files};
use crate::support::{output, root};

fn canrig(folder: &Path, arguments: &[&str]) -> String {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, stdout, stderr) = output(canrig.current_dir(folder).args(arguments));
    assert_eq!(code, Some(0), "{stderr}");
    stdout
}

/// Asserts that files are valid to `canrig check` and to the schemas that `canrig schema` prints.
fn assert_valid_to_both(folder: &Path, files: &[String]) {
    let names = files.iter().map(String::as_str);
    canrig(folder, &Vec::from_iter(["check"].into_iter().chain(names)));
    let (mut schemas, mut compiler) = (Schemas::new(), Compiler::new());
    let mut printed = |name: &str, arguments: &[&str]| {
        let schema = serde_json::from_str(&canrig(folder, arguments)).unwrap();
        compiler.add_resource(name, schema).unwrap();
        compiler.compile(name, &mut schemas).unwrap()
    };
    let scenario_schema = printed("scenario.json", &["schema"]);
    let rig_schema = printed("rig.json", &["schema", "--rig"]);
    for file in files {
        let text = fs::read_to_string(folder.join(file)).unwrap();
        let table: toml::Table = text.parse().unwrap();
        // Each scenario names its rig.
        let schema = if table.contains_key("rig") {
            scenario_schema
        } else {
            rig_schema
        };
        let value = serde_json::to_value(table).unwrap();
        let found = schemas.validate(&value, schema);
        assert!(found.is_ok(), "{file}: {}\n{text}", found.unwrap_err());
    }
}

#[test]
fn what_ships_is_valid_to_both() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = Vec::new();
    for name in MUTATED.into_iter().chain(["tests/data/net/logs"]) {
        copy_files(&root().join(name), &folder.path().join(name), &mut files);
    }
    motor(&folder.path().join("docs/examples"), Version::Three);
    let files = files.iter().map(|file| {
        let file = file.strip_prefix(folder.path()).unwrap();
        file.to_str().unwrap().to_owned()
    });
    let files = Vec::from_iter(files);
    assert_valid_to_both(folder.path(), &files);
}

#[test]
fn what_is_drawn_is_valid_to_both() {
    let folder = tempfile::tempdir().unwrap();
    drawn::write_fmu_of_any_unit(folder.path());
    let mut files = Vec::new();
    for seed in 0..150 {
        let mut draw = Draw(seed);
        let (rig, axes) = drawn::rig(&mut draw);
        let rig_file = format!("rig_{seed}.toml");
        let scenario = drawn::scenario(&mut draw, &axes, &rig_file);
        for (file, text) in [(rig_file, rig), (format!("scenario_{seed}.toml"), scenario)] {
            fs::write(folder.path().join(&file), text).unwrap();
            files.push(file);
        }
    }
    assert_valid_to_both(folder.path(), &files);
}
