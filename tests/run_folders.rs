//! Folders in arguments: what plays have left there is not played again, and `canrig check --json` says what each file is.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{output, root, runs, short_scenario};

fn in_folder(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    output(canrig.args(arguments).current_dir(folder))
}

/// Writes two scenarios and a sweep of which all cases fail.
fn with_scenarios(folder: &Path) {
    let short = short_scenario(folder, 0.2);
    let text = fs::read_to_string(&short).unwrap();
    let controller = "[controller.pid]";
    assert!(text.contains("[controller."), "{text}");
    fs::create_dir(folder.join("below")).unwrap();
    fs::copy(&short, folder.join("below/other.toml")).unwrap();
    let swept = format!(
        "schema = 1\nrig = \"dc_motor\"\nname = \"s\"\nduration_seconds = 0.1\n{controller}\n\
         proportional_amperes_per_metre = 64.8\nintegral_amperes_per_metre_second = 489.0\n\
         derivative_ampere_seconds_per_metre = 3.74\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
         [expect]\ncurrent_amperes_rms = {{ max = 0.0 }}\n\
         [[sweep.list]]\nkey = \"seed\"\nvalues = [1, 2]\n"
    );
    fs::write(folder.join("swept.toml"), swept).unwrap();
}

#[test]
fn what_plays_have_left_is_not_played_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    with_scenarios(folder);
    let (code, stdout, stderr) = in_folder(folder, &["sweep", "swept.toml", "-o", "deep/sweeps"]);
    assert_eq!(code, Some(1), "{stdout}{stderr}");
    fs::rename(folder.join("swept.toml"), folder.join("swept.txt")).unwrap();
    let worlds: [&[&str]; 3] = [
        &["simulate", "."],
        &["run", ".", "--clock", "lockstep", "--bus", "embedded"],
        &["simulate", ".", "-o", "deep/runs"],
    ];
    for (number, world) in worlds.into_iter().cycle().take(6).enumerate() {
        let (code, stdout, stderr) = in_folder(folder, world);
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        let of_world = folder.join(if world.len() > 3 && world[2] == "-o" {
            "deep/runs"
        } else {
            "runs"
        });
        let others = if of_world.ends_with("deep/runs") {
            number / 3 + 1
        } else {
            number + 1 - number / 3
        };
        assert_eq!(runs(&of_world).len(), 2 * others, "{world:?}");
        let left_out = 1 + 2 * number;
        let folders = if left_out == 1 { "folder" } else { "folders" };
        let note = format!("note: `.`: {left_out} {folders} of runs left out");
        assert!(stderr.contains(&note), "{note}: {stderr}");
    }
    let (code, stdout, stderr) = in_folder(folder, &["check", "."]);
    assert_eq!(
        (code, stdout.lines().count()),
        (Some(0), 2),
        "{stdout}{stderr}"
    );
    // A file that is named is played, wherever it lies, and a folder of runs holds no scenario.
    let run = runs(&folder.join("runs")).remove(0);
    let scenario = run.join("scenario.toml");
    let (code, _, stderr) = in_folder(folder, &["check", scenario.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{stderr}");
    let (code, _, stderr) = in_folder(folder, &["simulate", "runs"]);
    assert_eq!(code, Some(3), "{stderr}");
    assert!(stderr.contains("`runs` holds no scenario"), "{stderr}");
}

#[test]
fn a_check_says_what_each_file_is() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    with_scenarios(folder);
    let programs = root().join("tests/data/programs");
    for name in ["rig.toml", "step.toml"] {
        fs::copy(programs.join(name), folder.join("below").join(name)).unwrap();
    }
    let led = "schema = 1\nrig = \"dc_motor\"\nname = \"led\"\nduration_seconds = 1.0\n\
               [node.controller]\nprogram = [\"true\"]\n";
    fs::write(folder.join("led.toml"), led).unwrap();
    fs::write(folder.join("broken.toml"), led.replace("1.0", "=")).unwrap();
    fs::write(folder.join("table.toml"), "[tool]\nname = \"hold\"\n").unwrap();
    fs::write(folder.join("broken_table.toml"), "[tool]\nname = = \n").unwrap();
    assert_eq!(
        in_folder(folder, &["simulate", "below/other.toml"]).0,
        Some(0)
    );
    let run = runs(&folder.join("runs")).remove(0);
    let scenario = run.join("scenario.toml");
    let arguments = ["check", "--json", ".", scenario.to_str().unwrap()];
    let (code, stdout, stderr) = in_folder(folder, &arguments);
    assert_eq!(code, Some(3), "{stderr}");
    let files: Vec<Value> = serde_json::from_str(&stdout).unwrap();
    let said = |file: &Value| {
        let path = file["path"].as_str().unwrap();
        let name = Path::new(path).file_name().unwrap().to_str().unwrap();
        let kind = file["kind"].as_str().unwrap();
        let left = if file["is_left_by_a_play"] == true {
            ", left"
        } else {
            ""
        };
        let state = if file["problem"].is_null() {
            ""
        } else {
            ", wrong"
        };
        format!("{name}: {kind}{left}{state}")
    };
    let mut said = Vec::from_iter(files.iter().map(said));
    said.sort();
    assert_eq!(
        said,
        [
            "broken.toml: scenario, wrong",
            "broken_table.toml: other, wrong",
            "led.toml: scenario",
            "other.toml: scenario",
            "rig.toml: rig, wrong",
            "scenario.toml: scenario, left",
            "short.toml: scenario",
            "step.toml: scenario, wrong",
            "swept.toml: sweep",
            "table.toml: other, wrong",
        ]
    );
}
