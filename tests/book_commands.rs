//! Every command of README and the book is played, in a folder with the files that the pages name.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};

use crate::book::{arguments, commands, has_placeholder, pages};
use crate::real_time::{Started, soon, wait_for};
use crate::support::{output, root};

/// Commands that are not played, each with the reason.
const NOT_PLAYED: [(&str, &str); 12] = [
    ("reproduce", "it plays for minutes: tests/reproduce.rs"),
    (
        "reproduce --reduced",
        "it plays for minutes: tests/reproduce.rs",
    ),
    (
        "submit big.toml --engine slurm",
        "it needs Slurm: tests/system/test_engines.py",
    ),
    (
        "submit big.toml --engine slurm --parts 44 --task-minutes 35 --task-mebibytes 128 --output /shared/runs",
        "it needs Slurm: tests/system/test_engines.py",
    ),
    (
        "replay RUN --viewer --speed 0.1",
        "it opens a viewer: tests/viewer.rs",
    ),
    (
        "simulate step -- ./build/zephyr/zephyr.exe --no-rt --rtc-reset",
        "it needs Zephyr: tests/system/test_native_sim.py",
    ),
    (
        "simulate my.toml --watch",
        "it ends by Ctrl-C only: tests/watch.rs",
    ),
    (
        "simulate step --watch -- ./controller",
        "it ends by Ctrl-C only: tests/watch.rs",
    ),
    (
        "sdo write 0x10 1017 50 --bus can0",
        "a drive must answer: tests/tools.rs",
    ),
    (
        "simulate scenarios/my_law.toml",
        "it needs the crate that is generated: tests/system/test_new.py",
    ),
    (
        "check scenarios/my_plant_rig.toml",
        "it needs the crate that is generated: tests/system/test_new.py",
    ),
    (
        "simulate scenarios/my_plant.toml",
        "it needs the crate that is generated: tests/system/test_new.py",
    ),
];

/// Commands that look at a bus or a machine, and say so by their exit codes.
const OF_A_MACHINE: [&str; 5] = ["doctor", "nodes", "sdo", "monitor", "identify"];

/// Writes the files that the pages name, with sizes that play soon.
#[expect(clippy::too_many_lines, reason = "a list of files")]
fn workplace(folder: &Path) {
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    let read = |name: &str| fs::read_to_string(root().join(name)).unwrap();
    let copy = |from: &str, to: &str| write(to, &read(from));
    // A step after a short hold.
    let step = read("scenarios/step.toml")
        .replace("duration_seconds = 12.0", "duration_seconds = 1.2")
        .replace("at_seconds = 10.0", "at_seconds = 0.2");
    for name in [
        "scenarios/step.toml",
        "step.toml",
        "my.toml",
        "strict.toml",
        "played.toml",
    ] {
        write(name, &step);
    }
    let sweep = read("scenarios/sweeps/plants.toml")
        .replace("duration_seconds = 12.0", "duration_seconds = 1.2")
        .replace("at_seconds = 10.0", "at_seconds = 0.2")
        .replace("draws = 200", "draws = 1");
    for name in ["scenarios/sweeps/plants.toml", "plants.toml", "big.toml"] {
        write(name, &sweep);
    }
    for name in [
        "rigs/two_axes.toml",
        "requirements.csv",
        "faults/amplifier_dead.toml",
        "torture.toml",
    ] {
        copy(&format!("scenarios/{name}"), &format!("scenarios/{name}"));
    }
    for name in [
        "excitation.toml",
        "rig.toml",
        "feeder.toml",
        "feed_and_press.toml",
        "lift.toml",
    ] {
        copy(
            &format!("docs/examples/{name}"),
            &format!("docs/examples/{name}"),
        );
        copy(&format!("docs/examples/{name}"), name);
    }
    for name in [
        "motor_rig.toml",
        "motor_step.toml",
        "pid.py",
        "pid_in_python.toml",
    ] {
        copy(&format!("docs/examples/{name}"), name);
    }
    for name in ["pid.toml", "rig.toml", "servo.eds"] {
        copy(
            &format!("tests/foreign/{name}"),
            &format!("tests/foreign/{name}"),
        );
    }
    for name in ["step.log", "step.toml"] {
        copy(
            &format!("docs/examples/metrics/{name}"),
            &format!("metrics/{name}"),
        );
    }
    copy("docs/examples/metrics/step.log", "candump.log");
    copy("docs/examples/metrics/step.log", "step.log");
    copy("docs/examples/lift.toml", "lost.toml");
    let swept = "\n[[sweep.list]]\nkey = \"seed\"\nvalues = [1, 2]\n";
    for (from, to) in [
        ("lift.toml", "lift_sweep.toml"),
        ("pid_in_python.toml", "swept.toml"),
    ] {
        write(to, &(read(&format!("docs/examples/{from}")) + swept));
    }
    let canrig = |arguments: &[&str]| {
        let (code, stdout, stderr) = output(program().args(arguments).current_dir(folder));
        assert!(
            matches!(code, Some(0 | 1)),
            "{arguments:?}: {stdout}{stderr}"
        );
    };
    canrig(&["new", "controller", "template", "--language", "python"]);
    for name in ["controller.py", "canrig_node.py"] {
        fs::copy(folder.join("template").join(name), folder.join(name)).unwrap();
    }
    let runs = "#!/bin/sh\nexec python3 \"$(dirname \"$0\")/controller.py\"\n";
    write("controller", runs);
    let (code, ..) = output(
        Command::new("chmod")
            .arg("+x")
            .arg(folder.join("controller")),
    );
    assert_eq!(code, Some(0));
    canrig(&["simulate", "step.toml", "--output", "played"]);
    canrig(&["simulate", "step.toml", "--output", "played"]);
    let mut played = Vec::from_iter(fs::read_dir(folder.join("played")).unwrap().flatten());
    played.sort_by_key(fs::DirEntry::file_name);
    for (name, run) in ["RUN", "OTHER_RUN"].into_iter().zip(&played) {
        fs::rename(run.path(), folder.join(name)).unwrap();
    }
    canrig(&["fmu", "--export", "dc_motor", "--output", "motor.fmu"]);
    canrig(&["simulate", "step.toml", "--output", "runs/hardware"]);
    for part in ["1", "2", "3"] {
        let shard = format!("{part}/3");
        canrig(&[
            "sweep",
            "lift_sweep.toml",
            "--shard",
            &shard,
            "--output",
            "parts",
        ]);
        let made = fs::read_dir(folder.join("parts"))
            .unwrap()
            .next()
            .unwrap()
            .unwrap();
        fs::rename(made.path(), folder.join(format!("part-{part}"))).unwrap();
    }
    let failing = "swept/failing/case-17-70f3db9da50247ae.toml";
    for place in [failing, "identified/model/scenario.toml"] {
        write(place, &step);
    }
    copy("docs/examples/rig.toml", "desk.toml");
}

fn program() -> Command {
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    canrig.env("NO_COLOR", "1");
    canrig
}

/// Returns the arguments of a command for a machine without a kernel's bus, other machines, a browser and a place of the user's;
/// a new project gets a folder of its own.
fn here(command: &str) -> String {
    command
        .replace("--bus vcan0", "--bus embedded")
        .replace("--bus can0", "--bus embedded")
        .replace("/shared/", "shared/")
        .replace("demo somewhere/else --open", "demo somewhere/else")
        .replace("new project --ci", "new project project --ci")
        .replace("~/", "home/")
        .replace("--runs 100", "--runs 2")
        .replace("auto --shards 44", "1/2")
        .replace("--bus vxcan0", "--bus embedded")
        .replace("runs/lift-by-15-mm-sweep-e4a4a3cd8fc72528/", "swept/")
        .replace("simulate runs/identified/", "simulate identified/")
        .replace("can0 --output runs/hardware", "embedded --output hardware")
        .replace(
            "embedded --output runs/hardware",
            "embedded --output hardware",
        )
        .replace("/parts/*-of-44", "/../part-*")
        .replace("sweep pid_in_python.toml", "sweep swept.toml")
        .replace(
            "replay candump.log --scenario played.toml",
            "replay candump.log --scenario metrics/step.toml",
        )
        .replace(
            "replay step.log --scenario step.toml",
            "replay step.log --scenario metrics/step.toml",
        )
}

/// Returns a command that plays in virtual time where the page does in real time, but for one scenario.
fn sooner(command: &str) -> String {
    let is_of_real_time = command.starts_with("run ")
        && !["--clock", "--external", "--bus", "scenarios/step.toml"]
            .iter()
            .any(|words| command.contains(words));
    if is_of_real_time {
        command.replacen("run ", "run --clock lockstep ", 1)
    } else {
        command.to_owned()
    }
}

#[test]
fn every_command_of_the_book_is_played() {
    let folder = tempfile::tempdir().unwrap();
    workplace(folder.path());
    let mut played = BTreeSet::new();
    let mut failed = Vec::new();
    // The files of a recipe are on its page: tests/recipes.rs plays them.
    let recipes = root().join("docs/recipes");
    for page in pages() {
        if page.path.starts_with(&recipes) {
            continue;
        }
        for command in commands(&page) {
            let words =
                arguments(&command).filter(|_| !has_placeholder(&command.replace("/*", "")));
            let Some(words) = words else { continue };
            let words = words[1..].join(" ");
            if NOT_PLAYED.iter().any(|(one, _)| *one == words) || !played.insert(words.clone()) {
                continue;
            }
            if let Err(why) = play(folder.path(), &sooner(&here(&words))) {
                failed.push(format!("{}: canrig {words}\n{why}", page.path.display()));
            }
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(played.len() > 60, "{} commands", played.len());
}

/// Plays a command until its end, or until it expects an external node.
fn play(folder: &Path, command: &str) -> Result<(), String> {
    // The shell replaces `*`.
    let line = format!("exec {} {command}", env!("CARGO_BIN_EXE_canrig"));
    let mut shell = Command::new("sh");
    shell
        .args(["-c", &line])
        .current_dir(folder)
        .env("NO_COLOR", "1");
    let has_real_drive = ["rig.toml --bus", "desk.toml --bus"]
        .iter()
        .any(|words| command.starts_with("run ") && command.contains(words));
    if has_real_drive || command.contains("--external") {
        return expects_its_node(shell, folder);
    }
    // Nothing is overwritten, and some commands of the book make the same thing.
    let words = Vec::from_iter(command.split(' '));
    for (place, word) in words.iter().enumerate() {
        match (*word, words.get(place + 1)) {
            ("--output", Some(file)) if folder.join(file).is_file() => {
                fs::remove_file(folder.join(file)).unwrap();
            }
            ("--to", Some(copies)) if folder.join(copies).is_dir() && *copies != "." => {
                return play(
                    folder,
                    &command.replace(&format!("--to {copies}"), "--to copies"),
                );
            }
            ("my_law", _) if folder.join("my_law").exists() => {
                fs::remove_dir_all(folder.join("my_law")).unwrap();
            }
            _ => {}
        }
    }
    let (code, stdout, stderr) = soon(&mut in_folder(&line, folder));
    let of_machine = OF_A_MACHINE.contains(&command.split(' ').next().unwrap_or_default());
    match code {
        // What was asked for was done, whatever it came to.
        Some(0 | 1 | 5) => Ok(()),
        Some(3 | 4) if of_machine => Ok(()),
        code => Err(format!("{code:?} {stdout}{stderr}")),
    }
}

/// Returns the shell that runs a line in a folder.
fn in_folder(line: &str, folder: &Path) -> Command {
    let mut shell = Command::new("sh");
    shell.args(["-c", &format!("cd '{}' && {line}", folder.display())]);
    shell.env("NO_COLOR", "1");
    shell
}

/// Plays until an external node is expected, and stops it then.
pub(crate) fn expects_its_node(mut shell: Command, folder: &Path) -> Result<(), String> {
    let said = folder.join("said");
    let file = fs::File::create(&said).unwrap();
    shell.stdout(file.try_clone().unwrap()).stderr(file);
    let canrig = Started::new(shell.stdin(Stdio::null()).spawn().unwrap());
    let pid = Pid::from_raw(i32::try_from(canrig.id()).unwrap()).unwrap();
    let text = || fs::read_to_string(&said).unwrap();
    let is_expected = || {
        // The bus is there once its address is said; before, nothing listens for a signal yet.
        let words = ["expected at", "bus address"];
        words.iter().any(|words| text().contains(words))
    };
    let is_refused =
        || text().contains("do not fit") || text().contains("canrig:") || text().contains("×");
    wait_for("the node to be expected", || is_expected() || is_refused());
    let _ = kill_process(pid, Signal::INT);
    let code = canrig.ended().status.code();
    if is_expected() && code == Some(130) {
        Ok(())
    } else {
        Err(format!("{code:?} {}", text()))
    }
}
