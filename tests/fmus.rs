//! `canrig fmu`: what it tells and refuses. That FMUs play is shown by `tests/fmu/run`, beside FMPy.

use std::fs;
use std::path::Path;
use std::process::Command;

use fmu::description::Version;
use fmu::export::write_fmu;

use crate::support::output;

fn fmu(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.current_dir(folder).arg("fmu").args(arguments);
    output(&mut canrig)
}

/// The FMU of the motor, with a library that nobody could load.
fn motor(folder: &Path, version: Version) {
    let shipped = fmu_plants::shipped();
    let models = shipped.iter().map(|exported| exported.model());
    let model = { models }.find(|model| model.name == "dc_motor").unwrap();
    let file = fs::File::create(folder.join("motor.fmu")).unwrap();
    write_fmu(file, &model, version, b"no library").unwrap();
}

#[test]
fn an_fmu_is_listed_and_proposed_without_being_loaded() {
    for version in [Version::Two, Version::Three] {
        let folder = tempfile::tempdir().unwrap();
        motor(folder.path(), version);
        let (code, told, error) = fmu(folder.path(), &["motor.fmu"]);
        assert_eq!(code, Some(0), "{error}");
        for words in [
            &format!("motor.fmu: dc_motor, FMI {}", version.name()),
            "made by canrig",
            "(this machine)",
            "steps: of any length",
            "current_amperes",
            "start 0.0235",
        ] {
            assert!(told.contains(words), "{words}: {told}");
        }
        let (code, table, _) = fmu(folder.path(), &["motor.fmu", "--rig"]);
        assert_eq!(code, Some(0));
        let table: toml::Table = table.parse().unwrap();
        let ports = &table["plant"]["dc_motor"]["fmu"]["ports"];
        assert!(ports.get("position_metres").is_some(), "{ports}");
    }
}

#[test]
fn what_is_no_fmu_ends_in_3() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.fmu"), "PK").unwrap();
    let (code, _, error) = fmu(folder.path(), &["a.fmu"]);
    assert_eq!(code, Some(3));
    assert!(error.contains("a.fmu: it is no zip file"), "{error}");
    let (code, _, error) = fmu(folder.path(), &["b.fmu"]);
    assert_eq!(code, Some(3));
    assert!(error.contains("b.fmu: it cannot be opened"), "{error}");
}

#[test]
fn a_plant_that_does_not_ship_is_not_exported() {
    let folder = tempfile::tempdir().unwrap();
    let (code, _, error) = fmu(folder.path(), &["--export", "steam"]);
    assert_eq!(code, Some(2));
    assert!(error.contains("there are: sma, dc_motor"), "{error}");
    let (code, _, _) = fmu(folder.path(), &[]);
    assert_eq!(code, Some(2));
}
