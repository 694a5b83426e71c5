//! `canrig fmu`, with its output and its errors, and FMUs as plants behind drives. `fmu_workers.rs` tests their
//! processes. `tests/system/test_fmus.py` shows that FMUs of other tools play, in comparison with FMPy.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use fmu::description::Version;
use fmu::export::{Model, ModelVariable, Role, write_fmu};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::processes::last_command;
use crate::rigs::rig;
use crate::support::{canrig, only_run, output, root, runs};

fn fmu(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.current_dir(folder).arg("fmu").args(arguments);
    output(&mut canrig)
}

/// Writes the FMU of the motor, with a library that cannot be loaded.
pub(crate) fn motor(folder: &Path, version: Version) {
    let shipped = fmu_plants::shipped();
    let motor = shipped
        .iter()
        .find(|exported| exported.name() == "dc_motor");
    let model = motor.unwrap().model().unwrap();
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
        for expected in [
            &format!("motor.fmu: dc_motor, FMI {}", version.name()),
            "made by canrig",
            "(this machine)",
            "steps: of any length",
            "current_amperes",
            "start 0.0235",
        ] {
            assert!(told.contains(expected), "{expected}: {told}");
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
    assert!(error.contains("a.fmu: not a zip file"), "{error}");
    let (code, _, error) = fmu(folder.path(), &["b.fmu"]);
    assert_eq!(code, Some(3));
    assert!(error.contains("b.fmu: cannot be opened"), "{error}");
}

#[test]
fn a_plant_that_does_not_ship_is_not_exported() {
    let folder = tempfile::tempdir().unwrap();
    let (code, _, error) = fmu(folder.path(), &["--export", "steam"]);
    assert_eq!(code, Some(2));
    assert!(
        error.contains("there are: sma, dc_motor, sma_pair"),
        "{error}"
    );
    let (code, _, _) = fmu(folder.path(), &[]);
    assert_eq!(code, Some(2));
}

/// Arguments for lock-step in processes.
const LOCKSTEP: [&str; 4] = ["--clock", "lockstep", "--bus", "embedded"];

const STEP: &str = r#"
schema = 1
rig = "rigs/cart.toml"
name = "cart step"
duration_seconds = 2.5
[controller.pid]
proportional_amperes_per_metre = 64.8
integral_amperes_per_metre_second = 489.0
derivative_ampere_seconds_per_metre = 3.74
set_point_weight = 0.377
derivative_filter_radians_per_second = 500.0
[[reference.step]]
at_seconds = 0.5
position_millimetres = 20.0
[expect]
steady_state_error_millimetres = { max = 0.1 }
position_millimetres_max = { min = 19.0, max = 21.0 }
[[expect.signal]]
name = "speed_metres_per_second"
stays = { min = -2.0, max = 2.0 }
"#;

/// Writes the FMU of the cart, its rig file in a folder below the scenario's, and the scenario; `marker` makes another
/// FMU of the same model.
pub(crate) fn cart(folder: &Path, marker: &str) -> PathBuf {
    let library = folder.join("cart.so");
    let mut compiler = Command::new("cc");
    compiler
        .args(["-O2", "-shared", "-fPIC", "-o"])
        .arg(&library);
    let (code, _, error) = output(compiler.arg(root().join("tests/fmu/cart.c")));
    assert_eq!(code, Some(0), "{error}");
    let rigs = folder.join("rigs");
    fs::create_dir_all(&rigs).unwrap();
    write_cart(folder, marker, &fs::read(library).unwrap());
    fs::write(rigs.join("cart.toml"), rig("cart")).unwrap();
    let path = folder.join("step.toml");
    fs::write(&path, STEP).unwrap();
    path
}

/// Writes the FMU of the cart with this library.
fn write_cart(folder: &Path, marker: &str, library: &[u8]) {
    write_cart_with(folder, marker, library, "A");
}

fn write_cart_with(folder: &Path, marker: &str, library: &[u8], unit_of_input: &'static str) {
    let variable = |name: &str, unit, role| ModelVariable {
        name: name.to_owned(),
        description: String::new(),
        unit,
        role,
    };
    let number = |start, min, max| Role::Number { start, min, max };
    let model = Model {
        name: "cart".to_owned(),
        description: marker.to_owned(),
        version: "1".to_owned(),
        variables: vec![
            variable("current_amperes", unit_of_input, Role::Input(0.0)),
            variable("position_metres", "m", Role::Output),
            variable("speed_metres_per_second", "m/s", Role::Output),
            variable("mass_kilograms", "kg", number(2.4, Some(0.1), Some(10.0))),
            variable("mode", "", number(0.0, None, None)),
            variable("from_seconds", "s", number(1.0, None, None)),
        ],
    };
    let file = fs::File::create(folder.join("rigs/cart.fmu")).unwrap();
    write_fmu(file, &model, Version::Two, library).unwrap();
}

fn verdict(run: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(run.join("verdict.json")).unwrap()).unwrap()
}

#[test]
fn an_fmu_plays_behind_a_drive_in_one_process_and_in_several_and_is_replayed_without_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let step = cart(folder.path(), "");
    let (code, stdout, stderr) = output(
        Command::new(env!("CARGO_BIN_EXE_canrig"))
            .arg("check")
            .arg(&step),
    );
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let [alone, together] = ["alone", "together"].map(|name| folder.path().join(name));
    let (code, stdout, stderr) = output(canrig(&together, "simulate").arg(&step));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let (code, stdout, stderr) = output(canrig(&alone, "run").arg(&step).args(LOCKSTEP));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let [alone, together] = [alone, together].map(|runs| only_run(&runs));
    for file in ["bus.log", "signals.csv", "verdict.json"] {
        let read = |run: &Path| fs::read(run.join(file)).unwrap();
        assert!(read(&alone) == read(&together), "{file}");
    }
    let fmu = folder.path().join("rigs/cart.fmu");
    let hash = Sha256::digest(fs::read(&fmu).unwrap());
    let hash = String::from_iter(hash.iter().map(|byte| format!("{byte:02x}")));
    let line = fs::read_to_string(alone.join("rigs/cart.fmu.sha256")).unwrap();
    assert_eq!(line, format!("{hash}  cart.fmu\n"));
    assert_eq!(
        verdict(&alone)["identity"]["files"]["rigs/cart.fmu"],
        Value::from(hash)
    );
    let signals = fs::read_to_string(alone.join("signals.csv")).unwrap();
    assert!(
        signals
            .lines()
            .next()
            .unwrap()
            .contains("speed_metres_per_second"),
        "{signals}"
    );
    let before = fs::read(alone.join("verdict.json")).unwrap();
    // The folder can be played again, until the FMU is replaced.
    let again = folder.path().join("again");
    let (code, stdout, stderr) =
        output(canrig(&again, "simulate").arg(alone.join("scenario.toml")));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    cart(folder.path(), "another one");
    let (code, _, stderr) = output(canrig(&again, "simulate").arg(alone.join("scenario.toml")));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("is not the file that rigs/cart.fmu.sha256 says"),
        "{stderr}"
    );
    fs::remove_file(fmu).unwrap();
    for command in ["replay", "report"] {
        let (code, stdout, stderr) = output(
            Command::new(env!("CARGO_BIN_EXE_canrig"))
                .arg(command)
                .arg(&alone),
        );
        assert_eq!(code, Some(0), "{command}: {stdout}{stderr}");
    }
    assert!(fs::read(alone.join("verdict.json")).unwrap() == before);
}

/// Plays the cart with these changes to its rig and its scenario in one process and in several, and judges it again.
fn played(folder: &Path, name: &str, rig: &[(&str, &str)], step: &[(&str, &str)]) -> PathBuf {
    let changed = |text: &str, changes: &[(&str, &str)]| {
        changes.iter().fold(text.to_owned(), |text, (of, by)| {
            assert!(text.contains(of), "{of}");
            text.replace(of, by)
        })
    };
    fs::write(
        folder.join("rigs/cart.toml"),
        changed(&crate::rigs::rig("cart"), rig),
    )
    .unwrap();
    fs::write(folder.join("step.toml"), changed(STEP, step)).unwrap();
    let step = folder.join("step.toml");
    let [alone, together] = ["alone", "together"].map(|world| folder.join(name).join(world));
    let (code, stdout, stderr) = output(canrig(&together, "simulate").arg(&step));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let (code, stdout, stderr) = output(canrig(&alone, "run").arg(&step).args(LOCKSTEP));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let [alone, together] = [alone, together].map(|runs| only_run(&runs));
    for file in ["bus.log", "signals.csv", "verdict.json"] {
        let read = |run: &Path| fs::read(run.join(file)).unwrap();
        assert!(read(&alone) == read(&together), "{file}");
    }
    let (code, stdout, stderr) = output(
        Command::new(env!("CARGO_BIN_EXE_canrig"))
            .arg("replay")
            .arg(&alone),
    );
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    alone
}

#[test]
fn an_amplifier_of_48_volts_moves_a_plant_as_one_of_an_ampere_does() {
    let folder = tempfile::tempdir().unwrap();
    cart(folder.path(), "");
    let library = fs::read(folder.path().join("cart.so")).unwrap();
    write_cart_with(folder.path(), "", &library, "");
    let fault = "[[fault.amplifier.saturated]]\nfrom_seconds = 2.0\nuntil_seconds = 2.05\n";
    let limits = "[[expect.signal]]\n";
    let in_amperes = format!("{fault}current_amperes_max = 0.9\n{limits}");
    let amperes_limit = "[expect]\ncurrent_amperes_rms = { min = 0.01, max = 0.9 }\n";
    let amperes = played(
        folder.path(),
        "amperes",
        &[],
        &[
            ("[[expect.signal]]\n", &in_amperes),
            ("[expect]\n", amperes_limit),
        ],
    );
    let in_volts = format!("{fault}voltage_volts_max = 43.2\n{limits}");
    let volts_limit = "[expect]\nvoltage_volts_rms = { min = 0.48, max = 43.2 }\n";
    let volts = played(
        folder.path(),
        "volts",
        &[
            (
                "current_amperes = { variable = \"current_amperes\" }",
                "voltage_volts = { variable = \"current_amperes\", factor = 48.0 }",
            ),
            (
                "cart.current_amperes\", min = -1.0, max = 1.0",
                "cart.voltage_volts\", rated = 48.0, min = -48.0, max = 48.0",
            ),
            ("lift.current", "lift.voltage"),
        ],
        &[
            ("[[expect.signal]]\n", &in_volts),
            ("[expect]\n", volts_limit),
            (
                "proportional_amperes_per_metre = 64.8",
                "proportional_volts_per_metre = 3110.4",
            ),
            (
                "integral_amperes_per_metre_second = 489.0",
                "integral_volts_per_metre_second = 23472.0",
            ),
            (
                "derivative_ampere_seconds_per_metre = 3.74",
                "derivative_volt_seconds_per_metre = 179.52",
            ),
        ],
    );
    let read = |run: &Path, file: &str| fs::read_to_string(run.join(file)).unwrap();
    // Thousandths of the rated value are equal, so the frames are.
    let commands = |run: &Path| {
        let log = read(run, "bus.log");
        let is_command = |line: &&str| line.contains(" 210#");
        let frames = log.lines().filter(is_command);
        let data = frames.map(|line| line.rsplit('#').next().unwrap_or_default().to_owned());
        Vec::from_iter(data)
    };
    let [of_amperes, of_volts] = [commands(&amperes), commands(&volts)];
    assert_eq!(of_amperes.len(), of_volts.len());
    let other = of_amperes.iter().zip(&of_volts).filter(|(a, b)| a != b);
    assert!(other.count() < of_amperes.len() / 50);
    for file in ["signals.csv", "frames.dbc", "verdict.json"] {
        let [has, has_not] = [&volts, &amperes].map(|run| read(run, file));
        assert!(
            has.contains("voltage_volts") && !has.contains("amperes"),
            "{file}"
        );
        assert!(
            has_not.contains("current_amperes") && !has_not.contains("volts"),
            "{file}"
        );
    }
    assert!(read(&volts, "frames.dbc").contains("\"V\""));
    names_of_a_current_are_refused(folder.path());
}

/// Asserts that names of a current are refused in a loop that commands a voltage, with a hint at the right ones.
fn names_of_a_current_are_refused(folder: &Path) {
    let read = |file: &str| fs::read_to_string(folder.join(file)).unwrap();
    for (wrong, right) in [
        ("voltage_volts_max = 43.2", "write `voltage_volts_max`"),
        (
            "proportional_volts_per_metre",
            "write `proportional_volts_per_metre`",
        ),
        ("voltage_volts_rms", "write `voltage_volts_rms`"),
    ] {
        let step = folder.join("step.toml");
        let text = read("step.toml");
        let for_current = wrong
            .replace("voltage", "current")
            .replace("volts", "amperes");
        fs::write(&step, text.replace(wrong, &for_current)).unwrap();
        let (code, _, stderr) = output(
            Command::new(env!("CARGO_BIN_EXE_canrig"))
                .arg("check")
                .arg(&step),
        );
        assert_eq!(code, Some(3), "{stderr}");
        assert!(
            stderr.contains(right) && stderr.contains("is `voltage`"),
            "{stderr}"
        );
        fs::write(&step, text).unwrap();
    }
}

/// Asserts that a current was commanded, and that the last command removed it. The drive of the failed plant is silent
/// by then.
pub(crate) fn is_without_current(run: &Path) {
    let log = fs::read_to_string(run.join("bus.log")).unwrap();
    let is_current = |line: &str| line.contains(" 210#0F00") && !line.ends_with("0000");
    assert!(log.lines().any(is_current), "there was no current");
    let last = last_command(&log);
    assert!(last.ends_with("0000"), "{last}");
    let after = log.split_once(last).map_or("", |(_, after)| after);
    assert!(!after.contains(" 190#"), "{after}");
}

/// The run reports the misbehaviour of the FMU.
#[test]
fn an_fmu_that_misbehaves_costs_its_run_in_one_process_and_in_several() {
    let folder = tempfile::tempdir().unwrap();
    let step = cart(folder.path(), "");
    for (mode, said) in [
        (
            2,
            &["it did not return within 5s while it stepped; its process was ended"][..],
        ),
        (
            3,
            &[
                "was ended by signal 11",
                "while it stepped; only this run is lost",
            ],
        ),
        (
            4,
            &[
                "variable `position_metres` is NaN at ",
                "the FMU computed it",
            ],
        ),
        (
            5,
            &["exited with code 3 while it stepped", "it said: no licence"],
        ),
        (6, &["the FMU ended the simulation by itself at "]),
        (7, &["DoStep failed (error) at "]),
    ] {
        for world in ["simulate", "run"] {
            let runs = folder.path().join(format!("{world}-{mode}"));
            let mut canrig = canrig(&runs, world);
            let start = |value: &str| format!("plant.cart.start.{value}");
            canrig
                .arg(&step)
                .args(["--set", &start(&format!("mode={mode}"))])
                .args(["--set", &start("from_seconds=1.5")]);
            if world == "run" {
                canrig.args(LOCKSTEP);
            }
            let (code, stdout, stderr) = output(&mut canrig);
            let flat = Vec::from_iter(
                format!("{stdout} {stderr}")
                    .split_whitespace()
                    .map(str::to_owned),
            )
            .join(" ");
            assert_eq!(code, Some(1), "{mode}, {world}: {flat}");
            for said in said
                .iter()
                .chain(&["the plant `cart` cannot go on", "cart.fmu"])
            {
                assert!(flat.contains(said), "{mode}, {world}, {said}: {flat}");
            }
            let run = only_run(&runs);
            is_without_current(&run);
            let (code, stdout, stderr) = output(
                Command::new(env!("CARGO_BIN_EXE_canrig"))
                    .arg("replay")
                    .arg(&run),
            );
            assert_eq!(code, Some(1), "{mode}, {world}: {stdout}{stderr}");
        }
        let log = |world: &str| {
            let run = only_run(&folder.path().join(format!("{world}-{mode}")));
            fs::read(run.join("bus.log")).unwrap()
        };
        assert!(log("simulate") == log("run"), "{mode}");
    }
    // The FMU refuses long steps and gets short ones.
    let runs = folder.path().join("discards");
    let set = ["--set", "plant.cart.start.mode=1"];
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(&step).args(set));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
}

#[test]
fn a_swept_value_that_the_fmu_does_not_take_is_found_before_any_run() {
    let folder = tempfile::tempdir().unwrap();
    let step = cart(folder.path(), "");
    let swept = |sweep: &str| {
        let key = "key = \"plant.cart.start.mass_kilograms\"";
        let sweep = format!("[sweep]\n{}\n[expect]\n", sweep.replace("KEY", key));
        fs::write(&step, STEP.replacen("[expect]\n", &sweep, 1)).unwrap();
    };
    let runs = folder.path().join("runs");
    for (sweep, said) in [
        ("[[sweep.list]]\nKEY\nvalues = [1.8, 20.0, 2.4]", "20"),
        (
            "[[sweep.range]]\nKEY\nfrom = 0.05\nto = 4.0\ncount = 4",
            "0.05",
        ),
        (
            "draws = 4\n[[sweep.uniform]]\nKEY\nfrom = 2.0\nto = 10.5",
            "10.5",
        ),
        (
            "draws = 4\n[[sweep.normal]]\nKEY\nmean = 11.0\nstandard_deviation = 1.0",
            "11",
        ),
    ] {
        swept(sweep);
        let mut check = Command::new(env!("CARGO_BIN_EXE_canrig"));
        let (code, _, check_error) = output(check.arg("check").arg(&step).env("NO_COLOR", "1"));
        assert_eq!(code, Some(3), "{sweep}: {check_error}");
        let (code, _, sweep_error) = output(canrig(&runs, "sweep").arg(&step));
        assert_eq!(code, Some(3), "{sweep}: {sweep_error}");
        for stderr in [check_error, sweep_error] {
            let flat = without_layout(&stderr);
            let message = format!(
                "variable `mass_kilograms` cannot start with {said}, it must be from 0.1 to 10"
            );
            for message in [&message, "step.toml:", "by what the FMU says of itself"] {
                assert!(
                    flat.contains(&without_layout(message)),
                    "{message}: {stderr}"
                );
            }
        }
        assert!(!runs.exists(), "{sweep}");
    }
    // A distribution without bounds draws some values that are not played.
    swept("draws = 6\n[[sweep.normal]]\nKEY\nmean = 2.4\nstandard_deviation = 5.0");
    output(canrig(&runs, "sweep").arg(&step));
    let table = fs::read_to_string(only_run(&runs).join("runs.csv")).unwrap();
    let invalid = table
        .lines()
        .filter(|line| line.contains("invalid"))
        .count();
    assert!((1..6).contains(&invalid), "{table}");
    assert!(table.contains("it must be from 0.1 to 10"), "{table}");
}

#[test]
fn a_library_for_another_platform_or_machine_is_refused_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let step = cart(folder.path(), "");
    let refused = |arguments: &[&str], said: &str, more: &str| {
        let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
        canrig.args(arguments).arg(&step).env("NO_COLOR", "1");
        let (code, stdout, stderr) = output(canrig.current_dir(folder.path()));
        assert_eq!(code, Some(3), "{arguments:?}: {stdout}{stderr}");
        let flat = without_layout(&format!("{stdout}{stderr}"));
        for said in ["cart.fmu", said, more] {
            let is_said = flat.contains(&without_layout(said));
            assert!(is_said, "{arguments:?}, {said}: {stdout}{stderr}");
        }
    };
    let lockstep = [&["run"][..], &LOCKSTEP[..]].concat();
    let worlds = [&["simulate"][..], &lockstep[..]];
    // Two bytes of the library are its machine: 243 is RISC-V.
    let mut library = fs::read(folder.path().join("cart.so")).unwrap();
    library[18..20].copy_from_slice(&243_u16.to_le_bytes());
    write_cart(folder.path(), "", &library);
    for world in worlds {
        let said = "its library cannot be loaded: it is for RISC-V, and this is ";
        refused(world, said, "");
    }
    // Names in a zip file are uncompressed.
    let here = Version::Two.platform();
    let elsewhere = &"riscv64-linux"[..here.len()];
    let path = folder.path().join("rigs/cart.fmu");
    let mut bytes = fs::read(&path).unwrap();
    while let Some(place) = bytes
        .windows(here.len())
        .position(|some| some == here.as_bytes())
    {
        bytes[place..place + here.len()].copy_from_slice(elsewhere.as_bytes());
    }
    fs::write(&path, bytes).unwrap();
    let said = format!("it has no library for this machine ({here}); it has {elsewhere}");
    for command in [&["check"][..]].into_iter().chain(worlds) {
        refused(command, &said, "rigs/cart.toml:");
    }
}

/// Returns a text without spaces, line ends and margins: lines of an error may be broken anywhere.
fn without_layout(text: &str) -> String {
    text.split_whitespace().collect::<String>().replace('│', "")
}

#[test]
fn what_does_not_fit_the_fmu_is_underlined_in_the_rig_file() {
    let folder = tempfile::tempdir().unwrap();
    let step = cart(folder.path(), "");
    let rig = folder.path().join("rigs/cart.toml");
    let text = fs::read_to_string(&rig).unwrap();
    let refused = |from: &str, to: &str, said: &[&str]| {
        assert!(text.contains(from), "{from}");
        fs::write(&rig, text.replace(from, to)).unwrap();
        let (code, _, stderr) = output(
            Command::new(env!("CARGO_BIN_EXE_canrig"))
                .env("NO_COLOR", "1")
                .arg("check")
                .arg(&step),
        );
        assert_eq!(code, Some(3), "{to}: {stderr}");
        let flat = without_layout(&stderr);
        let unsaid = said
            .iter()
            .find(|said| !flat.contains(&without_layout(said)));
        assert_eq!(unsaid, None, "{to}: {stderr}");
    };
    refused(
        "variable = \"speed_metres_per_second\"",
        "variable = \"sped\"",
        &[
            "cart.fmu cannot be this plant",
            "variable `sped` is not in the FMU",
            "rigs/cart.toml:",
        ],
    );
    refused(
        "speed_metres_per_second = {",
        "speed_seconds = {",
        &["is in m/s, and the port `speed_seconds` would be in seconds"],
    );
    refused(
        "range = [-3.0, 3.0]",
        "range = [3.0, -3.0]",
        &["write the lowest value, then a higher one"],
    );
    refused(
        "mass_kilograms = 2.4",
        "mass_kilograms = 0.01",
        &["`mass_kilograms` cannot start with 0.01, it must be from 0.1 to 10"],
    );
    refused(
        "mass_kilograms = 2.4",
        "mass = 2.4",
        &["variable `mass` is not in the FMU"],
    );
    refused(
        "\"cart.fmu\"",
        "\"card.fmu\"",
        &[
            "`card.fmu` cannot be the FMU of `cart`",
            "there is no such file",
        ],
    );
    refused(
        "\"cart.fmu\"",
        "\"../cart.fmu\"",
        &["no absolute path, no `..`"],
    );
    refused(
        "file = \"cart.fmu\"\n",
        "",
        &["the plant `cart` lacks `file`"],
    );
    refused(
        "port = \"cart.current_amperes\"",
        "port = \"cart.position_metres\"",
        &["drives `cart.position_metres`"],
    );
    refused(
        "file = \"cart.fmu\"\n",
        "file = \"cart.fmu\"\nrecord = [\"from_seconds\"]\n",
        &["variable `from_seconds` has no lowest and highest value"],
    );
    fs::write(&rig, &text).unwrap();
    fs::write(folder.path().join("rigs/cart.fmu"), "PK").unwrap();
    refused("cart", "cart", &["not a zip file"]);
}

#[test]
fn a_sweep_ends_when_its_fmu_becomes_another_one() {
    let folder = tempfile::tempdir().unwrap();
    let step = cart(folder.path(), "");
    let sweep = "[sweep]\ndraws = 2000\n[[sweep.uniform]]\nkey = \"plant.cart.start.mass_kilograms\"\nfrom = 1.8\nto = 2.8\n[expect]\n";
    fs::write(&step, STEP.replacen("[expect]\n", sweep, 1)).unwrap();
    let place = folder.path().join("runs");
    let mut command = canrig(&place, "sweep");
    let command = command
        .arg(&step)
        .args(["--threads", "1"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let rows = || {
        let part = runs(&place).pop();
        let text = part.map(|folder| fs::read_to_string(folder.join("rows.jsonl")));
        text.map_or(0, |text| text.unwrap_or_default().lines().count())
    };
    while child.try_wait().unwrap().is_none() && (!place.exists() || rows() < 5) {
        thread::sleep(Duration::from_millis(5));
    }
    let library = fs::read(folder.path().join("cart.so")).unwrap();
    write_cart(folder.path(), "another one", &library);
    let ended = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(4), "{stderr}");
    assert!(
        stderr.contains("cart.fmu is gone or another file than at the start"),
        "{stderr}"
    );
    assert!((5..2000).contains(&rows()), "{}", rows());
}

#[test]
fn a_parameter_of_an_fmu_is_swept_and_no_row_of_another_fmu_counts() {
    let folder = tempfile::tempdir().unwrap();
    let step = cart(folder.path(), "");
    let sweep = "[sweep]\n[[sweep.list]]\nkey = \"plant.cart.start.mass_kilograms\"\nvalues = [1.8, 2.1, 2.4, 2.7]\n[expect]\n";
    fs::write(&step, STEP.replacen("[expect]\n", sweep, 1)).unwrap();
    let below = |name: &str| folder.path().join(name);
    let play = |name: &str| {
        let (code, stdout, stderr) = output(canrig(&below(name), "sweep").arg(&step));
        assert_eq!(code, Some(0), "{stdout}{stderr}");
    };
    play("runs");
    let table = fs::read_to_string(only_run(&below("runs")).join("runs.csv")).unwrap();
    assert_eq!(table.lines().count(), 5, "{table}");
    let overshoots = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').skip(3).collect::<Vec<_>>().join(","));
    let mut different = Vec::from_iter(overshoots);
    different.sort();
    different.dedup();
    assert_eq!(different.len(), 4, "{table}");
    // With the same FMU all rows are reused. Another FMU has another folder.
    play("runs");
    assert_eq!(runs(&below("runs")).len(), 1);
    cart(folder.path(), "another one");
    fs::write(&step, STEP.replacen("[expect]\n", sweep, 1)).unwrap();
    play("runs");
    assert_eq!(runs(&below("runs")).len(), 2);
    let misspelt = sweep.replace("mass_kilograms", "mass_kilogram");
    fs::write(&step, STEP.replacen("[expect]\n", &misspelt, 1)).unwrap();
    let (code, _, stderr) = output(canrig(&below("wrong"), "sweep").arg(&step));
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stderr.contains("did you mean `plant.cart.start.mass_kilograms`?"),
        "{stderr}"
    );
}
